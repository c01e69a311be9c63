"""Which motion a target is followed as, on poses alone: no frame is rendered."""

from dataclasses import replace

import numpy as np
import pytest

from pcnav.config.depth import FilterTable, MotionChoice
from pcnav.core.arrays import FloatArray
from pcnav.core.spatial import exp_rotation, rotation_angle
from pcnav.dynamics.inertia_parameters import parameter_covariance
from pcnav.dynamics.mass_prior import MassBelief
from pcnav.dynamics.state import NavigationState
from pcnav.estimators.depth.following import FollowedMotion, FreeBody, MotionSetup
from pcnav.estimators.depth.initial_arc import InitialArc, Timed
from pcnav.estimators.depth.mass_centre import MassCentreModel
from pcnav.estimators.depth.pose_measurement import (
    ObserverPose,
    PoseMeasurement,
    PoseReference,
    moved_pose,
)
from pcnav.filtering.map_arc_fit import TimedMeasurements

STEP_S, SD = 0.5, np.repeat([4e-4, 3e-4], 3)
OBSERVER = ObserverPose(np.eye(4), np.eye(3))
RATIOS = np.array([0.577, 0.735, -0.02, 0.06, -0.045])
START = NavigationState(
    r_hill=np.array([0.2, -0.1, 20.0]),
    v_hill=np.array([0.003, -0.002, 0.001]),
    com_model=np.array([0.05, 0.04, -0.06]),
    R_world_body=exp_rotation(np.array([0.4, 0.7, -0.5])),
    omega_body=np.deg2rad([2.0, -1.4, 2.5]),
    inertia_ratios=RATIOS,
)
PRIOR = MassBelief(
    np.zeros(3), 0.1**2 * np.eye(3), RATIOS + 0.03, parameter_covariance(RATIOS, np.full(5, 0.1))
)
FREE = MassCentreModel(0.0, 1e-14, 1e-16)


def pose(state: NavigationState) -> FloatArray:
    return state.T_cam_model(np.eye(4), np.eye(3))


def free_poses(n: int, impulse_at: int = -1, torque_from: int = 10**9) -> list[FloatArray]:
    """n poses of a free body, but for a change of its rate by 1 deg/s or a constant torque."""
    state, poses = START, [pose(START)]
    for k in range(1, n):
        for _ in range(5):
            state = FREE.propagate(state, 0.0, 0.2 * STEP_S)[0]
            if k >= torque_from:
                omega = state.omega_body + np.deg2rad([0.0, 0.05, 0.0]) * 0.2 * STEP_S
                state = replace(state, omega_body=omega)
        if k == impulse_at:
            omega = state.omega_body + np.deg2rad([0.6, -0.6, 0.5])
            state = replace(state, omega_body=omega)
        poses.append(pose(state))
    return poses


def measured(poses: list[FloatArray], noise: float = 1.0) -> list[Timed]:
    """As frames would measure them, with errors so many times what is stated."""
    rng = np.random.default_rng(7)
    arc = []
    for k, T_cam_model in enumerate(poses):
        seen = moved_pose(T_cam_model, noise * SD * rng.standard_normal(6))
        measurement = PoseMeasurement(PoseReference(seen, OBSERVER), np.diag(1.0 / SD), np.zeros(6))
        arc.append(TimedMeasurements[NavigationState](STEP_S * k, (measurement,)))
    return arc


