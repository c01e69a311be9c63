"""The main job as a list of verbs: open, estimate, write, evaluate, report. One for all kinds."""

import filecmp
import logging
import shlex
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Self

from matplotlib.figure import Figure

from pcnav.config.first_pose import FirstPoseTable
from pcnav.config.length_unit import LengthUnit
from pcnav.config.pipeline_file import EstimatorTable, Pipeline
from pcnav.core.errors import InputError
from pcnav.dynamics.kepler import KeplerOrbit
from pcnav.estimators.choice import chosen
from pcnav.estimators.image_motion.source import TrackedImages
from pcnav.estimators.interface import Estimator, Given
from pcnav.estimators.registry import make_estimator
from pcnav.evaluation.answer.model import Answer, RunState
from pcnav.evaluation.answer.telling import About, answer_of
from pcnav.evaluation.diagnosis import Diagnosis, Facts, diagnosis
from pcnav.evaluation.information_gain import InformationGain, gain_csv, gain_of_run
from pcnav.evaluation.mesh_fit import mesh_fit_csv, sentences
from pcnav.evaluation.metrics import Metrics, evaluate
from pcnav.evaluation.observability.sources import tables_of_run
from pcnav.evaluation.size_check import view_spans
from pcnav.perception.part_fit import MeshFit, PartFit
from pcnav.recordings.first_pose import prior_of
from pcnav.recordings.frame_survey import FrameSurvey, FrameSurveyor
from pcnav.recordings.images import ImageSequence
from pcnav.recordings.intake import Intake, skipped_frames_csv
from pcnav.recordings.opening import open_recording
from pcnav.recordings.recording import Recording, truth_folder
from pcnav.recordings.region_files import resolved
from pcnav.recordings.sequence import Frame, Sequence
from pcnav.recordings.stereo_tracks import read_truth_features
from pcnav.recordings.tracks import StereoTracks
from pcnav.recordings.truth import read_truth
from pcnav.report.content import ReportContent
from pcnav.report.overlay import frame_picture
from pcnav.report.run_report import write_report
from pcnav.runs.estimate import Estimate, Output
from pcnav.runs.provenance import library_versions, pipeline_toml
from pcnav.runs.reader import read_run
from pcnav.runs.result_files import (
    KNOWLEDGE_FILE,
    MESH_FIT_FILE,
    METRICS_FILE,
    PIPELINE_FILE,
    REPORT_FILE,
    SKIPPED_FRAMES_FILE,
    SUMMARY_FILE,
)
from pcnav.runs.status import CLAIMED
from pcnav.runs.writer import RunWriter
from pcnav.target.mesh import wireframe_edges
from pcnav.target.satellite import Target, load_target

_LOG = logging.getLogger("pcnav")

OnStart = Callable[[Pipeline, Output], None]
"""Told, before the first frame, of the pipeline as run and of what the estimates will hold."""
OnEstimate = Callable[[Estimate, int, int], None]
"""Told of every estimate, how many frames are done, and of how many."""


@dataclass(frozen=True)
class RunSummary:
    """What a run leaves behind."""

    folder: Path
    answer: Answer
    """What was found, and the warnings about it."""
    metrics: Metrics
    """Errors in it only where the recording carries a truth."""
    gain: InformationGain | None
    """What the data told of every state; None without a prior or an estimate."""
    diagnosis: Diagnosis
    """Whether anything was found, and in words what went wrong."""

    @property
    def warnings(self) -> tuple[str, ...]:
        """What went wrong, in sentences; empty where nothing did."""
        return (*self.diagnosis.warnings, *self.diagnosis.said)

    @property
    def report(self) -> Path:
        """The report page."""
        return self.folder / REPORT_FILE


