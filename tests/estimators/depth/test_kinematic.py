"""The filter of a target that moves in any way, on poses alone."""

from collections.abc import Callable

import numpy as np
import pytest

from pcnav.config.depth import FilterTable
from pcnav.core.arrays import FloatArray
from pcnav.core.spatial import exp_rotation
from pcnav.dynamics.inertia_parameters import BALL
from pcnav.dynamics.mass_prior import MassBelief
from pcnav.dynamics.state import COM_MODEL, INERTIA_RATIOS, OMEGA_BODY, NavigationState
from pcnav.estimators.depth.acceleration_levels import AccelerationLevels
from pcnav.estimators.depth.kinematic import (
    KinematicFilter,
    KinematicModel,
    densities_through,
    with_belief,
    with_mass,
)
from pcnav.estimators.depth.pose_measurement import (
    ObserverPose,
    PoseMeasurement,
    PoseReference,
    moved_pose,
    pose_covariance,
)

DIAMETER_M, STEP_S = 2.0, 0.1
SD = np.repeat([1e-3, 5e-4], 3)
OBSERVER = ObserverPose(np.eye(4), np.eye(3))
BELIEF = MassBelief(
    np.array([0.1, -0.2, 0.05]), np.diag([0.02, 0.03, 0.04]) ** 2, BALL, 1e-2 * np.eye(5)
)


def numerical(function: Callable[[FloatArray], FloatArray], size: int) -> FloatArray:
    """Derivative at zero, by central differences."""
    steps = 1e-6 * np.eye(size)
    return np.column_stack([(function(d) - function(-d)) / 2e-6 for d in steps])


def measured(T_cam_model: FloatArray, rng: np.random.Generator) -> PoseMeasurement:
    """A pose (4, 4) as a frame would measure it, with errors of `SD`."""
    seen = moved_pose(T_cam_model, SD * rng.standard_normal(6))
    return PoseMeasurement(PoseReference(seen, OBSERVER), np.diag(1.0 / SD), np.zeros(6))


def pose(state: NavigationState) -> FloatArray:
    return state.T_cam_model(np.eye(4), np.eye(3))


def driven(
    state: NavigationState, psd: tuple[float, float], n: int, rng: np.random.Generator
) -> list[NavigationState]:
    """n states under white accelerations, drawn from the process noise of the model."""
    model, states = KinematicModel(0.0, *psd), [state]
    for _ in range(n - 1):
        moved, _, noise = model.propagate(states[-1], 0.0, STEP_S)
        states.append(moved.retract(rng.multivariate_normal(np.zeros(20), noise)))
    return states


def test_the_transition_is_the_derivative_of_the_motion(
    state: NavigationState,
) -> None:
    model = KinematicModel(1.1e-3)
    moved, transition, _ = model.propagate(state, 0.0, 2.0)
    turned = state.R_world_body @ exp_rotation(2.0 * state.omega_body)
    np.testing.assert_allclose(moved.R_world_body, turned)

    def error(d: FloatArray) -> FloatArray:
        return moved.local(model.propagate(state.retract(d), 0.0, 2.0)[0])

    np.testing.assert_allclose(transition, numerical(error, 20), atol=2e-5)


@pytest.mark.parametrize("psd", [(1e-2, 1e-3), (1e-4, 1e-1)])
def test_the_level_of_the_accelerations_is_learnt_and_the_pose_consistent(
    state: NavigationState, psd: tuple[float, float]
) -> None:
    rng = np.random.default_rng(1)
    states = driven(with_mass(state, BELIEF, np.eye(3)), psd, 150, rng)
    kinematic = KinematicFilter(states[0], 0.0, DIAMETER_M, FilterTable())
    nees, learnt = [], []
    for k, true in enumerate(states):
        measurement = (measured(pose(true), rng),)
        if k:
            kinematic.predict(STEP_S * (k - 1), STEP_S)
            kinematic.learn(measurement)
        kinematic.take_in(measurement)
        if k > 30:
            kalman = kinematic.kalman
            error = kalman.state.local(true)
            moving = np.r_[0:6, 9:15]
            covariance = kalman.covariance[np.ix_(moving, moving)]
            nees.append(float(error[moving] @ np.linalg.solve(covariance, error[moving])) / 12)
            learnt.append(kinematic.densities)
    ratio = np.median(np.array(learnt), axis=0) / psd
    assert np.all((ratio > 0.5) & (ratio < 2.5))
    assert 0.75 < np.mean(nees) < 1.3


