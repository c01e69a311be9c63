"""A run on images of one camera as a list of verbs: open, follow, chain, write, evaluate."""

import json
import shlex
import sys
from dataclasses import dataclass
from pathlib import Path

from pcnav.config.pipeline_file import EstimatorKind, EstimatorTable, Pipeline
from pcnav.core.errors import InputError
from pcnav.estimators.image_motion.source import ImageSource, OnFrame, chain_of, open_source
from pcnav.evaluation.image_metrics import evaluate_images
from pcnav.evaluation.metrics import Metrics
from pcnav.evaluation.observability.sources import (
    can_be_judged,
    observability_of_run,
    tables_for_report,
)
from pcnav.evaluation.track_errors import truth_of
from pcnav.files.new_folder import new_folder
from pcnav.recordings.monocular_tracks import write_monocular_files
from pcnav.recordings.truth import read_truth
from pcnav.report.image_report import ImageReport, write_image_report
from pcnav.runs.image_results import image_track, write_states
from pcnav.runs.provenance import library_versions, pipeline_toml
from pcnav.runs.results import METRICS_FILE, PIPELINE_FILE, REPORT_FILE, STATES_FILE


@dataclass(frozen=True)
class ImageRunSummary:
    """What a run leaves behind."""

    folder: Path
    metrics: Metrics
    """Errors in it only where the recording carries a truth."""

    @property
    def report(self) -> Path:
        """The report page."""
        return self.folder / REPORT_FILE


def run_images(
    recording: Path,
    out: Path,
    pipeline: Pipeline,
    *,
    overwrite: bool = False,
    on_frame: OnFrame | None = None,
) -> ImageRunSummary:
    """Estimate a target's attitude and rate from images or tracks and write the result folder.

    A recording of images leaves the tracks of its features in the result, which is then a
    recording itself. Raises `InputError` for a bad recording, truth or existing result folder and
    without the extra `images` where it is needed; nothing is then left, and an earlier result
    stays as it was.
    """
    source = open_source(recording, pipeline)
    if source.place.resolve().is_relative_to(out.resolve()):
        raise InputError(out, "folder", f"expected a result folder that does not hold {recording}")
    # Read now, so that a fault in it costs no run; nothing but the evaluation is given it.
    truth = truth_of(read_truth(source.folder))
    as_run = _as_run(pipeline, source)
    with new_folder(out, overwrite, STATES_FILE) as staging:
        tracks, chained = chain_of(source, pipeline, on_frame)
        seen = [len(frame.features) for frame in tracks.frames]
        track = image_track(chained, seen, pipeline.image_motion)
        write_states(staging, track)
        if source.is_images:
            write_monocular_files(staging, tracks)
        metrics, errors = evaluate_images(track, truth)
        if errors is not None:
            text = json.dumps(metrics.to_json(), indent=2, allow_nan=False) + "\n"
            (staging / METRICS_FILE).write_text(text, encoding="utf-8")
        versions = library_versions()
        stated = pipeline_toml(as_run, versions, of_a_run=True)
        (staging / PIPELINE_FILE).write_text(stated, encoding="utf-8")
        told = can_be_judged(track)
        report = ImageReport(
            title=source.name,
            command=shlex.join([Path(sys.argv[0]).name, *sys.argv[1:]]),
            track=track,
            metrics=metrics,
            errors=errors,
            configuration=as_run.model_dump(mode="json", include=_used_tables(source)),
            versions=versions,
            observability=tables_for_report(
                lambda: observability_of_run(staging, title=source.name)
            )
            if told
            else (),
        )
        write_image_report(staging / REPORT_FILE, report)
    return ImageRunSummary(out, metrics)


def _as_run(pipeline: Pipeline, source: ImageSource) -> Pipeline:
    estimator = EstimatorTable(kind=EstimatorKind.IMAGE_MOTION)
    place = str(source.place.resolve())
    return pipeline.model_copy(update={"sequence": place, "estimator": estimator})


def _used_tables(source: ImageSource) -> set[str]:
    """What of a pipeline a run reads or adds; the rest of the file describes a simulation."""
    tables = {"sequence", "estimator", "image_motion"}
    return tables | {"feature_tracker"} if source.is_images else tables
