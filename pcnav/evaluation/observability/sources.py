"""From a result folder, or from a pipeline, to its observability."""

import logging
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

from pcnav.config.attitude_inertia import AttitudeInertiaTable
from pcnav.config.pipeline_file import EstimatorKind, Pipeline, read_pipeline
from pcnav.core.arrays import BoolArray, FloatArray, IntArray
from pcnav.core.errors import InputError
from pcnav.core.spatial import exp_rotation, rotation_from_xyzw
from pcnav.dynamics.blocks import ATTITUDE, MOTION_LAYOUT, ROTATION_LAYOUT
from pcnav.dynamics.inertia_parameters import parameters_of
from pcnav.dynamics.orbit import R_hill_world
from pcnav.dynamics.rigid_body import inertia_from_ratios
from pcnav.dynamics.state import NavigationState
from pcnav.estimators.attitude_inertia.estimator import AttitudeInertiaEstimator
from pcnav.estimators.attitude_inertia.rotation_model import RotationState, TorqueFreeModel
from pcnav.estimators.depth.mass import prior_belief
from pcnav.estimators.image_motion.chain import run_chain
from pcnav.evaluation.observability.depth import Views, depth_subject
from pcnav.evaluation.observability.report import ObservabilityReport, Subject, judge
from pcnav.evaluation.observability.subjects import (
    FeatureMotion,
    attitude_subject,
    bank_subject,
    carried,
    measured_attitudes_subject,
    principal_subject,
)
from pcnav.files.csv_table import read_csv
from pcnav.files.text_table import TextTable
from pcnav.recordings.opening import format_of, open_sequence
from pcnav.recordings.recording import Recording, RecordingKind
from pcnav.recordings.sequence import Sequence
from pcnav.recordings.stereo_tracks import read_stereo_tracks
from pcnav.recordings.tracks import StereoTracks
from pcnav.runs.reader import read_run
from pcnav.runs.result_files import FEATURE_COLUMNS, FEATURES_FILE, PIPELINE_FILE, STATES_FILE
from pcnav.runs.run import Run
from pcnav.simulation.depth import stated_range_sigma
from pcnav.simulation.images import simulated_tracks
from pcnav.simulation.motion import true_motion
from pcnav.simulation.stereo import simulate_stereo
from pcnav.target.mesh import read_mesh
from pcnav.target.satellite import Target, load_target

_LOG = logging.getLogger("pcnav")

