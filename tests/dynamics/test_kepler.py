"""The ellipse and relative motion on it, against two bodies integrated in an inertial frame."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from pcnav.dynamics.kepler import (
    KeplerOrbit,
    eccentric_anomaly,
    eccentric_anomaly_of,
    propagate_relative,
    relative_acceleration,
    relative_jacobian,
    step_relative,
    true_anomaly_of,
)
from pcnav.dynamics.orbit import (
    EARTH_MU_M3_S2,
    R_hill_world,
    hill_matrix,
    hill_transition,
)

N = 0.00104
ELLIPSE = KeplerOrbit(N, 0.2, 0.7)
CIRCLE = KeplerOrbit(N)
START = np.array([100.0, -10.0, 25.0])
VELOCITY = np.array([-0.0225, 0.01, -0.015])


def inertial_motion(orbit: KeplerOrbit, times_s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(n, 2, 3) places and velocities of chaser and target about the Earth, axes of world.

    The chaser starts from the textbook's elements: radius and velocity from the semi-latus rectum.
    """
    e, nu = orbit.eccentricity, orbit.true_anomaly_rad
    parameter = (EARTH_MU_M3_S2 / orbit.mean_motion_rad_s**2) ** (1 / 3) * (1.0 - e**2)
    speed = np.sqrt(EARTH_MU_M3_S2 / parameter)
    radius = parameter / (1.0 + e * np.cos(nu))
    # World: x along-track, z nadir, at time 0.
    p = np.array([0.0, 0.0, -radius])
    v = speed * np.array([1.0 + e * np.cos(nu), 0.0, -e * np.sin(nu)])
    turn = np.array([0.0, -speed * (1.0 + e * np.cos(nu)) / radius, 0.0])

    def derivative(_: float, state: np.ndarray) -> np.ndarray:
        place, velocity = state.reshape(2, 2, 3)
        attraction = -EARTH_MU_M3_S2 * place / np.linalg.norm(place, axis=1, keepdims=True) ** 3
        return np.stack([velocity, attraction]).ravel()

    start = np.stack([[p, p + START], [v, v + VELOCITY + np.cross(turn, START)]])
    solution = solve_ivp(
        derivative,
        (0.0, float(times_s[-1])),
        start.ravel(),
        method="DOP853",
        t_eval=times_s,
        rtol=3e-14,
        atol=1e-9,
    )
    states = solution.y.T.reshape(-1, 2, 2, 3)
    return states[:, 0], states[:, 1]


@given(mean=st.floats(-20.0, 20.0), e=st.floats(0.0, 0.99))
def test_keplers_equation_is_solved(mean: float, e: float) -> None:
    found = eccentric_anomaly(mean, e)
    assert found - e * np.sin(found) == pytest.approx(mean, abs=2e-14)
    by_bisection = brentq(lambda E: E - e * np.sin(E) - mean, mean - 1.0, mean + 1.0, xtol=1e-12)
    # Near the perigee of a long ellipse the equation is flat, and tells the root the less.
    assert found == pytest.approx(by_bisection, abs=1e-9 / (1.0 - e))


@given(anomaly=st.floats(-20.0, 20.0), e=st.floats(0.0, 0.95))
def test_anomalies_invert_each_other_and_keep_their_turn(anomaly: float, e: float) -> None:
    true = true_anomaly_of(anomaly, e)
    assert eccentric_anomaly_of(true, e) == pytest.approx(anomaly, abs=1e-11)
    assert abs(true - anomaly) < np.pi
    cosine = (np.cos(anomaly) - e) / (1.0 - e * np.cos(anomaly))
    assert np.cos(true) == pytest.approx(cosine, abs=1e-10)


def test_the_chaser_follows_the_integrated_ellipse() -> None:
    times_s = np.linspace(0.0, 9000.0, 10)
    (places, _) = inertial_motion(ELLIPSE, times_s)
    for t, chaser in zip(times_s, places[:, 0], strict=True):
        expected = [0.0, 0.0, -ELLIPSE.at(t).radius_m]
        np.testing.assert_allclose(ELLIPSE.R_hill_world(t) @ chaser, expected, atol=5e-3)
    assert ELLIPSE.at(9000.0).anomaly_rad > 2.0 * np.pi


@pytest.mark.parametrize("t", [0.0, 500.0, 3000.0, 5000.0])
def test_rate_and_acceleration_are_derivatives_of_the_anomaly(t: float) -> None:
    h = 0.5
    before, here, after = (ELLIPSE.at(s) for s in (t - h, t, t + h))
    rate = (after.anomaly_rad - before.anomaly_rad) / (2.0 * h)
    assert here.rate_rad_s == pytest.approx(rate, rel=1e-6)
    acceleration = (after.rate_rad_s - before.rate_rad_s) / (2.0 * h)
    assert here.acceleration_rad_s2 == pytest.approx(acceleration, rel=1e-5)
    assert here.attraction_s2 == pytest.approx(EARTH_MU_M3_S2 / here.radius_m**3, rel=1e-12)


@pytest.mark.parametrize("orbit", [ELLIPSE, CIRCLE])
def test_relative_motion_matches_two_bodies_in_an_inertial_frame(orbit: KeplerOrbit) -> None:
    times_s = np.linspace(0.0, 6000.0, 7)
    places, velocities = inertial_motion(orbit, times_s)
    found = propagate_relative(orbit, START, VELOCITY, times_s)
    for t, place, velocity, state in zip(times_s, places, velocities, found, strict=True):
        R = orbit.R_hill_world(t)
        r_hill = R @ (place[1] - place[0])
        v_hill = R @ (velocity[1] - velocity[0]) - np.cross(
            [0.0, -orbit.at(t).rate_rad_s, 0.0], r_hill
        )
        np.testing.assert_allclose(state[:3], r_hill, atol=2e-4)
        np.testing.assert_allclose(state[3:], v_hill, atol=2e-7)


