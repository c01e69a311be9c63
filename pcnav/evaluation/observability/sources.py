"""From a run, or from a pipeline's simulation, to its observability."""

import logging
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from pcnav.config.pipeline_file import EstimatorKind, Pipeline
from pcnav.core.arrays import BoolArray
from pcnav.core.errors import InputError
from pcnav.dynamics.blocks import ATTITUDE, CENTRE, POSITION, RATE, RATIOS, VELOCITY
from pcnav.dynamics.orbit import R_hill_world
from pcnav.dynamics.state import NavigationState
from pcnav.estimators.attitude_inertia.estimator import AttitudeInertiaEstimator
from pcnav.estimators.attitude_inertia.rotation_model import RotationState, TorqueFreeModel
from pcnav.estimators.choice import simulated_kind
from pcnav.estimators.image_motion.chain import run_chain
from pcnav.estimators.registry import ESTIMATORS
from pcnav.evaluation.observability.depth import Views, depth_subject
from pcnav.evaluation.observability.report import ObservabilityReport, observability_of
from pcnav.evaluation.observability.subjects import (
    Subject,
    TargetMotion,
    attitude_subject,
    bank_subject,
    measured_attitudes_subject,
    principal_subject,
)
from pcnav.files.text_table import TextTable
from pcnav.recordings.given_frames import DepthRecording
from pcnav.recordings.opening import open_recording
from pcnav.recordings.recording import Recording, RecordingKind
from pcnav.recordings.sequence import Sequence, stated_or_default_sigma
from pcnav.recordings.tracks import StereoTracks
from pcnav.runs.reader import read_features, read_run
from pcnav.runs.result_files import PIPELINE_FILE, STATES_FILE
from pcnav.runs.run import Run
from pcnav.simulation.depth import Scene
from pcnav.simulation.images import simulated_tracks
from pcnav.simulation.motion import true_motion
from pcnav.simulation.nominal_body import with_nominal_body
from pcnav.simulation.simulate import simulate
from pcnav.target.satellite import Target, load_target, target_mesh_of

_LOG = logging.getLogger("pcnav")

Wanted = Mapping[str, float] | None
"""See `observability_of`."""
_MIN_ATTITUDES = 6
"""That a motion is fitted to."""
_MIN_NOISE_RAD2 = 1e-8
"""Of an attitude, beside what the chain states."""


def observability_of_run(
    folder: Path, wanted: Wanted = None, title: str | None = None
) -> ObservabilityReport:
    """What the motion of a run makes observable, as far as its estimates tell the motion.

    The trajectory is the one that leads to the last estimate. The title is the folder's name where
    none is given. Raises `InputError` when the folder, or what the run was made from, is missing or
    damaged, or when the run has no estimate.
    """
    run = read_run(folder)
    pipeline = run.pipeline
    if pipeline is None or pipeline.sequence is None:
        expected = "expected the recording that the run was made from"
        raise InputError(folder / PIPELINE_FILE, "sequence", expected)
    takes = ESTIMATORS[run.estimator].takes
    # The mesh that images were simulated of is none that their estimator knows.
    named = pipeline.target_mesh if RecordingKind.DEPTH in takes else None
    mesh = None if named is None else Path(named)
    skip_bad_frames = pipeline.skip_bad_frames
    recording = open_recording(Path(pipeline.sequence), mesh, takes, skip_bad_frames)
    target = None
    if isinstance(recording, Sequence):
        mesh = mesh or recording.info.target_mesh
        if mesh is None:
            raise InputError(folder / PIPELINE_FILE, "target_mesh", "expected the target's mesh")
        target = load_target(mesh, pipeline.mesh_unit)
    try:
        subject = _subject_of_run(title or folder.resolve().name, run, recording, target)
    except ValueError as error:
        raise InputError(folder / STATES_FILE, "rows", str(error)) from error
    return observability_of(subject, wanted)


def tables_of_run(run: Run, recording: Recording, target: Target | None) -> tuple[TextTable, ...]:
    """What the motion of a finished run makes observable, as tables; none where it has no motion.

    A run must not be lost to it: what else stands in the way is said in a warning.
    """
    if not run.has_estimate.any() or RATE not in run.trajectory:
        return ()
    if run.estimator == EstimatorKind.IMAGE_MOTION and _attitudes(run).sum() < _MIN_ATTITUDES:
        return ()
    try:
        return observability_of(_subject_of_run(recording.name, run, recording, target)).tables()
    except (InputError, ValueError, np.linalg.LinAlgError) as error:
        _LOG.warning("the report does without its part on observability: %s", error)
        return ()