Wanted = Mapping[str, float] | None
"""See `judge`."""
_FEWEST = 6
"""Attitudes that a motion is fitted to."""
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
    pipeline = read_pipeline(folder / PIPELINE_FILE)
    if pipeline.sequence is None:
        expected = "expected the recording that the run was made from"
        raise InputError(folder / PIPELINE_FILE, "sequence", expected)
    title = title or folder.resolve().name
    if pipeline.estimator.kind is EstimatorKind.DEPTH:
        return _of_depth_run(title, folder, pipeline, wanted)
    if pipeline.estimator.kind is EstimatorKind.ATTITUDE_INERTIA:
        return judge(_attitude_run(title, folder, pipeline), wanted)
    if pipeline.estimator.kind is EstimatorKind.IMAGE_MOTION:
        return judge(_image_run(title, folder, pipeline), wanted)
    tracks = read_stereo_tracks(Path(pipeline.sequence))
    return _of_features(title, pipeline, tracks, _last_motion(folder), wanted)


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
        wanted: see `judge`.
    """
    title = Path(source).stem
    if pipeline.estimator.kind is EstimatorKind.ATTITUDE_INERTIA:
        return _of_attitudes(title, pipeline, pipeline.attitude_inertia, wanted)
    if pipeline.estimator.kind is EstimatorKind.IMAGE_MOTION:
        return _of_image_pipeline(title, pipeline, source, mesh, wanted)
    if pipeline.estimator.kind is EstimatorKind.DEPTH:
        if mesh is None:
            raise InputError(source, "target_mesh", "expected the mesh that depth frames show")
        return _of_depth_pipeline(title, pipeline, source, mesh, wanted)
    tracks, truth, points = simulate_stereo(pipeline, source)
    start = NavigationState.of(truth, 0)
    motion = FeatureMotion(
        time_s=float(truth.time_s[0]),
        r_hill=start.r_hill,
        v_hill=start.v_hill,
        R_world_body=start.R_world_body,
        omega_body=start.omega_body,
        inertia=start.inertia,
        points=dict(enumerate(points)),
    )
    return _of_features(title, pipeline, tracks, motion, wanted)


def tables_for_report(judged: Callable[[], ObservabilityReport]) -> tuple[TextTable, ...]:
    """What a motion makes observable, as tables; none where that cannot be told.

    A run must not be lost to it: what stands in the way is said in a warning.
    """
    try:
        return judged().tables()
    except (InputError, ValueError, np.linalg.LinAlgError) as error:
        _LOG.warning("the report does without its part on observability: %s", error)
        return ()


def tables_of_run(run: Run, recording: Recording, target: Target | None) -> tuple[TextTable, ...]:
    """What the motion of a finished run makes observable; none of one that cannot be judged."""
    pipeline, folder = run.pipeline, run.folder
    if pipeline is None or folder is None or not run.has_estimate.any():
        return ()
    if isinstance(recording, Sequence):
        if target is None or not run.trajectory.layout.blocks:
            return ()
        known = target
        return tables_for_report(
            lambda: observability_of_depth(recording.name, pipeline, recording, known, run)
        )
    if "segment" in run.notes:
        segment = run.notes["segment"].astype(np.intp)
        if np.count_nonzero(_of_longest_segment(segment, run.has_estimate)) < _FEWEST:
            return ()
    return tables_for_report(lambda: observability_of_run(folder, title=recording.name))


def _of_longest_segment(segment: IntArray, known: BoolArray) -> BoolArray:
    """(n,) frames with an attitude in the segment that has most of them."""
    if not known.any():
        return known
    numbers, counts = np.unique(segment[known], return_counts=True)
    return np.asarray(known & (segment == numbers[np.argmax(counts)]))


def _of_attitudes(
    title: str, pipeline: Pipeline, table: AttitudeInertiaTable, wanted: Wanted
) -> ObservabilityReport:
    body, scenario = pipeline.body, pipeline.scenario
    start = RotationState(
        exp_rotation(np.radians(np.array(body.attitude_rotvec_deg))),
        np.radians(np.array(body.omega_body_deg_s)),
        parameters_of(inertia_from_ratios(np.array(body.inertia_ratios))),
    )
    times_s = np.arange(scenario.frames) / scenario.frame_rate_hz
    return judge(attitude_subject(title, table, start, times_s), wanted)


def _of_image_pipeline(
    title: str, pipeline: Pipeline, source: Path | str, mesh: Path | None, wanted: Wanted
) -> ObservabilityReport:
    """The attitudes are those of the chain on simulated tracks, in the target's own axes."""
    truth = true_motion(pipeline, source)
    shown = None if mesh is None else read_mesh(mesh)
    tracks = simulated_tracks(pipeline, truth, shown, title)
    frames = run_chain(tracks, pipeline.image_motion)
    known = [frame.covariance for frame in frames if frame.reference is not None]
    noise = [each for each in known if each is not None]
    if not noise:
        expected = (
            "expected tracks that tell an attitude: no frame of the simulated ones is measured; "
            "look at a run on images instead"
        )
        raise InputError(source, "image_motion", expected)
    state = truth.state(0)
    start = RotationState(
        state.R_world_body,
        state.omega_body,
        parameters_of(inertia_from_ratios(state.inertia_ratios)),
    )
    subject = measured_attitudes_subject(
        title, pipeline.attitude_inertia, start, truth.truth.time_s, np.stack(noise), True
    )
    return judge(subject, wanted)


def _image_run(title: str, folder: Path, pipeline: Pipeline) -> Subject[RotationState]:
    """The motion is the one that fits the attitudes of the longest segment."""
    names = ("time_s", *ATTITUDE.columns, "segment", *ATTITUDE.sd_columns)
    rows = read_csv(folder / STATES_FILE, names).numbers(names)
    has_attitude = np.isfinite(rows[:, 1])
    at = _of_longest_segment(rows[:, 5].astype(np.intp), has_attitude)
    if np.count_nonzero(at) < _FEWEST:
        raise InputError(folder / STATES_FILE, "rows", f"expected at least {_FEWEST} attitudes")
    times_s, R, sd = rows[at, 0], rotation_from_xyzw(rows[at, 1:5]), rows[at, 6:9]
    # The first attitude of a segment defines its axes and has no error.
    noise = np.einsum("ni,ij->nij", sd[1:] ** 2, np.eye(3))
    table = pipeline.attitude_inertia
    estimator = AttitudeInertiaEstimator(table)
    floor = _MIN_NOISE_RAD2 * np.eye(3)
    estimate = estimator.step(float(times_s[0]), R[0], floor)
    for k in range(1, len(times_s)):
        estimate = estimator.step(float(times_s[k]), R[k], noise[k - 1] + floor)
    model = TorqueFreeModel(0.0, table.propagation)
    last = estimate.state
    end = RotationState(last.R_world_body[0], last.omega_body[0], last.parameters[0])
    start = carried(model, end, estimate.time_s, float(rows[0, 0]))
    return measured_attitudes_subject(title, table, start, rows[:, 0], noise, True)


def _attitude_run(title: str, folder: Path, pipeline: Pipeline) -> Subject[RotationState]:
    """The motion is the one that leads to the last estimate."""
    names = ("time_s", *ROTATION_LAYOUT.columns, "sd_measured_rad")
    rows = read_csv(folder / STATES_FILE, names).numbers(names)
    known = np.flatnonzero(np.isfinite(rows[:, 1:-1]).all(axis=1))
    measured = rows[np.isfinite(rows[:, -1]), -1]
    if not known.size or not measured.size:
        raise InputError(folder / STATES_FILE, "rows", "expected at least one estimate")
    last = rows[known[-1]]
    table = pipeline.attitude_inertia
    end = RotationState(
        rotation_from_xyzw(last[1:5]),
        last[5:8],
        parameters_of(inertia_from_ratios(last[8:13])),
    )
    model = TorqueFreeModel(0.0, table.propagation)
    start = carried(model, end, float(last[0]), float(rows[0, 0]))
    noise = measured[:, None, None] ** 2 * np.eye(3)
    chained = format_of(Path(pipeline.sequence or "")).kind is RecordingKind.IMAGES
    return measured_attitudes_subject(title, table, start, rows[:, 0], noise, chained)