def test_a_circle_is_the_known_circular_orbit() -> None:
    np.testing.assert_allclose(CIRCLE.R_hill_world(777.0), R_hill_world(777.0, N), atol=1e-14)
    # At 1 mm the tide is 1e-10 of gravity, and Hill is exact to 1 mm over the orbit radius.
    state = 1e-3 * np.array([1.0, -2.0, 3.0, 0.0, 0.0, 0.0])
    found = relative_acceleration(CIRCLE, state[:3], state[3:], 123.0)
    np.testing.assert_allclose(found, (hill_matrix(N) @ state)[3:], rtol=1e-8, atol=1e-17)


def test_energy_is_conserved() -> None:
    track = propagate_relative(CIRCLE, START * 100.0, VELOCITY * 100.0, np.linspace(0.0, 6e3, 13))
    p = track[:, :3] + [0.0, 0.0, -CIRCLE.at(0.0).radius_m]
    v = track[:, 3:] + np.cross([0.0, -N, 0.0], p)
    energy = 0.5 * np.sum(v**2, axis=1) - EARTH_MU_M3_S2 / np.linalg.norm(p, axis=1)
    np.testing.assert_allclose(energy, energy[0], rtol=1e-12)


def test_no_orbit_is_a_straight_line() -> None:
    rest = KeplerOrbit(0.0, 0.3, 1.0)
    np.testing.assert_array_equal(rest.R_hill_world(50.0), np.eye(3))
    np.testing.assert_array_equal(relative_acceleration(rest, START, VELOCITY, 50.0), np.zeros(3))
    r, v, transition = step_relative(rest, START, VELOCITY, 5.0, 20.0)
    np.testing.assert_allclose(r, START + 20.0 * VELOCITY, rtol=1e-14)
    np.testing.assert_array_equal(v, VELOCITY)
    np.testing.assert_allclose(transition, hill_transition(0.0, 20.0), rtol=1e-14)
    moved = propagate_relative(rest, START, VELOCITY, np.array([0.0, 20.0]))[1]
    np.testing.assert_allclose(moved[:3], r, rtol=1e-14)


@pytest.mark.parametrize("n", [1e-12, 1e-7])
def test_a_slow_orbit_comes_close_to_none(n: float) -> None:
    r, v, _ = step_relative(KeplerOrbit(n, 0.1, 0.4), START, VELOCITY, 0.0, 10.0)
    np.testing.assert_allclose(r, START + 10.0 * VELOCITY, atol=1e-6)
    np.testing.assert_allclose(v, VELOCITY, atol=1e-7)


@pytest.mark.parametrize("scale", [1.0, 1e4])
def test_the_jacobian_is_the_numerical_derivative(scale: float) -> None:
    r, v = scale * START, scale * VELOCITY
    by_r, by_v = relative_jacobian(ELLIPSE, r, 900.0)
    h = 1e-2 * scale
    for k, unit in enumerate(np.eye(3)):
        ahead, behind = (relative_acceleration(ELLIPSE, r + s * unit, v, 900.0) for s in (h, -h))
        np.testing.assert_allclose(by_r[:, k], (ahead - behind) / (2.0 * h), rtol=1e-6, atol=1e-13)
        ahead, behind = (relative_acceleration(ELLIPSE, r, v + s * unit, 900.0) for s in (h, -h))
        np.testing.assert_allclose(by_v[:, k], (ahead - behind) / (2.0 * h), rtol=1e-6, atol=1e-10)


def test_a_filter_step_is_as_exact_as_the_truth_and_so_is_its_transition() -> None:
    times_s = np.array([400.0, 460.0])
    exact = propagate_relative(ELLIPSE, START, VELOCITY, times_s)[1]
    r, v, transition = step_relative(ELLIPSE, START, VELOCITY, 400.0, 60.0)
    np.testing.assert_allclose(np.concatenate([r, v]), exact, rtol=1e-9, atol=1e-7)
    start = np.concatenate([START, VELOCITY])
    for k, h in enumerate([1.0] * 3 + [1e-2] * 3):
        ends = []
        for sign in (1.0, -1.0):
            moved = start + sign * h * np.eye(6)[k]
            ends.append(propagate_relative(ELLIPSE, moved[:3], moved[3:], times_s)[1])
        np.testing.assert_allclose(
            transition[:, k], (ends[0] - ends[1]) / (2.0 * h), rtol=1e-6, atol=1e-8
        )


def test_many_states_move_at_once() -> None:
    rng = np.random.default_rng(3)
    r, v = rng.normal(0.0, 100.0, (4, 2, 3)), rng.normal(0.0, 0.1, (4, 2, 3))
    together = step_relative(ELLIPSE, r, v, 10.0, 30.0)
    for index in np.ndindex(4, 2):
        alone = step_relative(ELLIPSE, r[index], v[index], 10.0, 30.0)
        for both, one in zip(together, alone, strict=True):
            np.testing.assert_allclose(both[index], one, rtol=1e-13, atol=1e-15)


@pytest.mark.parametrize(("n", "e"), [(N, 1.0), (N, -0.1), (-N, 0.0), (np.nan, 0.0), (N, np.nan)])
def test_what_is_no_ellipse_is_refused(n: float, e: float) -> None:
    with pytest.raises(ValueError, match="expected"):
        KeplerOrbit(n, e)