def test_a_jolt_is_taken_in_and_the_mass_stays_as_told(state: NavigationState) -> None:
    rng = np.random.default_rng(2)
    states = driven(with_mass(state, BELIEF, np.eye(3)), (0.0, 0.0), 40, rng)
    kinematic = KinematicFilter(states[0], 0.0, DIAMETER_M, FilterTable())
    turn = exp_rotation(np.array([0.0, 0.1, 0.0]))
    for k, true in enumerate(states):
        T_cam_model = pose(true)
        if k >= 30:
            T_cam_model = T_cam_model.copy()
            T_cam_model[:3, :3] = T_cam_model[:3, :3] @ turn
        measurement = (measured(T_cam_model, rng),)
        if k:
            kinematic.predict(STEP_S * (k - 1), STEP_S)
            kinematic.learn(measurement)
        kinematic.take_in(measurement)
        if k >= 30:
            off = pose(kinematic.kalman.state)[:3, :3].T @ T_cam_model[:3, :3]
            assert np.linalg.norm(off - np.eye(3)) < 10.0 * SD[3]
    np.testing.assert_array_equal(kinematic.kalman.state.com_model, BELIEF.com_model)
    held = np.r_[COM_MODEL, INERTIA_RATIOS]
    assert np.all(kinematic.kalman.covariance[held] == 0.0)


def test_another_mass_moves_neither_the_pose_nor_its_covariance(state: NavigationState) -> None:
    rng = np.random.default_rng(3)
    states = driven(with_mass(state, BELIEF, np.eye(3)), (1e-4, 1e-4), 10, rng)
    kinematic = KinematicFilter(states[0], 0.0, DIAMETER_M, FilterTable())
    for k, true in enumerate(states):
        if k:
            kinematic.predict(STEP_S * (k - 1), STEP_S)
        kinematic.take_in((measured(pose(true), rng),))
    kalman = kinematic.kalman
    before, spread = kalman.state, pose_covariance(kalman.state, kalman.covariance, OBSERVER)
    other = MassBelief(np.array([-0.3, 0.2, 0.4]), np.eye(3), BALL, np.eye(5))
    kinematic.believe(other, np.eye(3))
    np.testing.assert_array_equal(kalman.state.com_model, other.com_model)
    np.testing.assert_allclose(pose(kalman.state), pose(before), atol=1e-12)
    after = pose_covariance(kalman.state, kalman.covariance, OBSERVER)
    np.testing.assert_allclose(after, spread, rtol=1e-6, atol=1e-15)


def test_the_doubt_about_a_mass_that_was_told_is_reported_but_not_in_the_pose(
    state: NavigationState,
) -> None:
    rng = np.random.default_rng(4)
    root = rng.standard_normal((20, 20))
    covariance = 1e-4 * root @ root.T
    covariance[COM_MODEL] = covariance[:, COM_MODEL] = 0.0
    covariance[INERTIA_RATIOS] = covariance[:, INERTIA_RATIOS] = 0.0
    told = with_belief(state, covariance, BELIEF, np.eye(3))
    np.testing.assert_allclose(
        pose_covariance(state, told, OBSERVER), pose_covariance(state, covariance, OBSERVER)
    )

    # By differentiation: the state that another mass centre would have been reported as.
    def reported(com: FloatArray) -> FloatArray:
        belief = MassBelief(state.com_model + com, np.eye(3), state.inertia_ratios, np.eye(5))
        return state.local(with_mass(state, belief, np.eye(3)))

    by_com = numerical(reported, 3)
    expected = covariance + by_com @ BELIEF.com_covariance_m2 @ by_com.T
    expected[INERTIA_RATIOS, INERTIA_RATIOS] += BELIEF.parameter_covariance
    np.testing.assert_allclose(told, expected, atol=1e-9)


def test_densities_follow_from_the_mean_twists_of_successive_steps(state: NavigationState) -> None:
    rng = np.random.default_rng(5)
    psd = (1e-2, 1e-3)
    states = driven(state, psd, 400, rng)
    found = densities_through(np.asarray(STEP_S * np.arange(400), np.float64), states)
    assert found is not None
    np.testing.assert_allclose(found, psd, rtol=0.2)
    assert densities_through(np.array([0.0, STEP_S]), states[:2]) is None


def test_levels_begin_about_what_is_suggested() -> None:
    levels = AccelerationLevels(DIAMETER_M, STEP_S)
    wide = levels.densities
    levels.suggest(np.array([1e-3, 1e-4]))
    assert np.all(levels.densities < 0.01 * wide)
    assert np.all(levels.densities > np.array([1e-3, 1e-4]))


def test_the_rate_is_known_from_the_second_pose_on(state: NavigationState) -> None:
    rng = np.random.default_rng(6)
    states = driven(with_mass(state, BELIEF, np.eye(3)), (0.0, 0.0), 3, rng)
    guess = NavigationState(**{**states[0].__dict__, "omega_body": np.zeros(3)})
    kinematic = KinematicFilter(guess, 0.0, DIAMETER_M, FilterTable())
    kinematic.take_in((measured(pose(states[0]), rng),))
    kinematic.predict(0.0, STEP_S)
    assert np.sqrt(kinematic.kalman.covariance[OMEGA_BODY, OMEGA_BODY][0, 0]) > 1.0
    kinematic.take_in((measured(pose(states[1]), rng),))
    assert np.linalg.norm(kinematic.kalman.state.omega_body - states[1].omega_body) < 0.05