def _of_depth_pipeline(
    title: str, pipeline: Pipeline, source: Path | str, mesh: Path, wanted: Wanted
) -> ObservabilityReport:
    motion, target = true_motion(pipeline, source), load_target(mesh)
    sigma_m = pipeline.perception.range_sigma_m or stated_range_sigma(pipeline.noise)
    subject = depth_subject(
        title,
        pipeline.filter,
        prior_belief(target, None, pipeline.filter),
        Views(target, pipeline.camera.pinhole, sigma_m),
        pipeline.orbit.mean_motion_rad_s,
        (float(motion.truth.time_s[0]), motion.state(0)),
        motion.truth.time_s,
        pipeline.camera.R_cam_hill,
    )
    return judge(subject, wanted)


def _of_depth_run(
    title: str, folder: Path, pipeline: Pipeline, wanted: Wanted
) -> ObservabilityReport:
    mesh = None if pipeline.target_mesh is None else Path(pipeline.target_mesh)
    sequence = open_sequence(Path(pipeline.sequence or ""), mesh)
    shown = mesh or sequence.info.target_mesh
    if shown is None:
        raise InputError(folder / PIPELINE_FILE, "target_mesh", "expected the target's mesh")
    try:
        return observability_of_depth(
            title, pipeline, sequence, load_target(shown), read_run(folder), wanted
        )
    except ValueError as error:
        raise InputError(folder / STATES_FILE, "rows", str(error)) from error


def observability_of_depth(
    title: str,
    pipeline: Pipeline,
    sequence: Sequence,
    target: Target,
    run: Run,
    wanted: Wanted = None,
) -> ObservabilityReport:
    """As `observability_of_run`, of a run on depth frames that is at hand.

    Raises ``ValueError`` for a run without an estimate.
    """
    known, info = np.flatnonzero(run.has_estimate), sequence.info
    if not known.size:
        raise ValueError("expected at least one estimate")
    first, last = int(known[0]), int(known[-1])
    trajectory = run.trajectory
    state = NavigationState.of(trajectory, last)
    assert trajectory.T_cam_target is not None, "the frame has an estimate"
    hill = R_hill_world(float(run.time_s[last]), info.mean_motion_rad_s)
    # The pose is that of the model in the camera; the camera's own attitude is what is left.
    R_cam_world = trajectory.T_cam_target[last, :3, :3] @ state.R_world_body.T
    range_sigma_m = pipeline.perception.range_sigma_m or info.range_sigma_m
    subject = depth_subject(
        title,
        pipeline.filter,
        prior_belief(target, info.initial, pipeline.filter),
        Views(target, sequence.frame(last).camera, range_sigma_m),
        info.mean_motion_rad_s,
        (float(run.time_s[last]), state),
        run.time_s[first : last + 1],
        np.asarray(R_cam_world @ hill.T),
    )
    return judge(subject, wanted)


def _of_features(
    title: str, pipeline: Pipeline, tracks: StereoTracks, motion: FeatureMotion, wanted: Wanted
) -> ObservabilityReport:
    if pipeline.estimator.kind is EstimatorKind.PRINCIPAL_AXES:
        return judge(principal_subject(title, pipeline.principal_axes, tracks, motion), wanted)
    if pipeline.estimator.kind is EstimatorKind.INERTIA_BANK:
        return judge(bank_subject(title, pipeline.inertia_bank, tracks, motion), wanted)
    raise InputError(
        title, "estimator.kind", f'expected one on feature tracks, got "{pipeline.estimator.kind}"'
    )


def _last_motion(folder: Path) -> FeatureMotion:
    """The last estimate of a run on feature tracks."""
    columns = ("time_s", *MOTION_LAYOUT.columns)
    rows = read_csv(folder / STATES_FILE, columns).numbers(columns)
    rows = rows[np.isfinite(rows).all(axis=1)]
    features = read_csv(folder / FEATURES_FILE, FEATURE_COLUMNS[:4])
    points = _points(features.numbers(FEATURE_COLUMNS[:4]))
    if not len(rows) or not points:
        raise InputError(folder / STATES_FILE, "rows", "expected at least one estimate")
    last = rows[-1]
    return FeatureMotion(
        time_s=float(last[0]),
        r_hill=last[1:4],
        v_hill=last[4:7],
        R_world_body=rotation_from_xyzw(last[7:11]),
        omega_body=last[11:14],
        inertia=inertia_from_ratios(last[14:19]),
        points=points,
    )


def _points(rows: FloatArray) -> dict[int, FloatArray]:
    return {int(row[0]): row[1:4] for row in rows if np.all(np.isfinite(row))}
