"""The filter state of Hu 2024: motion and measurements against numerical derivatives."""

import numpy as np
import pytest

from pcnav.core.spatial import exp_rotation, log_rotation
from pcnav.core.stereo import StereoRig
from pcnav.dynamics.kepler import KeplerOrbit
from pcnav.dynamics.principal_inertia import (
    middle_ratio,
    moments_from_ratios,
    moments_jacobian,
    ratios_from_moments,
)
from pcnav.estimators.attitude_inertia.rotation_model import AttitudeSet
from pcnav.estimators.principal_axes.feature_measurements import (
    FeatureView,
    PointMeasurement,
)
from pcnav.estimators.principal_axes.feature_state_changes import (
    relabelled,
    with_point,
    without_points,
)
from pcnav.estimators.principal_axes.feature_states import (
    PA_MOTION_SIZE,
    PrincipalAxesModel,
    PrincipalState,
    propagate_rotation,
)
from pcnav.estimators.principal_axes.principal_frame import PRINCIPAL_CHOICES
from pcnav.filtering.batched_filter import Together
from pcnav.filtering.error_state import retraction_jacobian
from pcnav.recordings.tracks import TrackFrame
from tests.dynamics.reference import turned

RIG = StereoRig(1.0, 1000.0, (511.5, 511.5), (1024, 1024), 0.05)
ORBIT = KeplerOrbit(1.2e-3)
STEP = 1e-6


def random_state(rng, points=4) -> PrincipalState:
    moments = np.array([8.0, 5.0, 4.0]) + 0.3 * rng.uniform(-1.0, 1.0, 3)
    return PrincipalState(
        exp_rotation(rng.normal(size=3)),
        0.1 * rng.normal(size=3),
        ratios_from_moments(moments),
        np.array([0.0, 0.0, 12.0]) + rng.normal(size=3),
        0.1 * rng.normal(size=3),
        rng.uniform(-1.5, 1.5, (points, 3)),
    )


def numerical(function, state):
    size = PA_MOTION_SIZE + 3 * len(state.points)
    columns = [
        (function(state.retract(STEP * e)) - function(state.retract(-STEP * e))) / (2.0 * STEP)
        for e in np.eye(size)
    ]
    return np.stack(columns, axis=-1)


def view_of(state, rng):
    frame = TrackFrame(
        3.0, exp_rotation(0.05 * rng.normal(size=3)), np.array([7, 3]), np.full((2, 4), 500.0)
    )
    return FeatureView(frame, RIG, ORBIT.R_hill_world(3.0), np.array([2, 0]))


def test_local_undoes_retract_and_its_jacobian_is_the_derivative():
    rng = np.random.default_rng(0)
    state, error = random_state(rng), 0.3 * rng.normal(size=26)
    error[6:8] *= 0.1
    error[14:] *= 0.2
    np.testing.assert_allclose(state.local(state.retract(error)), error, atol=1e-9)
    moved = state.retract(error)
    columns = [
        (
            moved.local(state.retract(error + STEP * e))
            - moved.local(state.retract(error - STEP * e))
        )
        / (2.0 * STEP)
        for e in np.eye(26)
    ]
    np.testing.assert_allclose(retraction_jacobian(state, error), np.stack(columns, -1), atol=1e-8)


def test_a_turn_of_the_axes_moves_no_point():
    rng = np.random.default_rng(10)
    state, error = random_state(rng), np.zeros(26)
    error[:3] = 0.5, -0.3, 0.2
    moved, view = state.retract(error), view_of(state, rng)
    np.testing.assert_allclose(view.at(moved)[0], view.at(state)[0], atol=1e-9)
    np.testing.assert_allclose(
        moved.R_world_body @ moved.omega_body, state.R_world_body @ state.omega_body, atol=1e-15
    )


def test_turns_and_shifts_are_straight_lines():
    rng = np.random.default_rng(12)
    state = random_state(rng)
    turn, shift = np.array([0.4, -0.1, 0.3]), np.array([0.05, -0.1, 0.02])
    # The body turned as a whole: its attitude errs, its points and rate do not.
    error = np.zeros(26)
    error[14:] = np.cross(turn, state.points).ravel()
    error[3:6] = np.cross(turn, state.omega_body)
    turned = state.retract(error)
    E = exp_rotation(turn)
    np.testing.assert_allclose(turned.points, state.points @ E.T, atol=1e-12)
    np.testing.assert_allclose(turned.omega_body, E @ state.omega_body, atol=1e-12)
    # The mass centre shifted: position and points make up for each other.
    view = view_of(state, rng)
    error = np.zeros(26)
    error[14:] = np.tile(shift, 4)
    error[8:11] = -view.R_hill_world @ state.R_world_body @ shift
    moved = state.retract(error)
    np.testing.assert_allclose(view.at(moved)[0], view.at(state)[0], atol=1e-9)