def observability_of_pipeline(
    pipeline: Pipeline,
    source: Path | str = "pipeline",
    mesh: Path | None = None,
    wanted: Wanted = None,
) -> ObservabilityReport:
    """What the simulated motion of a pipeline makes observable to its estimator.

    Args:
        pipeline: its scenario and estimator.
        source: its file, which an `InputError` names.
        mesh: of the target, for depth frames.
        wanted: see `observability_of`.
    """
    title, kind = Path(source).stem, pipeline.estimator.kind
    if kind == EstimatorKind.IMAGE_MOTION:
        subject: Subject[Any] = _chained_subject(title, pipeline, source, mesh)
        return observability_of(subject, wanted)
    simulation = simulate(pipeline, source, mesh, simulated_kind(pipeline, source))
    truth, recording = simulation.truth, simulation.recording
    motion = TargetMotion(float(truth.time_s[0]), NavigationState.of(truth, 0))
    if isinstance(recording, Scene):
        assert mesh is not None, "without a mesh there is no scene"
        about, camera = recording.info, pipeline.camera
        sigma_m = stated_or_default_sigma(about, pipeline.perception.range_sigma_m)
        views = Views(
            load_target(mesh, pipeline.mesh_unit), camera.pinhole, sigma_m, pipeline.perception
        )
        subject = depth_subject(
            title, pipeline, about, views, motion, truth.time_s, camera.R_cam_hill
        )
    elif isinstance(recording, StereoTracks):
        motion = replace(motion, points=dict(enumerate(simulation.points)))
        try:
            subject = _stereo_subject(title, pipeline, recording, motion)
        except ValueError as error:
            raise InputError(source, "estimator.kind", str(error)) from error
    else:
        table = pipeline.attitude_inertia
        subject = attitude_subject(title, table, motion.rotation, truth.time_s)
    return observability_of(subject, wanted)


def _subject_of_run(
    title: str, run: Run, recording: Recording, target: Target | None
) -> Subject[Any]:
    """Raises ``ValueError`` for a run without an estimate, or of an estimator without a motion."""
    known = np.flatnonzero(run.has_estimate)
    if not known.size:
        raise ValueError("expected at least one estimate")
    pipeline = run.pipeline or Pipeline()
    if run.estimator == EstimatorKind.IMAGE_MOTION:
        return _subject_of_images(title, run, pipeline)
    first, last = int(known[0]), int(known[-1])
    if run.estimator == EstimatorKind.ATTITUDE_INERTIA:
        return _subject_of_attitudes(title, run, pipeline, recording.kind, last)
    motion = TargetMotion(float(run.time_s[last]), _state(run, last))
    if isinstance(recording, StereoTracks):
        features = None if run.folder is None else read_features(run.folder)
        if features is None:
            raise ValueError("expected the features of the run, in features.csv")
        found = np.isfinite(features.p_body).all(axis=1)
        rows = zip(features.feature[found].tolist(), features.p_body[found], strict=True)
        return _stereo_subject(title, pipeline, recording, replace(motion, points=dict(rows)))
    has_place = POSITION in run.trajectory
    if not isinstance(recording, DepthRecording) or target is None or not has_place:
        raise ValueError(f"expected motion and inertia of a target, {run.estimator} reports none")
    info = recording.info
    hill = R_hill_world(motion.time_s, info.mean_motion_rad_s)
    # The pose is that of the model in the camera; the camera's own attitude is what is left.
    R_cam_world = run.trajectory.poses[last, :3, :3] @ motion.state.R_world_body.T
    range_sigma_m = stated_or_default_sigma(info, pipeline.perception.range_sigma_m)
    return depth_subject(
        title,
        pipeline,
        info,
        Views(target, recording.camera(last), range_sigma_m, pipeline.perception),
        motion,
        run.time_s[first : last + 1],
        np.asarray(R_cam_world @ hill.T),
    )


def _state(run: Run, k: int) -> NavigationState:
    """Of frame k; zero where no place is reported.

    Raises ``ValueError`` for an estimator that reports no motion of its own.
    """
    found = run.trajectory
    if not all(block in found for block in (ATTITUDE, RATE, RATIOS)):
        raise ValueError(f"expected motion and inertia of a target, {run.estimator} reports none")
    value = {block: found[block][k] if block in found else np.zeros(3) for block in _BLOCKS}
    return NavigationState(**{name: value[block] for block, name in _BLOCKS.items()})


_BLOCKS = {
    POSITION: "r_hill",
    VELOCITY: "v_hill",
    CENTRE: "com_model",
    ATTITUDE: "R_world_body",
    RATE: "omega_body",
    RATIOS: "inertia_ratios",
}


