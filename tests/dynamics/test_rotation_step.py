"""Steps of rotation: against scipy's integrator, conserved quantities, numerical derivatives."""

import numpy as np
import pytest

from pcnav.core.spatial import log_rotation
from pcnav.dynamics.inertia_parameters import inertia_of
from pcnav.dynamics.rotation_step import (
    Rotation,
    Slope,
    at_rest,
    rotate,
    torque_free,
    torque_free_by_inertia,
)
from tests.dynamics.reference import turned

INERTIA = np.array([[96.0, 43.0, 20.0], [43.0, 104.0, 10.0], [20.0, 10.0, 133.0]])
RATE = np.array([0.05, -0.02, 0.04])


def inverse_of(inertia: np.ndarray) -> np.ndarray:
    return np.asarray(np.linalg.inv(inertia), dtype=np.float64)


def test_rotation_is_that_of_another_integrator() -> None:
    slope = torque_free(INERTIA, inverse_of(INERTIA))
    R, omega = turned(INERTIA, RATE, 50.0)
    done = rotate(slope, RATE, 50.0)
    np.testing.assert_allclose(done.turn, R, atol=2e-6)
    np.testing.assert_allclose(done.omega_body, omega, atol=1e-7)
    finer = rotate(slope, RATE, 50.0, max_turn_rad=0.01)
    np.testing.assert_allclose(finer.turn, R, atol=2e-10)


def test_energy_and_momentum_are_conserved() -> None:
    omega, slope = RATE, torque_free(INERTIA, inverse_of(INERTIA))
    R, start = np.eye(3), INERTIA @ omega
    energy = omega @ INERTIA @ omega
    for _ in range(2000):
        step = rotate(slope, omega, 0.1)
        R, omega = R @ step.turn, step.omega_body
    np.testing.assert_allclose(R @ INERTIA @ omega, start, rtol=1e-9)
    np.testing.assert_allclose(omega @ INERTIA @ omega, energy, rtol=1e-9)


def test_rotation_alone_is_the_same_without_derivatives() -> None:
    slope = torque_free(INERTIA, inverse_of(INERTIA))
    plain, full = rotate(slope, RATE, 7.0, 0), rotate(slope, RATE, 7.0)
    np.testing.assert_array_equal(plain.turn, full.turn)
    np.testing.assert_array_equal(plain.omega_body, full.omega_body)
    assert plain.by_start.shape == (3, 0)


def test_steps_one_by_one_are_the_rotation() -> None:
    slope = torque_free(INERTIA, inverse_of(INERTIA))
    done = at_rest(RATE)
    np.testing.assert_array_equal(done.transition, np.eye(6))
    for _ in range(8):
        done = done.then(slope, 0.5)
    eighth = float(np.linalg.norm(RATE)) * 4.0 / 7.5
    whole = rotate(slope, RATE, 4.0, max_turn_rad=eighth)
    np.testing.assert_allclose(done.transition, whole.transition, atol=1e-14)


def by_difference(up: Rotation, down: Rotation, width: float) -> tuple[np.ndarray, np.ndarray]:
    turn = log_rotation(np.swapaxes(down.turn, -1, -2) @ up.turn) / width
    return turn, (up.omega_body - down.omega_body) / width


@pytest.mark.parametrize("duration_s", [0.9, 9.0])
def test_transition_is_the_derivative_of_a_batch(duration_s: float) -> None:
    rng = np.random.default_rng(1)
    parameters = np.array([1.1, 0.9, 0.1, -0.05, 0.08]) + 0.05 * rng.normal(size=(3, 5))
    omega = 0.1 * rng.normal(size=(3, 3))

    def slope(parameters: np.ndarray) -> Slope:
        inertia = inertia_of(parameters)
        return torque_free_by_inertia(inertia, inverse_of(inertia))

    def rotated(dw: np.ndarray, dp: np.ndarray) -> Rotation:
        # The turn's own series is of order 4 and so is its derivative.
        return rotate(slope(parameters + dp), omega + dw, duration_s, 8, 0.02)

    base = rotated(np.zeros(3), np.zeros(5))
    assert base.transition.shape == (3, 11, 11)
    h = 1e-5
    for k in range(8):
        dw, dp = h * np.eye(8)[k, :3], h * np.eye(8)[k, 3:]
        turn, rate = by_difference(rotated(dw, dp), rotated(-dw, -dp), 2.0 * h)
        np.testing.assert_allclose(base.transition[:, :3, 3 + k], turn, atol=1e-7)
        np.testing.assert_allclose(base.transition[:, 3:6, 3 + k], rate, atol=1e-7)
    np.testing.assert_array_equal(base.transition[:, :3, :3], np.swapaxes(base.turn, -1, -2))
    np.testing.assert_array_equal(base.transition[:, 6:, 6:], [np.eye(5)] * 3)


def test_by_the_rate_alone_is_part_of_by_the_inertia() -> None:
    inertia = 3.0 * INERTIA / np.trace(INERTIA)
    inverse = inverse_of(inertia)
    part = rotate(torque_free(inertia, inverse), RATE, 30.0)
    whole = rotate(torque_free_by_inertia(inertia, inverse), RATE, 30.0, 8)
    np.testing.assert_allclose(part.transition, whole.transition[:6, :6], atol=1e-13)
