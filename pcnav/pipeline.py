"""The main job as a list of verbs: open, track, write, evaluate, report."""

import filecmp
import logging
import shlex
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from pcnav.config.pipeline_file import Pipeline
from pcnav.core.errors import InputError
from pcnav.dynamics.mass_prior import PriorMass
from pcnav.dynamics.orbit import R_hill_world
from pcnav.estimators.depth.tracker import Tracker
from pcnav.estimators.depth.views import FrameView
from pcnav.evaluation.knowledge import RunKnowledge, knowledge_csv, what_is_known
from pcnav.evaluation.metrics import Metrics, evaluate
from pcnav.evaluation.observability.sources import observability_of_depth, tables_for_report
from pcnav.evaluation.track_errors import truth_of
from pcnav.files.text_table import TextTable
from pcnav.recordings.opening import open_sequence
from pcnav.recordings.sequence import Sequence
from pcnav.recordings.truth import read_truth
from pcnav.report.depth_report import ReportContent, write_report
from pcnav.report.overlay import frame_picture
from pcnav.runs.provenance import library_versions, pipeline_toml
from pcnav.runs.result_writer import ResultWriter
from pcnav.runs.results import (
    KNOWLEDGE_FILE,
    METRICS_FILE,
    PIPELINE_FILE,
    REPORT_FILE,
    FrameEstimate,
    Track,
    count_outcomes,
    read_track,
)
from pcnav.target.mesh import wireframe_edges
from pcnav.target.satellite import Target, load_target
from pcnav.target.symmetry import group_name

_LOG = logging.getLogger("pcnav")

_USED_BY_A_RUN = {"seed", "sequence", "target_mesh", "perception", "filter"}
"""What of a pipeline a run reads or adds; the rest of the file describes a simulation."""

OnStart = Callable[[Sequence, Target, Pipeline], None]
"""Told of what is about to be followed, with the pipeline as run."""
OnEstimate = Callable[[FrameEstimate, int], None]
"""Told of every estimate and of how many frames there are."""


@dataclass(frozen=True)
class RunSummary:
    """What a run leaves behind."""

    folder: Path
    metrics: Metrics
    """Errors in it only where the sequence carries a truth."""
    knowledge: RunKnowledge | None
    """What the data told of every state; None without an estimate."""

    @property
    def report(self) -> Path:
        """The report page."""
        return self.folder / REPORT_FILE


@dataclass(frozen=True)
class _Showcase:
    """The frame that the report shows."""

    estimate: FrameEstimate
    view: FrameView


@dataclass(frozen=True)
class _Followed:
    """What is kept of following the target, beside the estimates written."""

    showcase: _Showcase | None
    """None without frames."""
    prior: PriorMass | None
    """What the last track started from; None when none started."""


def run(
    sequence_path: Path,
    out: Path,
    pipeline: Pipeline,
    *,
    target_mesh: Path | None = None,
    overwrite: bool = False,
    on_start: OnStart | None = None,
    on_estimate: OnEstimate | None = None,
) -> RunSummary:
    """Estimate a target's motion from a depth sequence and write the result folder.

    The mesh is ``target_mesh``, else the one the sequence names, else the pipeline's
    ``target_mesh`` taken as a path. The pipeline saved with the result names the sequence and the
    mesh as absolute paths. Raises `InputError` for a bad sequence, mesh, truth or existing result
    folder; nothing is then left, and an earlier result stays as it was.
    """
    sequence = open_sequence(sequence_path, target_mesh)
    mesh = target_mesh or _mesh_of(sequence, pipeline)
    _refuse_to_replace_input(out, sequence.path, mesh)
    target = load_target(mesh)
    # Read now, so that a fault in it costs no run; nothing but the evaluation is given it.
    truth = truth_of(read_truth(sequence.path))
    origin = {"sequence": str(sequence.path.resolve()), "target_mesh": str(mesh.resolve())}
    as_run = pipeline.model_copy(update=origin)
    with ResultWriter(out, overwrite) as writer:
        # At once: a run that is killed, or still goes on, can then be looked at.
        writer.write_text(PIPELINE_FILE, pipeline_toml(as_run, library_versions(), of_a_run=True))
        if on_start is not None:
            on_start(sequence, target, as_run)
        followed = _track(sequence, target, as_run, writer, on_estimate)
        staging = writer.finish_tables()
        track = read_track(staging, with_covariance=True)
        metrics = evaluate(track, truth, target.symmetry_transforms)
        if metrics.errors is not None:
            writer.write_json(METRICS_FILE, metrics.to_json())
        knowledge = _knowledge(followed.prior, track, sequence.info.mean_motion_rad_s)
        if knowledge is not None:
            writer.write_text(KNOWLEDGE_FILE, knowledge_csv(knowledge))
        picture, caption = _picture(target, followed.showcase)
        report = ReportContent(
            title=sequence.info.name,
            target=target.name,
            command=shlex.join([Path(sys.argv[0]).name, *sys.argv[1:]]),
            track=track,
            outcomes=count_outcomes(staging),
            metrics=metrics,
            configuration=as_run.model_dump(mode="json", include=_USED_BY_A_RUN),
            versions=library_versions(),
            symmetry=group_name(target.symmetry_transforms),
            knowledge=knowledge,
            observability=_observability(as_run, sequence, target, track),
            picture=picture,
            picture_caption=caption,
        )
        write_report(staging / REPORT_FILE, report)
    return RunSummary(out, metrics, knowledge)


