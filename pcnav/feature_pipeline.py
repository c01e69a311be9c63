"""A run on feature tracks as a list of verbs: open, estimate, write, evaluate, report."""

import json
import shlex
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from pcnav.config.pipeline_file import EstimatorKind, Pipeline
from pcnav.core.errors import InputError
from pcnav.estimators.inertia_bank.estimator import InertiaBankEstimator
from pcnav.estimators.principal_axes.estimator import PrincipalAxesEstimator
from pcnav.evaluation.feature_metrics import evaluate_features
from pcnav.evaluation.metrics import Metrics
from pcnav.evaluation.observability.sources import observability_of_run, tables_for_report
from pcnav.evaluation.track_errors import truth_of
from pcnav.files.new_folder import new_folder
from pcnav.recordings.stereo_tracks import read_stereo_tracks, read_truth_features
from pcnav.recordings.tracks import StereoTracks
from pcnav.recordings.truth import read_truth
from pcnav.report.feature_report import FeatureReport, write_feature_report
from pcnav.runs.feature_estimate import FeatureEstimate, FeatureEstimator
from pcnav.runs.feature_results import FeatureCollector, FeatureTrack, write_tables
from pcnav.runs.provenance import library_versions, pipeline_toml
from pcnav.runs.results import METRICS_FILE, PIPELINE_FILE, REPORT_FILE, STATES_FILE

OnEstimate = Callable[[FeatureEstimate, int, int], None]
"""Told of every estimate, how many frames are done, and of how many."""

EstimatorOf = Callable[[StereoTracks, Pipeline], FeatureEstimator]
"""Makes an estimator for the rig and orbit of a recording, with the settings of a pipeline."""


@dataclass(frozen=True)
class FeatureRunSummary:
    """What a run leaves behind."""

    folder: Path
    metrics: Metrics
    """Errors in it only where the recording carries a truth."""

    @property
    def report(self) -> Path:
        """The report page."""
        return self.folder / REPORT_FILE


def run_features(
    recording: Path,
    out: Path,
    pipeline: Pipeline,
    *,
    overwrite: bool = False,
    on_estimate: OnEstimate | None = None,
    source: Path | str = "pipeline",
) -> FeatureRunSummary:
    """Estimate a target's motion from feature tracks and write the result folder.

    ``source`` is the pipeline's file. Raises `InputError` for a bad recording, truth or existing
    result folder, and for a pipeline of another estimator; nothing is then left, and an earlier
    result stays as it was.
    """
    make_estimator = _estimator_of(pipeline, source)
    tracks = read_stereo_tracks(recording)
    folder = tracks.path or recording
    if folder.resolve().is_relative_to(out.resolve()):
        raise InputError(out, "folder", f"expected a result folder that does not hold {folder}")
    # Read now, so that a fault in it costs no run; nothing but the evaluation is given it.
    truth, points = truth_of(read_truth(folder)), read_truth_features(folder)
    as_run = pipeline.model_copy(update={"sequence": str(folder.resolve())})
    principal = pipeline.estimator.kind is EstimatorKind.PRINCIPAL_AXES
    with new_folder(out, overwrite, STATES_FILE) as staging:
        track = estimate_tracks(tracks, make_estimator(tracks, as_run), on_estimate)
        write_tables(staging, track)
        metrics, errors = evaluate_features(track, truth, points, principal)
        if errors is not None:
            text = json.dumps(metrics.to_json(), indent=2, allow_nan=False) + "\n"
            (staging / METRICS_FILE).write_text(text, encoding="utf-8")
        versions = library_versions()
        stated = pipeline_toml(as_run, versions, of_a_run=True)
        (staging / PIPELINE_FILE).write_text(stated, encoding="utf-8")
        known = track.has_estimate.any() and bool(track.last_points)
        report = FeatureReport(
            title=tracks.name,
            estimator=str(pipeline.estimator.kind),
            command=shlex.join([Path(sys.argv[0]).name, *sys.argv[1:]]),
            track=track,
            metrics=metrics,
            errors=errors,
            configuration=as_run.model_dump(mode="json", include=_used_tables(pipeline)),
            versions=versions,
            observability=tables_for_report(
                lambda: observability_of_run(staging, title=tracks.name)
            )
            if known
            else (),
        )
        write_feature_report(staging / REPORT_FILE, report)
    return FeatureRunSummary(out, metrics)


def estimate_tracks(
    tracks: StereoTracks, estimator: FeatureEstimator, on_estimate: OnEstimate | None = None
) -> FeatureTrack:
    """Give an estimator every frame of a recording and collect what it says."""
    collector = FeatureCollector(tracks.orbit)
    for k, frame in enumerate(tracks.frames, start=1):
        estimate = estimator.step(frame)
        collector.add(frame, estimate)
        if on_estimate is not None:
            on_estimate(estimate, k, len(tracks.frames))
    return collector.track()


def _principal_axes(tracks: StereoTracks, pipeline: Pipeline) -> FeatureEstimator:
    return PrincipalAxesEstimator(tracks.rig, tracks.orbit, pipeline.principal_axes, pipeline.seed)


def _inertia_bank(tracks: StereoTracks, pipeline: Pipeline) -> FeatureEstimator:
    return InertiaBankEstimator(tracks.rig, tracks.orbit, pipeline.inertia_bank, pipeline.seed)


ESTIMATORS: dict[str, EstimatorOf] = {
    EstimatorKind.PRINCIPAL_AXES: _principal_axes,
    EstimatorKind.INERTIA_BANK: _inertia_bank,
}
"""The estimators that live on feature tracks."""


def _estimator_of(pipeline: Pipeline, source: Path | str) -> EstimatorOf:
    found = ESTIMATORS.get(pipeline.estimator.kind)
    if found is None:
        kinds = " or ".join(f'"{kind}"' for kind in ESTIMATORS)
        expected = f'expected {kinds} for feature tracks, got "{pipeline.estimator.kind}"'
        raise InputError(source, "estimator.kind", expected)
    return found


def _used_tables(pipeline: Pipeline) -> set[str]:
    """What of a pipeline a run reads or adds; the rest of the file describes a simulation."""
    return {"seed", "sequence", "estimator", str(pipeline.estimator.kind)}
