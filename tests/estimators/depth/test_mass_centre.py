"""The 20-state model against numerical integration and numerical differentiation."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm

from pcnav.core.arrays import FloatArray
from pcnav.core.spatial import exp_rotation, make_transform
from pcnav.dynamics.rigid_body import inertia_from_ratios
from pcnav.dynamics.state import STATE_SIZE, NavigationState
from pcnav.estimators.depth.mass_centre import MassCentreModel, RectangleMeasurement
from pcnav.filtering.error_state import retraction_jacobian
from tests.dynamics.reference import turned

_MODEL = MassCentreModel(1.1e-3, 1e-12, 1e-12)


def _random_state(rng: np.random.Generator, rate_rad_s: float = 0.2) -> NavigationState:
    return NavigationState(
        r_hill=rng.normal(0.0, 20.0, 3),
        v_hill=rng.normal(0.0, 0.05, 3),
        com_model=rng.normal(0.0, 0.2, 3),
        R_world_body=exp_rotation(rng.normal(0.0, 2.0, 3)),
        omega_body=rng.normal(0.0, rate_rad_s, 3),
        inertia_ratios=np.array([0.9, 1.2, 0.05, -0.03, 0.04]) + rng.normal(0.0, 0.03, 5),
    )


def _random_measurement(
    rng: np.random.Generator, known: FloatArray, state: NavigationState
) -> RectangleMeasurement:
    """A measurement near what the state predicts: yaw and tilt must stay away from their wraps."""
    T_cam_hill = make_transform(exp_rotation(rng.normal(0.0, 2.0, 3)), rng.normal(0.0, 1.0, 3))
    R_hill_world = exp_rotation(rng.normal(0.0, 1.0, 3))
    T_model_rect = make_transform(exp_rotation(rng.normal(0.0, 2.0, 3)), rng.normal(0.0, 1.0, 3))
    R_cam_body = T_cam_hill[:3, :3] @ R_hill_world @ state.R_world_body
    com_cam = T_cam_hill[:3, :3] @ state.r_hill + T_cam_hill[:3, 3]
    T_cam_body = make_transform(R_cam_body, com_cam - R_cam_body @ state.com_model)
    disturbance = make_transform(exp_rotation(rng.normal(0.0, 0.2, 3)), rng.normal(0.0, 0.3, 3))
    return RectangleMeasurement(
        T_model_rect=T_model_rect,
        T_cam_rect=T_cam_body @ T_model_rect @ disturbance,
        known=np.asarray(known, dtype=bool),
        full_covariance=np.eye(6),
        T_cam_hill=T_cam_hill,
        R_hill_world=R_hill_world,
    )


@pytest.mark.parametrize("rate_rad_s", [0.01, 0.2, 1.0])
def test_propagation_agrees_with_an_adaptive_integrator(rate_rad_s: float) -> None:
    rng = np.random.default_rng(1)
    for _ in range(5):
        state = _random_state(rng, rate_rad_s)
        moved, _, _ = _MODEL.propagate(state, 0.0, 0.5)

        turn, rate = turned(inertia_from_ratios(state.inertia_ratios), state.omega_body, 0.5)
        np.testing.assert_allclose(moved.R_world_body, state.R_world_body @ turn, atol=2e-7)
        np.testing.assert_allclose(moved.omega_body, rate, atol=2e-7)


def test_halving_the_step_agrees_to_fourth_order() -> None:
    state = _random_state(np.random.default_rng(2), 0.05)
    whole, _, _ = _MODEL.propagate(state, 0.0, 0.4)
    half, _, _ = _MODEL.propagate(state, 0.0, 0.2)
    twice, _, _ = _MODEL.propagate(half, 0.2, 0.2)
    assert np.max(np.abs(whole.local(twice))) < 1e-8


def test_transition_matrix_is_the_numerical_derivative() -> None:
    rng = np.random.default_rng(3)
    for _ in range(5):
        state = _random_state(rng)
        moved, transition, _ = _MODEL.propagate(state, 0.0, 0.5)
        numerical = np.empty((STATE_SIZE, STATE_SIZE))
        for k in range(STATE_SIZE):
            step = np.zeros(STATE_SIZE)
            step[k] = 1e-6
            ahead = moved.local(_MODEL.propagate(state.retract(step), 0.0, 0.5)[0])
            behind = moved.local(_MODEL.propagate(state.retract(-step), 0.0, 0.5)[0])
            numerical[:, k] = (ahead - behind) / 2e-6
        np.testing.assert_allclose(transition, numerical, atol=2e-6)


@pytest.mark.parametrize(
    "known",
    [
        [True] * 6,
        [True] * 5 + [False],
        [False, False, True, True, True, False],
    ],
    ids=["whole", "square", "cut"],
)
def test_measurement_jacobian_is_the_numerical_derivative(known: list[bool]) -> None:
    rng = np.random.default_rng(4)
    for _ in range(10):
        state = _random_state(rng)
        measurement = _random_measurement(rng, np.array(known), state)
        analytic = measurement.jacobian(state)
        assert analytic.shape == (sum(known), STATE_SIZE)
        numerical = np.empty_like(analytic)
        for k in range(STATE_SIZE):
            step = np.zeros(STATE_SIZE)
            step[k] = 1e-6
            ahead = measurement.residual(state.retract(step))
            behind = measurement.residual(state.retract(-step))
            numerical[:, k] = -(ahead - behind) / 2e-6
        np.testing.assert_allclose(analytic, numerical, atol=2e-7)


def test_residual_vanishes_where_the_measurement_was_made() -> None:
    rng = np.random.default_rng(5)
    state = _random_state(rng)
    T_cam_world = make_transform(exp_rotation(rng.normal(0.0, 1.0, 3)), rng.normal(0.0, 1.0, 3))
    R_hill_world = exp_rotation(np.array([0.0, 0.3, 0.0]))
    T_hill_world = make_transform(R_hill_world, np.zeros(3))
    T_model_rect = make_transform(exp_rotation(rng.normal(0.0, 1.0, 3)), rng.normal(0.0, 1.0, 3))
    measurement = RectangleMeasurement(
        T_model_rect=T_model_rect,
        T_cam_rect=state.T_cam_model(T_cam_world, R_hill_world) @ T_model_rect,
        known=np.ones(6, dtype=bool),
        full_covariance=np.eye(6),
        T_cam_hill=T_cam_world @ np.linalg.inv(T_hill_world),
        R_hill_world=R_hill_world,
    )
    np.testing.assert_allclose(measurement.residual(state), 0.0, atol=1e-12)


def test_reset_jacobian_is_the_numerical_derivative() -> None:
    rng = np.random.default_rng(6)
    state = _random_state(rng)
    error = rng.normal(0.0, 0.5, STATE_SIZE)
    moved = state.retract(error)
    numerical = np.empty((STATE_SIZE, STATE_SIZE))
    for k in range(STATE_SIZE):
        step = np.zeros(STATE_SIZE)
        step[k] = 1e-6
        numerical[:, k] = (
            moved.local(state.retract(error + step)) - moved.local(state.retract(error - step))
        ) / 2e-6
    np.testing.assert_allclose(retraction_jacobian(state, error), numerical, atol=1e-8)


def test_process_noise_is_that_of_white_angular_acceleration() -> None:
    # Van Loan's integral of the double integrator that a still body's rotation is.
    q, step_s = 3e-5, 0.7
    model = MassCentreModel(1.1e-3, 0.0, q)
    _, _, noise = model.propagate(_random_state(np.random.default_rng(7), 0.0), 0.0, step_s)
    A, G = np.zeros((6, 6)), np.zeros((6, 6))
    A[:3, 3:] = np.eye(3)
    G[3:, 3:] = q * np.eye(3)
    block = expm(step_s * np.block([[-A, G], [np.zeros((6, 6)), A.T]]))
    expected = block[6:, 6:].T @ block[:6, 6:]
    np.testing.assert_allclose(noise[9:15, 9:15], expected, atol=1e-18)
    others = np.r_[0:9, 15:STATE_SIZE]
    assert not noise[others].any()


def test_long_rotation_conserves_energy_and_momentum() -> None:
    state = _random_state(np.random.default_rng(8), 0.2)
    inertia = inertia_from_ratios(state.inertia_ratios)
    momentum = state.R_world_body @ inertia @ state.omega_body
    energy = state.omega_body @ inertia @ state.omega_body
    turned = 0.0
    for k in range(400):
        state, _, _ = _MODEL.propagate(state, 0.5 * k, 0.5)
        turned += 0.5 * float(np.linalg.norm(state.omega_body))
    assert turned > 10.0 * np.pi
    after = state.R_world_body @ inertia @ state.omega_body
    np.testing.assert_allclose(after, momentum, atol=2e-5 * float(np.linalg.norm(momentum)))
    assert state.omega_body @ inertia @ state.omega_body == pytest.approx(energy, rel=1e-5)
    np.testing.assert_allclose(state.R_world_body.T @ state.R_world_body, np.eye(3), atol=1e-12)


def test_covariance_and_name_are_those_of_the_known_part() -> None:
    rng = np.random.default_rng(9)
    state = _random_state(rng)
    known = np.array([True, False, True, True, False, True])
    root = rng.normal(size=(6, 6))
    measurement = replace(_random_measurement(rng, known, state), full_covariance=root @ root.T)
    np.testing.assert_array_equal(
        measurement.covariance, (root @ root.T)[[0, 2, 3, 5]][:, [0, 2, 3, 5]]
    )
    assert len(measurement.residual(state)) == 4