def test_the_torque_s_noise_is_that_of_draws_by_euler_s_equation():
    """The same torque about all axes: a smaller moment turns it into more of a rate (22)."""
    moments = np.array([8.0, 5.0, 4.0])
    state = PrincipalState(
        *(np.eye(3), np.zeros(3), ratios_from_moments(moments)),
        *(np.array([0.0, 0.0, 12.0]), np.zeros(3), np.empty((0, 3))),
    )
    psd_x, step_s, parts = 1e-4, 0.5, 50
    _, _, noise = PrincipalAxesModel(ORBIT, 0.0, psd_x).propagate(state, 0.0, step_s)
    # Torques of one spectral density, whose acceleration about x is as told.
    rng, dt = np.random.default_rng(4), step_s / parts
    torque = rng.normal(size=(40_000, parts, 3)) * moments[0] * np.sqrt(psd_x / dt)
    rates = np.cumsum(torque / moments, axis=1) * dt
    drawn = rates[:, -1].std(axis=0), (rates.sum(axis=1) * dt).std(axis=0)
    found = np.sqrt(np.diag(noise))
    np.testing.assert_allclose(found[3:6], drawn[0], rtol=0.02)
    np.testing.assert_allclose(found[:3], drawn[1], rtol=0.05)


def test_plain_differences():
    rng = np.random.default_rng(11)
    state = random_state(rng)

    def plain(s):
        return np.concatenate(
            [
                log_rotation(state.R_world_body.T @ s.R_world_body),
                *(s.omega_body, s.ratios, s.r_hill, s.v_hill, s.points.ravel()),
            ]
        )

    np.testing.assert_allclose(state.additive(), numerical(plain, state), atol=1e-9)


def test_ratios_and_moments_follow_print():
    moments = np.array([8.0, 5.0, 4.0])
    px, pz = ratios = ratios_from_moments(moments)
    py = middle_ratio(ratios)
    assert py == pytest.approx((4.0 - 8.0) / 5.0)
    assert px + py + pz + px * py * pz == pytest.approx(0.0, abs=1e-15)
    np.testing.assert_allclose(moments_from_ratios(ratios), moments / 8.0)
    by = [
        (moments_from_ratios(ratios + STEP * e) - moments_from_ratios(ratios - STEP * e))
        / (2.0 * STEP)
        for e in np.eye(2)
    ]
    np.testing.assert_allclose(moments_jacobian(ratios), np.stack(by, -1), atol=1e-9)
    # (22) has the same torque accelerate the axes by their moments.
    assert (1.0 - py) / (1.0 + px) == pytest.approx(moments[0] / moments[1])
    assert (1.0 + pz) / (1.0 - px) == pytest.approx(moments[0] / moments[2])


@pytest.mark.parametrize("eccentricity", [0.0, 0.2])
def test_transition_is_the_derivative_of_the_motion(eccentricity):
    rng = np.random.default_rng(1)
    model = PrincipalAxesModel(KeplerOrbit(1.2e-3, eccentricity), 0.0, 0.0)
    state = random_state(rng)
    moved, transition, _ = model.propagate(state, 10.0, 2.0)
    by = numerical(lambda s: moved.local(model.propagate(s, 10.0, 2.0)[0]), state)
    np.testing.assert_allclose(transition, by, atol=2e-7)


def test_rotation_agrees_with_another_integrator():
    rng = np.random.default_rng(2)
    state = random_state(rng)
    inertia = np.diag(moments_from_ratios(state.ratios))

    done = propagate_rotation(state.omega_body, state.ratios, 20.0)
    turn, rate = turned(inertia, state.omega_body, 20.0)
    np.testing.assert_allclose(done.omega_body, rate, atol=1e-8)
    np.testing.assert_allclose(done.turn, turn, atol=1e-7)


def test_energy_and_momentum_are_conserved():
    ratios = ratios_from_moments(np.array([8.0, 5.0, 4.0]))
    inertia = np.diag([8.0, 5.0, 4.0])
    R, omega = np.eye(3), np.array([0.1, 0.1, 0.1])
    energy, momentum = omega @ inertia @ omega, inertia @ omega
    for _ in range(10_000):
        done = propagate_rotation(omega, ratios, 0.1)
        R, omega = R @ done.turn, done.omega_body
    assert omega @ inertia @ omega == pytest.approx(energy, rel=1e-9)
    np.testing.assert_allclose(
        R @ inertia @ omega, momentum, atol=1e-9 * float(np.linalg.norm(momentum))
    )