def followed(
    arc: list[Timed], choice: MotionChoice = MotionChoice.AUTO, first: int = 4
) -> tuple[FollowedMotion, list[str], list[FloatArray]]:
    """The motion at the end, as what it was followed frame by frame, and the poses."""
    table = FilterTable(motion=choice, gate_probability=1.0 - 1e-15)
    setup = MotionSetup(FREE, table, 2.5)
    begin = replace(START, com_model=PRIOR.com_model, inertia_ratios=PRIOR.inertia_ratios)
    initial = InitialArc(FREE, begin, PRIOR)
    initial.frames = arc[:first]
    fit = None if choice is MotionChoice.KINEMATIC else initial.fit()
    free = None if fit is None else FreeBody.of(fit, initial, table)
    motion = FollowedMotion(setup, PRIOR, free, begin, arc[:first])
    names, poses = [str(motion.name)] * first, [pose(motion.kalman.state)] * first
    for timed in arc[first:]:
        motion.predict(timed.time_s)
        result = motion.kalman.update(timed.measurements)
        if motion.kinematic is None:
            continue
        if any(result.accepted):
            motion.take_in(timed.measurements, result.accepted)
        else:
            motion.go_over()
            assert motion.kinematic is not None
            motion.kinematic.take_in(timed.measurements)
        names.append(str(motion.name))
        poses.append(pose(motion.kalman.state))
    return motion, names, poses


@pytest.mark.parametrize("noise", [1.0, 1.8, 0.5])
def test_a_free_body_is_followed_as_one_whatever_the_noise_is_stated_as(noise: float) -> None:
    _, names, _ = followed(measured(free_poses(60), noise))
    assert set(names) == {"torque_free"}


def test_a_prescribed_motion_goes_over_and_stays_over() -> None:
    poses = []
    for k in range(60):
        T_cam_model = pose(START).copy()
        turn = np.array([0.3 * np.sin(0.5 * k), 0.2 * np.sin(0.33 * k), 0.0])
        T_cam_model[:3, :3] = T_cam_model[:3, :3] @ exp_rotation(turn)
        T_cam_model[:3, 3] += 0.2 * np.sin(0.4 * k)
        poses.append(T_cam_model)
    _, names, estimated = followed(measured(poses))
    assert set(names[12:]) == {"kinematic"}
    errors = [
        float(np.linalg.norm(a[:3, 3] - b[:3, 3]))
        for a, b in zip(estimated[12:], poses[12:], strict=True)
    ]
    assert np.sqrt(np.mean(np.square(errors))) < 2.0 * np.sqrt(3.0) * SD[0]


def test_an_impulse_is_followed_through_and_the_mass_stays_known() -> None:
    poses = free_poses(110, impulse_at=60)
    motion, names, estimated = followed(measured(poses))
    assert set(names[20:60]) == {"torque_free"}
    assert names[63] == "kinematic"
    assert set(names[90:]) == {"torque_free"}
    turns = [
        float(rotation_angle(a[:3, :3].T @ b[:3, :3]))
        for a, b in zip(estimated, poses, strict=True)
    ]
    assert max(turns[64:]) < 6.0 * SD[3]
    # Learnt before the impulse, and not lost by it.
    state, covariance = motion.kalman.state, motion.reported_covariance
    assert np.linalg.norm(state.com_model - START.com_model) < 0.01
    assert np.sqrt(np.max(np.diag(covariance)[6:9])) < 0.01


def test_a_torque_is_followed_as_any_motion_while_it_lasts() -> None:
    _, names, _ = followed(measured(free_poses(110, torque_from=50)))
    assert set(names[20:50]) == {"torque_free"}
    assert names[62:].count("kinematic") > 40


def test_a_mass_that_was_told_is_reported_with_its_prior() -> None:
    motion, names, _ = followed(measured(free_poses(20)), MotionChoice.KINEMATIC)
    assert set(names) == {"kinematic"}
    covariance = motion.reported_covariance
    np.testing.assert_allclose(covariance[6:9, 6:9], PRIOR.com_covariance_m2)
    np.testing.assert_allclose(covariance[15:, 15:], PRIOR.parameter_covariance)
    assert motion.learnt_mass is None


def test_torque_free_alone_has_no_other_filter() -> None:
    motion, _, _ = followed(measured(free_poses(6)), MotionChoice.TORQUE_FREE)
    assert motion.is_torque_free and motion.kinematic is None