@dataclass(frozen=True)
class _Inputs:
    """What a run is made from."""

    recording: Recording
    as_run: Pipeline
    """Names the estimator, and recording and mesh as absolute paths."""
    target: Target | None
    """Of depth frames."""

    @property
    def path(self) -> Path:
        """Of the recording."""
        assert self.recording.path is not None, "it was read from a file"
        return self.recording.path

    def beginning_at(self, initial_pose: FirstPoseTable) -> Self:
        """The same with another first pose. Raises `InputError` where there is no model."""
        if self.target is None:
            expected = "expected none: only depth frames show a target with a model"
            raise InputError(self.path, "--initial-pose", expected)
        as_run = self.as_run.model_copy(update={"initial_pose": initial_pose})
        return replace(self, as_run=as_run)

    def frames(self) -> Recording | Intake:
        """What the estimator is given; of depth frames what the settings leave of them."""
        if not isinstance(self.recording, Sequence):
            return self.recording
        return Intake(self.recording, self.as_run.region, self.as_run.skip_bad_frames)

    def make_estimator(self) -> Estimator:
        """The one that is run."""
        about: Any = self.recording
        if isinstance(about, Sequence):
            first_pose = prior_of(self.as_run.initial_pose) or about.info.first_pose
            about = replace(about.info, first_pose=first_pose)
        given = Given(self.as_run, about, self.target)
        return make_estimator(str(self.as_run.estimator.kind), given)


def run(
    path: Path,
    out: Path,
    pipeline: Pipeline | None = None,
    *,
    estimator: str | None = None,
    target_mesh: Path | None = None,
    mesh_unit: LengthUnit | None = None,
    initial_pose: FirstPoseTable | None = None,
    overwrite: bool = False,
    source: Path | str = "pipeline",
    on_start: OnStart | None = None,
    on_estimate: OnEstimate | None = None,
) -> RunSummary:
    """Estimate a target's motion from a recording of any kind and write the result folder.

    Args:
        path: of the recording: a folder, a table or a video.
        out: the result folder.
        pipeline: settings and estimator; without one, those that the kind of recording has.
        estimator: key in the registry; replaces the pipeline's.
        target_mesh: of depth frames; else the one the sequence names, else the pipeline's
            ``target_mesh`` taken as a path.
        mesh_unit: of its coordinates; replaces what pipeline, sequence and files say.
        initial_pose: of the target in the first depth frame; replaces the pipeline's and the
            sequence's.
        overwrite: whether an earlier result may be replaced.
        source: the pipeline's file, which an `InputError` names.
        on_start: see `OnStart`.
        on_estimate: see `OnEstimate`.

    Raises `InputError` for a bad recording, mesh, truth or existing result folder, and for an
    estimator that does not fit; nothing is then left, and an earlier result stays as it was.
    """
    inputs = _open(path, out, pipeline, estimator, target_mesh, mesh_unit, source)
    if initial_pose is not None:
        inputs = inputs.beginning_at(initial_pose)
    # Read now, so that a fault in it costs no run; nothing but the evaluation is given it.
    folder = truth_folder(inputs.path)
    truth, points = read_truth(folder), read_truth_features(folder)
    symmetries = None if inputs.target is None else inputs.target.symmetry_transforms
    roundness = None if inputs.target is None else inputs.target.roundness
    running = inputs.make_estimator()
    with RunWriter(out, running.output, overwrite) as writer:
        # At once: a run that is killed, or still goes on, can then be looked at.
        versions = library_versions()
        writer.write_text(PIPELINE_FILE, pipeline_toml(inputs.as_run, versions, of_a_run=True))
        if on_start is not None:
            on_start(inputs.as_run, running.output)
        frames = inputs.frames()
        # An earlier result is worth more than the beginning of a new one.
        keep = not out.exists()
        survey, parts, state = _estimate(inputs, frames, running, writer, on_estimate, keep)
        remarks = frames.remarks if isinstance(frames, Intake) else ()
        if isinstance(frames, Intake) and frames.skipped:
            writer.write_text(SKIPPED_FRAMES_FILE, skipped_frames_csv(frames.skipped))
        staging = writer.finish_tables()
        if isinstance(inputs.recording, TrackedImages):
            inputs.recording.write(staging)
        found = read_run(staging, with_covariance=True)
        metrics = evaluate(
            found, truth, symmetry_transforms=symmetries, roundness=roundness, true_points=points
        )
        if metrics.errors is not None:
            writer.write_json(METRICS_FILE, metrics.to_json())
        gain = None
        if running.prior is not None:
            assert isinstance(inputs.recording, Sequence), "only runs on depth frames have one"
            orbit_rate = inputs.recording.info.mean_motion_rad_s
            gain = gain_of_run(found, running.prior, orbit_rate)
        if gain is not None:
            writer.write_text(KNOWLEDGE_FILE, gain_csv(gain))
        if parts:
            writer.write_text(MESH_FIT_FILE, mesh_fit_csv(parts))
        says = diagnosis(found, _facts(inputs, running, survey))
        warnings = (*remarks, *says.warnings, *sentences(parts))
        about = _about(inputs, running, (*warnings, *says.said), state)
        answer = answer_of(found, metrics, about)
        writer.write_json(SUMMARY_FILE, answer.model_dump(mode="json"))
        if state is RunState.FINISHED:
            picture, caption = _picture(inputs.target, running)
            content = ReportContent(
                title=inputs.recording.name,
                command=shlex.join([Path(sys.argv[0]).name, *sys.argv[1:]]),
                answer=answer,
                run=found,
                metrics=metrics,
                gain=gain,
                parts=parts,
                observability=tables_of_run(found, inputs.recording, inputs.target),
                configuration=inputs.as_run.stated(of_a_run=True),
                versions=versions,
                picture=picture,
                picture_caption=caption,
            )
            write_report(staging / REPORT_FILE, content)
    for sentence in warnings:
        _LOG.warning("%s", sentence)
    if state is RunState.INTERRUPTED:
        _LOG.warning("interrupted: %s holds the %d frames that were done", out, len(found))
        raise KeyboardInterrupt
    return RunSummary(out, answer, metrics, gain, says)