def test_pixels_and_their_jacobian():
    rng = np.random.default_rng(3)
    state = random_state(rng)
    view = view_of(state, rng)
    # The prediction by way of the named transforms.
    p_hill = state.r_hill + view.R_hill_world @ state.R_world_body @ state.points[2]
    p_rig = view._frame.R_cam_world @ view.R_hill_world.T @ p_hill
    first, second = view.measurements()
    np.testing.assert_allclose(first.residual(state), 500.0 - RIG.project(p_rig), atol=1e-9)
    for measurement in (first, second):
        by = -numerical(measurement.residual, state)
        np.testing.assert_allclose(measurement.jacobian(state), by, atol=1e-3)


def test_point_and_attitude_jacobians():
    rng = np.random.default_rng(4)
    state = random_state(rng)
    point = PointMeasurement(1, rng.normal(size=3), np.eye(3), ORBIT.R_hill_world(100.0))
    turned = state.R_world_body @ exp_rotation(0.4 * rng.normal(size=3))
    attitude = Together(AttitudeSet(turned, np.eye(3)))
    for measurement in (point, attitude):
        by = -numerical(measurement.residual, state)
        np.testing.assert_allclose(measurement.jacobian(state), by, atol=1e-8)


@pytest.mark.parametrize("choice", [1, 7, 13, 22])
def test_relabelling_tells_the_same_motion(choice):
    rng = np.random.default_rng(5)
    state = random_state(rng)
    S = PRINCIPAL_CHOICES[choice]
    covariance = np.eye(26)
    moved, carried = relabelled(state, covariance, S)
    view = view_of(state, rng)
    np.testing.assert_allclose(view.at(moved)[0], view.at(state)[0], atol=1e-9)
    later = propagate_rotation(state.omega_body, state.ratios, 5.0).omega_body
    np.testing.assert_allclose(
        propagate_rotation(moved.omega_body, moved.ratios, 5.0).omega_body, S.T @ later, atol=1e-8
    )
    by = numerical(lambda s: moved.local(relabelled(s, covariance, S)[0]), state)
    np.testing.assert_allclose(carried, by @ by.T, atol=1e-7)
    back, _ = relabelled(moved, carried, S.T)
    np.testing.assert_allclose(state.local(back), 0.0, atol=1e-12)


def test_ratios_are_kept_to_those_of_bodies():
    rng = np.random.default_rng(6)
    state = random_state(rng)
    error = np.zeros(26)
    error[6:8] = 2.0, -3.0
    covariance = 0.01 * np.eye(26)
    kept = state.retract(state.admissible(error, covariance))
    assert np.all(np.abs(kept.ratios) <= 1.0)
    assert moments_from_ratios(kept.ratios).min() > 0.0


def test_points_can_be_dropped():
    rng = np.random.default_rng(7)
    state = random_state(rng)
    left, covariance = without_points(state, np.diag(np.arange(26.0)), [1])
    np.testing.assert_array_equal(left.points, state.points[[0, 2, 3]])
    assert covariance.shape == (23, 23)
    assert covariance[17, 17] == 20.0


def test_a_new_point_errs_with_the_position():
    rng = np.random.default_rng(8)
    state = random_state(rng)
    root = 0.01 * rng.normal(size=(26, 26))
    R_hill_world = ORBIT.R_hill_world(3.0)
    R_body_hill = (R_hill_world @ state.R_world_body).T
    p_hill = state.r_hill + R_body_hill.T @ np.array([0.3, -1.0, 0.5])

    def seen(s):
        return (R_hill_world @ s.R_world_body).T @ (p_hill - s.r_hill)

    def grown(s):
        return PrincipalState(
            *(s.R_world_body, s.omega_body, s.ratios, s.r_hill, s.v_hill),
            np.vstack([s.points, seen(s)]),
        )

    noise = 1e-4 * np.eye(3)
    new, covariance = with_point(state, root @ root.T, seen(state), noise, R_body_hill)
    # The retraction bends with all points; its first order is what the covariance speaks of.
    by = numerical(lambda s: new.local(grown(s)), state)
    expected = by @ root @ root.T @ by.T
    expected[26:, 26:] += noise
    np.testing.assert_allclose(covariance, expected, atol=1e-7)