def _stereo_subject(
    title: str, pipeline: Pipeline, tracks: StereoTracks, motion: TargetMotion
) -> Subject[Any]:
    """Raises ``ValueError`` for an estimator whose model is not known here."""
    match pipeline.estimator.kind:
        case EstimatorKind.PRINCIPAL_AXES:
            return principal_subject(title, pipeline.principal_axes, tracks, motion)
        case EstimatorKind.INERTIA_BANK:
            return bank_subject(title, pipeline.inertia_bank, tracks, motion)
        case kind:
            raise ValueError(f"expected an estimator with a model for it, {kind} has none")


def _subject_of_attitudes(
    title: str, run: Run, pipeline: Pipeline, kind: RecordingKind, last: int
) -> Subject[RotationState]:
    """The motion is the one that leads to the last estimate."""
    measured = run.notes["sd_measured_rad"]
    measured = measured[np.isfinite(measured)]
    if not measured.size:
        raise ValueError("expected at least one measured attitude")
    table = pipeline.attitude_inertia
    end = TargetMotion(float(run.time_s[last]), _state(run, last)).rotation
    start = _carried(end, pipeline, float(run.time_s[last]), float(run.time_s[0]))
    chained = kind is RecordingKind.IMAGES
    return measured_attitudes_subject(title, table, start, run.time_s, measured**2, chained)


def _subject_of_images(title: str, run: Run, pipeline: Pipeline) -> Subject[RotationState]:
    """The motion is the one that fits the attitudes of the longest segment."""
    at = _attitudes(run)
    if at.sum() < _MIN_ATTITUDES:
        raise ValueError(f"expected at least {_MIN_ATTITUDES} attitudes")
    times_s, R, table = run.time_s[at], run.trajectory[ATTITUDE][at], pipeline.attitude_inertia
    # The first attitude of a segment defines its axes and has no error.
    variances = run.trajectory.sd_of(ATTITUDE)[at][1:] ** 2
    estimator = AttitudeInertiaEstimator(table)
    estimate = estimator.step(float(times_s[0]), R[0], _MIN_NOISE_RAD2 * np.eye(3))
    for time_s, attitude, variance in zip(times_s[1:].tolist(), R[1:], variances, strict=True):
        noise = np.diag(variance) + _MIN_NOISE_RAD2 * np.eye(3)
        estimate = estimator.step(time_s, attitude, noise)
    last = estimate.state
    end = RotationState(last.R_world_body[0], last.omega_body[0], last.parameters[0])
    start = _carried(end, pipeline, estimate.time_s, float(run.time_s[0]))
    typical = variances.mean(axis=1)
    return measured_attitudes_subject(title, table, start, run.time_s, typical, True)


def _chained_subject(
    title: str, pipeline: Pipeline, source: Path | str, mesh: Path | None
) -> Subject[RotationState]:
    """The attitudes are those of the chain on simulated tracks, in the target's own axes."""
    pipeline = with_nominal_body(pipeline, mesh)
    motion = true_motion(pipeline, source)
    shown = None if mesh is None else target_mesh_of(mesh, pipeline.mesh_unit)
    frames = run_chain(simulated_tracks(pipeline, motion, shown, title), pipeline.image_motion)
    found = [frame.covariance for frame in frames if frame.reference is not None]
    variances = np.array([np.trace(noise) / 3.0 for noise in found if noise is not None])
    if not variances.size:
        expected = (
            "expected tracks that tell an attitude: no frame of the simulated ones is measured; "
            "look at a run on images instead"
        )
        raise InputError(source, "image_motion", expected)
    start, times_s = TargetMotion(0.0, motion.state(0)).rotation, motion.truth.time_s
    table = pipeline.attitude_inertia
    return measured_attitudes_subject(title, table, start, times_s, variances, True)


def _attitudes(run: Run) -> BoolArray:
    """(n,) frames with an attitude in the segment that has most of them."""
    known, segment = run.has_estimate, run.notes["segment"]
    if not known.any():
        return known
    numbers, counts = np.unique(segment[known], return_counts=True)
    return np.asarray(known & (segment == numbers[np.argmax(counts)]))


def _carried(state: RotationState, pipeline: Pipeline, from_s: float, to_s: float) -> RotationState:
    """A state at another time of its own free motion."""
    if from_s == to_s:
        return state
    model = TorqueFreeModel(0.0, pipeline.attitude_inertia.propagation)
    return model.propagate(state, from_s, to_s - from_s)[0]