def _about(
    inputs: _Inputs, estimator: Estimator, warnings: tuple[str, ...], state: RunState
) -> About:
    recording, target = inputs.recording, inputs.target
    orbit = recording.orbit if isinstance(recording, StereoTracks) else None
    if isinstance(recording, Sequence):
        orbit = KeplerOrbit(recording.info.mean_motion_rad_s)
    return About(
        recording=recording.name,
        target=None if target is None else target.name,
        symmetry="C1" if target is None else target.symmetry_name,
        mesh_scale=estimator.mesh_scale,
        orbit=orbit,
        prior=estimator.prior,
        warnings=warnings,
        state=state,
    )


def _open(
    path: Path,
    out: Path,
    pipeline: Pipeline | None,
    estimator: str | None,
    target_mesh: Path | None,
    mesh_unit: LengthUnit | None,
    source: Path | str,
) -> _Inputs:
    choice = chosen(path, pipeline, estimator, source)
    skip_bad_frames = pipeline is not None and pipeline.skip_bad_frames
    recording = open_recording(path, target_mesh, (choice.kind,), skip_bad_frames)
    assert recording.path is not None, "it was read from a file"
    pipeline, inputs, target = pipeline or Pipeline(), [recording.path], None
    as_run: dict[str, object] = {"sequence": str(recording.path.resolve())}
    if str(pipeline.estimator.kind) != choice.estimator:
        as_run["estimator"] = EstimatorTable(kind=choice.estimator)
    if isinstance(recording, Sequence):
        mesh, unit = _mesh_of(recording, pipeline, target_mesh)
        mesh_unit = mesh_unit or unit
        inputs.append(mesh)
        as_run["target_mesh"] = str(mesh.resolve())
        as_run["mesh_unit"] = mesh_unit
        as_run["time_zero_s"] = recording.info.time_zero_s
        as_run["region"] = resolved(pipeline.region, recording.path)
    for each in inputs:
        # Replacing a result folder must not delete what the new result is made from.
        if each.resolve().is_relative_to(out.resolve()):
            raise InputError(out, "folder", f"expected a result folder that does not hold {each}")
    if isinstance(recording, Sequence):
        target = load_target(mesh, mesh_unit)
    if isinstance(recording, ImageSequence):
        recording = TrackedImages(recording, pipeline.feature_tracker)
    return _Inputs(recording, pipeline.model_copy(update=as_run), target)


