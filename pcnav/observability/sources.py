"""From a result folder, or from a pipeline, to its observability."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from pcnav.arrays import FloatArray
from pcnav.config import Pipeline, read_pipeline
from pcnav.config_attitude import AttitudeInertiaTable
from pcnav.config_features import EstimatorKind
from pcnav.csv_table import read_csv
from pcnav.dynamics.orbit import R_hill_world
from pcnav.dynamics.rigid_body import inertia_from_ratios
from pcnav.errors import InputError
from pcnav.estimation.rotation_arc import parameters_of
from pcnav.estimation.rotation_model import RotationState
from pcnav.feature_results import FEATURE_COLUMNS, FEATURES_FILE, MOTION_COLUMNS
from pcnav.observability.depth import Views, depth_subject
from pcnav.observability.report import ObservabilityReport, judge
from pcnav.observability.subjects import (
    FeatureMotion,
    attitude_subject,
    bank_subject,
    principal_subject,
)
from pcnav.results import PIPELINE_FILE, STATES_FILE, read_track
from pcnav.sequences.opening import open_sequence
from pcnav.sequences.track_files import read_tracks
from pcnav.sequences.tracks import Tracks
from pcnav.simulation.features import feature_scenario, simulate_features
from pcnav.simulation.recording import stated_range_sigma
from pcnav.simulation.scenario import camera_rotation, pinhole_camera, true_motion
from pcnav.spatial import exp_rotation, rotation_from_xyzw
from pcnav.target import load_target
from pcnav.tracking.mass import prior_belief

Wanted = Mapping[str, float] | None
"""See `judge`."""
_ATTITUDE_KIND = "attitude_inertia"


def observability_of_run(folder: Path, wanted: Wanted = None) -> ObservabilityReport:
    """What the motion of a run makes observable, as far as its estimates tell the motion.

    The trajectory is the one that leads to the last estimate. Raises `InputError` when the folder,
    or what the run was made from, is missing or damaged, or when the run has no estimate.
    """
    pipeline = read_pipeline(folder / PIPELINE_FILE)
    if pipeline.sequence is None:
        expected = "expected the recording that the run was made from"
        raise InputError(folder / PIPELINE_FILE, "sequence", expected)
    if pipeline.estimator.kind is EstimatorKind.DEPTH:
        return _of_depth_run(folder, pipeline, Path(pipeline.sequence), wanted)
    tracks = read_tracks(Path(pipeline.sequence))
    return _of_features(folder.resolve().name, pipeline, tracks, _last_motion(folder), wanted)


def observability_of_pipeline(
    pipeline: Pipeline,
    source: Path | str = "pipeline",
    mesh: Path | None = None,
    attitude: AttitudeInertiaTable | None = None,
    wanted: Wanted = None,
) -> ObservabilityReport:
    """What the simulated motion of a pipeline makes observable to its estimator.

    Args:
        pipeline: its scenario and estimator.
        source: its file, which an `InputError` names.
        mesh: of the target, for depth frames.
        attitude: settings of the filter on attitudes; given, it is the estimator that is judged.
        wanted: see `judge`.
    """
    title = Path(source).stem
    if attitude is not None:
        return _of_attitudes(title, pipeline, attitude, wanted)
    if pipeline.estimator.kind is EstimatorKind.DEPTH:
        if mesh is None:
            raise InputError(source, "target_mesh", "expected the mesh that depth frames show")
        return _of_depth_pipeline(title, pipeline, source, mesh, wanted)
    scenario = feature_scenario(pipeline, source)
    tracks, truth = simulate_features(scenario, np.random.default_rng(pipeline.seed))
    motion = FeatureMotion(
        time_s=float(truth.times_s[0]),
        r_hill=truth.r_hill[0],
        v_hill=truth.v_hill[0],
        R_world_body=truth.R_world_body[0],
        omega_body=truth.omega_body[0],
        inertia=truth.inertia,
        points=dict(enumerate(truth.points)),
    )
    return _of_features(title, pipeline, tracks, motion, wanted)


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


def _of_depth_pipeline(
    title: str, pipeline: Pipeline, source: Path | str, mesh: Path, wanted: Wanted
) -> ObservabilityReport:
    motion, target = true_motion(pipeline, source), load_target(mesh)
    sigma_m = pipeline.perception.range_sigma_m or stated_range_sigma(pipeline.noise)
    subject = depth_subject(
        title,
        pipeline.filter,
        prior_belief(target, None, pipeline.filter),
        Views(target, pinhole_camera(pipeline.camera), sigma_m),
        pipeline.orbit.mean_motion_rad_s,
        (float(motion.times_s[0]), motion.states[0]),
        motion.times_s,
        camera_rotation(pipeline.camera, source),
    )
    return judge(subject, wanted)


def _of_depth_run(
    folder: Path, pipeline: Pipeline, recording: Path, wanted: Wanted
) -> ObservabilityReport:
    mesh = None if pipeline.target_mesh is None else Path(pipeline.target_mesh)
    sequence = open_sequence(recording, mesh)
    shown = mesh or sequence.info.target_mesh
    if shown is None:
        raise InputError(folder / PIPELINE_FILE, "target_mesh", "expected the target's mesh")
    target, track, info = load_target(shown), read_track(folder), sequence.info
    known = np.flatnonzero(track.has_estimate)
    if not known.size:
        raise InputError(folder / STATES_FILE, "rows", "expected at least one estimate")
    first, last = int(known[0]), int(known[-1])
    state = track.state(last)
    assert state is not None, "the frame has an estimate"
    hill = R_hill_world(float(track.time_s[last]), info.mean_motion_rad_s)
    # The pose is that of the model in the camera; the camera's own attitude is what is left.
    R_cam_world = track.T_cam_model[last, :3, :3] @ state.R_world_body.T
    subject = depth_subject(
        folder.resolve().name,
        pipeline.filter,
        prior_belief(target, info.initial, pipeline.filter),
        Views(
            target,
            sequence.frame(last).camera,
            pipeline.perception.range_sigma_m or info.range_sigma_m,
        ),
        info.mean_motion_rad_s,
        (float(track.time_s[last]), state),
        track.time_s[first : last + 1],
        np.asarray(R_cam_world @ hill.T),
    )
    return judge(subject, wanted)


def _of_features(
    title: str, pipeline: Pipeline, tracks: Tracks, motion: FeatureMotion, wanted: Wanted
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
    rows = read_csv(folder / STATES_FILE, MOTION_COLUMNS).numbers(MOTION_COLUMNS)
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