def _track(
    sequence: Sequence,
    target: Target,
    pipeline: Pipeline,
    writer: ResultWriter,
    on_estimate: OnEstimate | None,
) -> _Followed:
    """Follow the target through the sequence; the estimates go to the writer as they come."""
    tracker = Tracker(target, sequence.info, pipeline.perception, pipeline.filter, pipeline.seed)
    showcase: _Showcase | None = None
    prior: PriorMass | None = None
    for frame in sequence:
        estimate, view = tracker.step(frame)
        writer.add(estimate)
        showcase = _better(showcase, _Showcase(estimate, view))
        # A track that is lost forgets its prior, not the estimates it made.
        prior = tracker.prior or prior
        if on_estimate is not None:
            on_estimate(estimate, len(sequence))
    return _Followed(showcase, prior)


def _knowledge(
    prior: PriorMass | None, track: Track, mean_motion_rad_s: float
) -> RunKnowledge | None:
    """What the last estimate of a run knows beyond its prior."""
    known = np.flatnonzero(track.has_estimate)
    if prior is None or track.covariance is None or not known.size:
        return None
    last = known[-1]
    R_hill_body = R_hill_world(track.time_s[last], mean_motion_rad_s) @ track.R_world_body[last]
    return what_is_known(prior, track.covariance[last], R_hill_body, track.omega_body[last])


def _observability(
    pipeline: Pipeline, sequence: Sequence, target: Target, track: Track
) -> tuple[TextTable, ...]:
    """What the motion of a run makes observable; nothing is told without an estimate."""
    if not track.has_estimate.any():
        return ()
    return tables_for_report(
        lambda: observability_of_depth(sequence.info.name, pipeline, sequence, target, track)
    )


def _mesh_of(sequence: Sequence, pipeline: Pipeline) -> Path:
    """The mesh where none was given: the sequence knows best what it shows."""
    stated = sequence.info.target_mesh
    named = None if pipeline.target_mesh is None else Path(pipeline.target_mesh)
    mesh = stated or named
    if mesh is None:
        raise InputError(
            sequence.path,
            "target_mesh",
            "expected the target's mesh, in sequence.toml or by --target",
        )
    if named is not None and not (named.is_file() and filecmp.cmp(mesh, named, shallow=False)):
        _LOG.warning("%s: its mesh %s is used, not the pipeline's %s", sequence.path, mesh, named)
    return mesh


def _refuse_to_replace_input(out: Path, sequence: Path, mesh: Path) -> None:
    """Replacing a result folder must not delete what the new result is made from."""
    for source in (sequence, mesh):
        if source.resolve().is_relative_to(out.resolve()):
            raise InputError(out, "folder", f"expected a result folder that does not hold {source}")


def _better(best: _Showcase | None, new: _Showcase) -> _Showcase:
    """The frame with more rectangles used; the later one of equals, being better estimated."""
    if best is None or new.estimate.n_rectangles >= best.estimate.n_rectangles:
        return new
    return best


def _picture(target: Target, showcase: _Showcase | None) -> tuple[Figure | None, str]:
    if showcase is None:
        return None, ""
    estimate, view = showcase.estimate, showcase.view
    frame = view.frame
    picture = frame_picture(
        frame.depth_m,
        frame.camera,
        view.image_labels,
        estimate.records,
        wireframe_edges(target.mesh),
        estimate.T_cam_model,
    )
    return picture, f"Frame {frame.index} at {frame.time_s:g} s, status {estimate.status}."
