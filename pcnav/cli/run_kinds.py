"""The kinds of runs, each told to a view while it goes on where one is asked for."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from rich.table import Table

from pcnav.cli.progress import Advance
from pcnav.config.pipeline_file import EstimatorKind, EstimatorTable, Pipeline
from pcnav.estimators.image_motion.chain import ChainFrame
from pcnav.recordings.sequence import Sequence
from pcnav.report.summary import summary_table
from pcnav.runs.attitude_results import AttitudeFrame
from pcnav.runs.feature_estimate import FeatureEstimate
from pcnav.runs.results import FrameEstimate
from pcnav.target.satellite import Target

if TYPE_CHECKING:
    from pcnav.viewer.live import LiveView


@dataclass(frozen=True)
class Done:
    """What the command line shows of a run."""

    folder: Path
    report: Path
    table: Table


Work = Callable[[Advance, "LiveView | None"], Done]
"""A run that tells how far it is, and a view, if there is one, of its frames."""


def depth_run(
    sequence: Path, mesh: Path | None, pipeline: Pipeline, out: Path, overwrite: bool
) -> Work:
    """On depth frames."""
    from pcnav.pipeline import run

    def work(advance: Advance, view: "LiveView | None") -> Done:
        def on_start(opened: Sequence, target: Target, as_run: Pipeline) -> None:
            if view is not None:
                from pcnav.viewer.live_rows import DEPTH

                view.expect(out.name, as_run, DEPTH)

        def on_estimate(estimate: FrameEstimate, total: int) -> None:
            if view is not None:
                from pcnav.viewer.live_rows import depth_estimate

                view.add(depth_estimate(estimate))
            advance(estimate.index + 1, total)

        summary = run(
            sequence,
            out,
            pipeline,
            target_mesh=mesh,
            overwrite=overwrite,
            on_start=on_start,
            on_estimate=on_estimate,
        )
        table = summary_table(summary.metrics, summary.knowledge)
        return Done(summary.folder, summary.report, table)

    return work


def tracks_run(
    recording: Path, pipeline_file: Path, pipeline: Pipeline, out: Path, overwrite: bool
) -> Work:
    """On stereo feature tracks."""
    from pcnav.feature_pipeline import run_features
    from pcnav.recordings.stereo_tracks import read_stereo_tracks

    def work(advance: Advance, view: "LiveView | None") -> Done:
        tracks = None if view is None else read_stereo_tracks(recording)
        if view is not None and tracks is not None:
            from pcnav.viewer.live_rows import FEATURES, of_recording

            view.expect(out.name, of_recording(pipeline, recording), FEATURES)

        def on_estimate(estimate: FeatureEstimate, done: int, total: int) -> None:
            if view is not None and tracks is not None:
                from pcnav.viewer.live_rows import feature_estimate

                view.add(feature_estimate(tracks, tracks.frames[done - 1], estimate))
            advance(done, total)

        summary = run_features(
            recording,
            out,
            pipeline,
            overwrite=overwrite,
            on_estimate=on_estimate,
            source=pipeline_file,
        )
        return Done(summary.folder, summary.report, summary_table(summary.metrics))

    return work


def images_run(recording: Path, pipeline: Pipeline, out: Path, overwrite: bool) -> Work:
    """On images or tracks of one camera."""
    from pcnav.image_pipeline import run_images

    def work(advance: Advance, view: "LiveView | None") -> Done:
        measured: set[int] = set()
        if view is not None:
            from pcnav.viewer.live_rows import IMAGES, of_recording

            estimator = EstimatorTable(kind=EstimatorKind.IMAGE_MOTION)
            as_run = of_recording(pipeline, recording).model_copy(update={"estimator": estimator})
            view.expect(out.name, as_run, IMAGES)

        def on_frame(frame: ChainFrame, done: int, total: int) -> None:
            if view is not None:
                from pcnav.viewer.live_rows import image_estimate

                view.add(image_estimate(frame, measured))
            advance(done, total)

        summary = run_images(recording, out, pipeline, overwrite=overwrite, on_frame=on_frame)
        return Done(summary.folder, summary.report, summary_table(summary.metrics))

    return work


def attitudes_run(recording: Path, pipeline: Pipeline, out: Path, overwrite: bool) -> Work:
    """On attitudes, recorded or of images."""
    from pcnav.attitude_pipeline import run_attitudes

    def work(advance: Advance, view: "LiveView | None") -> Done:
        if view is not None:
            from pcnav.viewer.live_rows import ATTITUDES, of_recording

            view.expect(out.name, of_recording(pipeline, recording), ATTITUDES)

        def on_frame(frame: AttitudeFrame, done: int, total: int) -> None:
            if view is not None:
                from pcnav.viewer.live_rows import attitude_estimate

                view.add(attitude_estimate(frame))
            advance(done, total)

        summary = run_attitudes(recording, out, pipeline, overwrite=overwrite, on_frame=on_frame)
        return Done(summary.folder, summary.report, summary_table(summary.metrics))

    return work
