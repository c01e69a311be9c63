"""Relative motion against matrix exponentials and two bodies integrated in an inertial frame."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from pcnav.dynamics.kepler import KeplerOrbit, propagate_relative
from pcnav.dynamics.orbit import (
    EARTH_MU_M3_S2,
    R_hill_world,
    hill_matrix,
    hill_transition,
)
from pcnav.dynamics.process_noise import hill_process_noise

N = 0.0011
RADIUS = (EARTH_MU_M3_S2 / N**2) ** (1 / 3)
START = np.array([25.0, -4.0, 7.0])
VELOCITY = np.array([0.012, -0.004, 0.02])


def chaser_motion(times_s: np.ndarray) -> np.ndarray:
    """(n, 3) places of the chaser about the Earth in world axes.

    World equals Hill at time 0: the Earth lies along +z, the chaser moves along +x.
    """

    def derivative(_: float, state: np.ndarray) -> np.ndarray:
        p = state[:3]
        return np.concatenate([state[3:], -EARTH_MU_M3_S2 * p / np.linalg.norm(p) ** 3])

    start = np.array([0.0, 0.0, -RADIUS, N * RADIUS, 0.0, 0.0])
    span = (0.0, float(times_s[-1]))
    return (
        solve_ivp(derivative, span, start, method="DOP853", t_eval=times_s, rtol=3e-14, atol=1e-9)
        .y[:3]
        .T
    )


def test_R_hill_world_follows_the_chaser() -> None:
    times_s = np.linspace(0.0, 5000.0, 6)
    for t, p_world in zip(times_s, chaser_motion(times_s), strict=True):
        # The Earth stays at nadir: the chaser's place in Hill components never changes.
        np.testing.assert_allclose(R_hill_world(t, N) @ p_world, [0.0, 0.0, -RADIUS], atol=2e-3)


def test_hill_agrees_with_two_bodies_to_second_order_in_separation() -> None:
    times_s = np.array([0.0, 2000.0])
    errors = []
    for scale in (1.0, 0.1):
        start = scale * np.concatenate([START, VELOCITY])
        exact = propagate_relative(KeplerOrbit(N), start[:3], start[3:], times_s)[1]
        linear = hill_transition(N, 2000.0) @ start
        errors.append(np.linalg.norm(exact[:3] - linear[:3]))
    assert 1e-5 < errors[0] < 2e-3
    assert errors[0] / errors[1] == pytest.approx(100.0, rel=0.05)


@pytest.mark.parametrize("n", [0.0, 1e-12, 1e-6, N, 0.1])
@pytest.mark.parametrize("duration_s", [0.01, 0.5, 90.0, 3000.0])
def test_transition_is_the_exponential(n: float, duration_s: float) -> None:
    if n * duration_s > 10.0:
        duration_s = 10.0 / n
    expected = expm(hill_matrix(n) * duration_s)
    np.testing.assert_allclose(hill_transition(n, duration_s), expected, rtol=1e-9, atol=1e-13)


def test_transition_keeps_digits_of_small_terms() -> None:
    # x from z grows as a^3: its digits vanish if a - sin a is subtracted.
    angle = 1e-5
    transition = hill_transition(angle, 1.0)
    assert transition[0, 2] == pytest.approx(angle**3 * (1.0 - angle**2 / 20.0), rel=1e-14)
    just_below, just_above = (hill_transition(a, 1.0)[0, 2] for a in (0.1 - 1e-9, 0.1 + 1e-9))
    # d log(a - sin a) / da = 3 / a - a / 10 to this order.
    assert just_above / just_below - 1.0 == pytest.approx(2e-9 * 29.99, rel=1e-4)


@given(n=st.floats(0.0, 0.01), first=st.floats(0.0, 500.0), second=st.floats(0.0, 500.0))
def test_transitions_compose(n: float, first: float, second: float) -> None:
    product = hill_transition(n, second) @ hill_transition(n, first)
    np.testing.assert_allclose(product, hill_transition(n, first + second), rtol=1e-9, atol=1e-9)


def test_no_orbit_is_a_straight_line() -> None:
    expected = np.eye(6)
    expected[:3, 3:] = 7.0 * np.eye(3)
    np.testing.assert_array_equal(hill_transition(0.0, 7.0), expected)
    np.testing.assert_array_equal(R_hill_world(100.0, 0.0), np.eye(3))


def test_process_noise_without_orbit_is_the_white_acceleration_form() -> None:
    dt, psd = 0.5, 1e-6
    expected = np.zeros((6, 6))
    expected[:3, :3] = np.eye(3) * psd * dt**3 / 3.0
    expected[:3, 3:] = expected[3:, :3] = np.eye(3) * psd * dt**2 / 2.0
    expected[3:, 3:] = np.eye(3) * psd * dt
    np.testing.assert_allclose(hill_process_noise(0.0, dt, psd), expected, rtol=1e-13, atol=0.0)


def test_process_noise_is_the_integral_of_the_transition() -> None:
    dt, psd = 900.0, 1e-8
    nodes, weights = np.polynomial.legendre.leggauss(20)
    expected = np.zeros((6, 6))
    for node, weight in zip(nodes, weights, strict=True):
        by_velocity = hill_transition(N, 0.5 * dt * (1.0 + node))[:, 3:]
        expected += 0.5 * dt * weight * psd * by_velocity @ by_velocity.T
    found = hill_process_noise(N, dt, psd)
    np.testing.assert_allclose(found, expected, rtol=1e-10, atol=1e-20)
    np.testing.assert_array_equal(found, found.T)