def _mesh_of(
    sequence: Sequence, pipeline: Pipeline, given: Path | None
) -> tuple[Path, LengthUnit | None]:
    """The mesh and its unit, where one is stated: the sequence knows best what it shows."""
    if given is not None:
        return given, None
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
        return mesh, sequence.info.mesh_unit
    return mesh, sequence.info.mesh_unit or pipeline.mesh_unit


def _estimate(
    inputs: _Inputs,
    frames: Recording | Intake,
    estimator: Estimator,
    writer: RunWriter,
    on_estimate: OnEstimate | None,
    keep: bool,
) -> tuple[FrameSurvey | None, tuple[PartFit, ...], RunState]:
    """Give the estimator every frame; the estimates go to the writer as they come.

    What is returned tells what depth frames hold, and how the target's parts lie in them. Where
    what was done is to be kept (``keep``) when the run is interrupted, the frames end there.
    """
    done, surveyor, state = 0, FrameSurveyor(), RunState.FINISHED
    fit = None if inputs.target is None else MeshFit(inputs.target)
    coming = iter(frames)
    while True:
        try:
            frame = next(coming, None)
            if frame is None:
                break
            estimate = estimator.step(frame)
        except KeyboardInterrupt:
            if not keep or not done:
                raise
            state = RunState.INTERRUPTED
            break
        done += 1
        if isinstance(frame, Frame):
            surveyor.add(frame)
        estimate = writer.add(estimate)
        noise = estimator.sensor_noise
        if fit is not None and noise is not None and estimate.status in CLAIMED:
            pose = estimate.T_cam_target
            assert isinstance(frame, Frame) and pose is not None, "a claim is of a pose"
            fit.add(frame, pose, noise, estimator.mesh_scale)
        if on_estimate is not None:
            # A damaged video may end before, or after, what its header says.
            on_estimate(estimate, done, max(len(frames), done))
    if not done:
        raise InputError(inputs.path, "file", "expected at least one frame that can be read")
    revised = estimator.finish() if state is RunState.FINISHED else None
    if revised is not None:
        writer.revise(revised)
    parts = () if fit is None else fit.parts()
    survey = surveyor.survey() if isinstance(inputs.recording, Sequence) else None
    return survey, parts, state


def _facts(inputs: _Inputs, estimator: Estimator, survey: FrameSurvey | None) -> Facts:
    """What is known of a run beside its tables."""
    target = inputs.target
    diameter_m = float("nan") if target is None else target.diameter_m
    about, stated_m = inputs.recording, inputs.as_run.perception.range_sigma_m
    if stated_m is None and isinstance(about, Sequence):
        stated_m = about.info.range_sigma_m
    return Facts(
        *(survey, diameter_m),
        view_spans=None if target is None else partial(view_spans, target),
        metres_per_unit=1.0 if target is None else target.mesh_origin.metres_per_unit,
        min_frames=estimator.min_frames,
        search=estimator.search_report,
        noise=estimator.sensor_noise,
        stated_sigma_m=stated_m,
        mesh_scale=estimator.mesh_scale,
    )


def _picture(target: Target | None, estimator: Estimator) -> tuple[Figure | None, str]:
    if target is None or estimator.best_view is None:
        return None, ""
    estimate, view = estimator.best_view
    frame = view.frame
    picture = frame_picture(
        frame.depth_m,
        frame.camera,
        view.image_labels,
        estimate.records,
        wireframe_edges(target.mesh),
        estimate.T_cam_target,
    )
    return picture, f"Frame {frame.index} at {frame.time_s:g} s, status {estimate.status}."
