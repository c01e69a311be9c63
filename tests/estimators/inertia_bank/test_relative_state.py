"""Errors, transitions and Jacobians of the 13 + 3N states against numerical derivatives."""

import numpy as np
import pytest

from pcnav.core.arrays import picked
from pcnav.core.spatial import log_rotation
from pcnav.estimators.inertia_bank.relative_state import (
    PixelMeasurements,
    PixelsAhead,
    RelativeStates,
    reduced_pixels,
)
from tests.filtering.test_batched_filter import (
    BATCH,
    ORBIT,
    R_RIG_HILL,
    RIG,
    N,
    random_model,
    random_states,
)

STEP = 1e-5


def derivative(function, states: RelativeStates, at=None):
    """(B, m, n) central differences of ``function(states (+) e)`` by e."""
    at = np.zeros((BATCH, N)) if at is None else at
    columns = []
    for k in range(N):
        change = STEP * np.eye(N)[k]
        up, down = (function(states.retract(at + sign * change)) for sign in (1.0, -1.0))
        columns.append((up - down) / (2.0 * STEP))
    return np.stack(columns, axis=-1)


@pytest.mark.parametrize("coupled", [True, False])
def test_local_undoes_retract(coupled):
    rng = np.random.default_rng(0)
    states = random_states(rng, coupled)
    error = rng.normal(size=(BATCH, N))
    np.testing.assert_allclose(states.local(states.retract(error)), error, atol=1e-12)


@pytest.mark.parametrize("coupled", [True, False])
def test_retraction_block(coupled):
    rng = np.random.default_rng(1)
    states, at = random_states(rng, coupled), 0.5 * rng.normal(size=(BATCH, N))
    jacobian = derivative(states.retract(at).local, states, at)
    expected = np.broadcast_to(np.eye(N), (BATCH, N, N)).copy()
    expected[:, states.curved, states.curved] = states.retraction_block(at)
    np.testing.assert_allclose(jacobian, expected, atol=1e-8)


@pytest.mark.parametrize("coupled", [True, False])
def test_transition(coupled):
    rng = np.random.default_rng(2)
    states, model = random_states(rng, coupled), random_model(rng)
    moved, F, _ = model.propagate(states, 40.0, 2.0)
    jacobian = derivative(lambda s: moved.local(model.propagate(s, 40.0, 2.0)[0]), states)
    np.testing.assert_allclose(F, jacobian, atol=3e-7)


@pytest.mark.parametrize("coupled", [True, False])
def test_measurement_jacobian(coupled):
    rng = np.random.default_rng(3)
    states = random_states(rng, coupled)
    seen = PixelMeasurements(RIG, R_RIG_HILL, np.array([2, 0]), np.zeros((BATCH, 2, 3)))
    jacobian = -derivative(seen.residual, states)
    np.testing.assert_allclose(seen.jacobian(states), jacobian, atol=1e-5)


@pytest.mark.parametrize("coupled", [True, False])
def test_jacobian_of_a_frame_ahead(coupled):
    rng = np.random.default_rng(6)
    states, model = random_states(rng, coupled), random_model(rng)
    later = PixelMeasurements(RIG, R_RIG_HILL, np.array([2, 0]), np.zeros((BATCH, 2, 3)))
    ahead = PixelsAhead(later, model, 40.0, 2.0)
    jacobian = -derivative(ahead.residual, states)
    np.testing.assert_allclose(ahead.jacobian(states), jacobian, atol=1e-4)
    some = np.array([1, 3])
    part = ahead.take(some).residual(picked(states, some))
    np.testing.assert_allclose(part, ahead.residual(states)[some], atol=1e-9)


def test_body_errors_and_process_noise_of_the_two_choices_agree():
    rng = np.random.default_rng(4)
    coupled, model = random_states(rng, True), random_model(rng)
    plain = RelativeStates(
        coupled.r_hill,
        coupled.v_hill,
        coupled.R_hill_body,
        coupled.omega_body,
        coupled.points_body,
        coupled=False,
    )
    for states in (coupled, plain):
        to_body = derivative(lambda s, start=states: plain_differences(start, s), states)
        np.testing.assert_allclose(states.to_body_errors(), to_body, atol=1e-8)
    (_, F, Q), (_, F_plain, Q_plain) = (
        in_body_terms(states, model.propagate(states, 3.0, 2.0)) for states in (coupled, plain)
    )
    np.testing.assert_allclose(F, F_plain, atol=1e-10)
    np.testing.assert_allclose(Q, Q_plain, atol=1e-14)


def plain_differences(start: RelativeStates, s: RelativeStates):
    """(B, n) differences of components, the attitude's a rotation vector in body axes."""
    turn = log_rotation(np.swapaxes(start.R_hill_body, -1, -2) @ s.R_hill_body)
    points = (s.points_body - start.points_body).reshape(BATCH, -1)
    motion = (s.r_hill - start.r_hill, s.v_hill - start.v_hill, turn)
    return np.concatenate([*motion, s.omega_body - start.omega_body, points], axis=-1)


def in_body_terms(states: RelativeStates, propagated):
    """State, transition and noise of a step, by plain differences."""
    moved, F, Q = propagated
    T0, T1 = states.to_body_errors(), moved.to_body_errors()
    return moved, T1 @ F @ np.linalg.inv(T0), T1 @ Q @ np.swapaxes(T1, -1, -2)


def test_coupling_is_the_second_derivative_of_the_measured_position():
    """(25) with the lever arm from the mass centre, at an instant, by differences in time."""
    rng = np.random.default_rng(5)
    states, model, h = random_states(rng, True), random_model(rng), 0.05
    t = 100.0
    before, _, _ = model.propagate(states, t, -h)
    after, _, _ = model.propagate(states, t, h)

    def in_world(s, time):
        # Rotation only: relative to the mass centre, in axes that do not turn.
        return (s.positions() - s.r_hill[:, None]) @ ORBIT.R_hill_world(time)

    arm = in_world(states, t)
    second = (in_world(after, t + h) - 2.0 * arm + in_world(before, t - h)) / h**2
    R_world_body = ORBIT.R_hill_world(t).T @ states.R_hill_body
    omega = np.einsum("bij,bj->bi", R_world_body, states.omega_body)
    momentum = np.einsum("bij,bj->bi", model.inertia, states.omega_body)
    torque = -np.cross(states.omega_body, momentum)
    rate = np.einsum("bij,bj->bi", R_world_body @ model.inverse, torque)
    w, a = omega[:, None], rate[:, None]
    np.testing.assert_allclose(second, np.cross(a, arm) + np.cross(w, np.cross(w, arm)), atol=1e-6)


def test_reduced_pixels_hold_what_four_numbers_tell():
    """Information of the three numbers about a point equals that of the four."""
    p = np.array([0.4, -0.7, 12.0])
    full = RIG.projection_jacobian(p)
    four = full.T @ full / RIG.pixel_sigma_px**2
    some = full[[0, 2, 1]]
    seen = PixelMeasurements(RIG, R_RIG_HILL, np.array([0]), np.zeros((1, 1, 3)))
    three = some.T @ np.linalg.inv(seen.noise[0]) @ some
    np.testing.assert_allclose(three, four, rtol=1e-12)
    np.testing.assert_allclose(reduced_pixels(RIG.project(p)), RIG.project(p)[[0, 2, 1]])
