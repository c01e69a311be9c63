"""A run on attitudes as a list of verbs: open, estimate, write, evaluate, report.

The attitudes are recorded, or those of a chain of images of one camera.
"""

import json
import shlex
import sys
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pcnav.config.pipeline_file import EstimatorKind, Pipeline
from pcnav.core.errors import InputError
from pcnav.estimators.attitude_inertia.chained_inertia import ChainedInertiaEstimator
from pcnav.estimators.attitude_inertia.estimator import AttitudeInertiaEstimator, RotationEstimate
from pcnav.estimators.attitude_inertia.rotation_model import TorqueFreeModel, carry
from pcnav.estimators.image_motion.chain import ChainFrame
from pcnav.estimators.image_motion.source import (
    ImageSource,
    chain_of,
    is_seen_by_one_camera,
    open_source,
)
from pcnav.evaluation.attitude_metrics import evaluate_attitudes
from pcnav.evaluation.metrics import Metrics
from pcnav.evaluation.observability.sources import observability_of_run, tables_for_report
from pcnav.evaluation.track_errors import truth_of
from pcnav.files.new_folder import new_folder
from pcnav.recordings.attitudes import AttitudeRecording, read_attitudes
from pcnav.recordings.monocular_tracks import write_monocular_files
from pcnav.recordings.truth import read_truth
from pcnav.report.attitude_report import AttitudeReport, write_attitude_report
from pcnav.runs.attitude_results import (
    AttitudeFrame,
    AttitudeTrack,
    attitude_frame,
    attitude_track,
    write_states,
)
from pcnav.runs.image_results import outcome_in_words
from pcnav.runs.provenance import library_versions, pipeline_toml
from pcnav.runs.results import METRICS_FILE, PIPELINE_FILE, REPORT_FILE, STATES_FILE

OnFrame = Callable[[AttitudeFrame, int, int], None]
"""Told of every frame, how many are done, and of how many."""


@dataclass(frozen=True)
class AttitudeRunSummary:
    """What a run leaves behind."""

    folder: Path
    metrics: Metrics
    """Errors in it only where the recording carries a truth."""

    @property
    def report(self) -> Path:
        """The report page."""
        return self.folder / REPORT_FILE


@dataclass(frozen=True)
class _Estimated:
    """A recording run through."""

    track: AttitudeTrack
    outcomes: list[tuple[str, int]]
    """What became of frames of images, in words."""


def run_attitudes(
    recording: Path,
    out: Path,
    pipeline: Pipeline,
    *,
    overwrite: bool = False,
    on_frame: OnFrame | None = None,
) -> AttitudeRunSummary:
    """Estimate rotation and inertia ratios from attitudes or images and write the result folder.

    Raises `InputError` for a bad recording, truth or existing result folder and without the extra
    `images` where it is needed; nothing is then left, and an earlier result stays as it was.
    """
    place = recording.parent if recording.is_file() else recording
    if place.resolve().is_relative_to(out.resolve()):
        raise InputError(out, "folder", f"expected a result folder that does not hold {recording}")
    images = open_source(recording, pipeline) if is_seen_by_one_camera(recording) else None
    attitudes = read_attitudes(recording) if images is None else None
    folder = place if attitudes is None else place.resolve()
    # Read now, so that a fault in it costs no run; nothing but the evaluation is given it.
    truth = truth_of(read_truth(folder))
    as_run = pipeline.model_copy(update={"sequence": str(recording.resolve())})
    with new_folder(out, overwrite, STATES_FILE) as staging:
        if images is not None:
            found = _from_images(images, pipeline, staging, on_frame)
        else:
            assert attitudes is not None
            found = _from_attitudes(attitudes, pipeline, on_frame)
        write_states(staging, found.track)
        metrics, errors = evaluate_attitudes(found.track, truth)
        if errors is not None:
            text = json.dumps(metrics.to_json(), indent=2, allow_nan=False) + "\n"
            (staging / METRICS_FILE).write_text(text, encoding="utf-8")
        versions = library_versions()
        stated = pipeline_toml(as_run, versions, of_a_run=True)
        (staging / PIPELINE_FILE).write_text(stated, encoding="utf-8")
        name, known = folder.resolve().name, found.track.has_estimate.any()
        tables = (
            tables_for_report(lambda: observability_of_run(staging, title=name)) if known else ()
        )
        report = AttitudeReport(
            title=name,
            command=shlex.join([Path(sys.argv[0]).name, *sys.argv[1:]]),
            track=found.track,
            metrics=metrics,
            errors=errors,
            outcomes=found.outcomes,
            observability=tables,
            configuration=as_run.model_dump(mode="json", include=_used_tables(images)),
            versions=versions,
        )
        write_attitude_report(staging / REPORT_FILE, report)
    return AttitudeRunSummary(out, metrics)


def _from_attitudes(
    recording: AttitudeRecording, pipeline: Pipeline, on_frame: OnFrame | None
) -> _Estimated:
    """The filter of Deng 2024, carried on where there is no attitude."""
    table, frames = pipeline.attitude_inertia, list[AttitudeFrame]()
    estimator = AttitudeInertiaEstimator(table)
    model = TorqueFreeModel(table.angular_acceleration_psd_rad2_s3, table.propagation)
    last: RotationEstimate | None = None
    default = np.radians(table.attitude_sd_deg) ** 2 * np.eye(3)
    for k, (time_s, attitude, covariance) in enumerate(recording):
        if attitude is not None:
            noise = default if covariance is None else covariance
            last = estimator.step(time_s, attitude, noise)
            accepted, nis = bool(last.accepted[0]), float(last.nis[0])
            found = attitude_frame(time_s, (last.state, last.covariance[0]), noise, nis, accepted)
        elif last is not None:
            state, P = carry(model, last.state, last.covariance, time_s - last.time_s)
            found = attitude_frame(time_s, (state, P[0]), None)
        else:
            found = attitude_frame(time_s, None, None)
        frames.append(found)
        if on_frame is not None:
            on_frame(found, k + 1, len(recording))
    return _Estimated(attitude_track(frames), [])


def _from_images(
    source: ImageSource, pipeline: Pipeline, staging: Path, on_frame: OnFrame | None
) -> _Estimated:
    """The chain, and the whole arc of its attitudes fitted as it grows."""
    estimator = ChainedInertiaEstimator(pipeline.attitude_inertia)
    frames: list[AttitudeFrame] = []

    def take(frame: ChainFrame, done: int, count: int) -> None:
        found = estimator.step(frame)
        estimate = None if found is None else (found.state, found.covariance)
        measured = frame.covariance if frame.reference is not None else None
        frames.append(attitude_frame(frame.time_s, estimate, measured))
        if on_frame is not None:
            on_frame(frames[-1], done, count)

    tracks, chained = chain_of(source, pipeline, take)
    if source.is_images:
        write_monocular_files(staging, tracks)
    words = Counter(outcome_in_words(frame.outcome, pipeline.image_motion) for frame in chained)
    track = attitude_track(frames, estimator.axes)
    return _Estimated(track, words.most_common())


def _used_tables(images: ImageSource | None) -> set[str]:
    """What of a pipeline a run reads or adds; the rest of the file describes a simulation."""
    tables = {"sequence", "estimator", str(EstimatorKind.ATTITUDE_INERTIA)}
    if images is None:
        return tables
    return tables | {"image_motion"} | ({"feature_tracker"} if images.is_images else set())
