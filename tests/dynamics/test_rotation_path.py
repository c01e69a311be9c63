"""A path of rotation: against steps from time to time and another integrator."""

import numpy as np
import pytest

from pcnav.dynamics.inertia_parameters import inertia_of
from pcnav.dynamics.orbit import hill_transition, hill_transitions
from pcnav.dynamics.rotation_path import RotationPath, path_along
from pcnav.dynamics.rotation_step import rotate, torque_free_by_inertia
from tests.dynamics.reference import turned

BODIES = {
    "any": [1.1, 0.9, 0.1, -0.05, 0.08],
    "near symmetric": [0.7 + 1e-9, 0.7, 0.0, 0.0, 1e-10],
    "ball": [1.0, 1.0, 0.0, 0.0, 0.0],
    "no body": [2.4, 0.9, 0.0, 0.3, 0.0],
}
TIMES_S = np.cumsum([7.0, 0.5, 0.5, 0.0, 0.1, 9.0, 0.5, 31.0, 0.5])
"""With a repeated time, and steps of one and of many small turns."""


def along(parameters: list[float], omega: np.ndarray, times_s: np.ndarray) -> RotationPath:
    inertia = inertia_of(np.array(parameters))
    slope = torque_free_by_inertia(inertia, np.asarray(np.linalg.inv(inertia)))
    return path_along(slope, inertia, omega, times_s, 8)


@pytest.mark.parametrize("body", BODIES)
def test_path_is_the_steps_from_time_to_time(body: str) -> None:
    omega = np.array([0.05, -0.08, 0.1])
    path = along(BODIES[body], omega, TIMES_S)
    inertia = inertia_of(np.array(BODIES[body]))
    slope = torque_free_by_inertia(inertia, np.asarray(np.linalg.inv(inertia)))
    turn, transition = np.eye(3), np.eye(11)
    for k, step_s in enumerate(np.diff(TIMES_S), start=1):
        step = rotate(slope, omega, float(step_s), 8)
        turn, omega, transition = turn @ step.turn, step.omega_body, step.transition @ transition
        np.testing.assert_allclose(path.turn[k], turn, atol=1e-13)
        np.testing.assert_allclose(path.omega_body[k], omega, atol=1e-14)
        scale = np.abs(transition).max()
        np.testing.assert_allclose(path.transition[k] / scale, transition / scale, atol=1e-13)


def test_path_about_the_middle_axis_is_that_of_another_integrator() -> None:
    # The separatrix: the rate stays near the middle axis, turns over, and stays there again.
    inertia = np.diag([0.7, 1.0, 1.3])
    omega = np.array([1e-3, 0.1, -1e-3])
    path = along([1.0, 1.3, 0.0, 0.0, 0.0], omega, np.array([0.0, 40.0, 150.0, 260.0]))
    for k, duration_s in ((1, 40.0), (2, 150.0), (3, 260.0)):
        R, after = turned(inertia, omega, duration_s)
        np.testing.assert_allclose(path.omega_body[k], after, atol=2e-6)
        np.testing.assert_allclose(path.turn[k], R, atol=2e-5)
    assert path.omega_body[-1, 1] < -0.05


def test_one_time_is_where_it_began() -> None:
    path = along(BODIES["any"], np.array([0.1, 0.2, 0.3]), np.array([5.0]))
    np.testing.assert_array_equal(path.turn, np.eye(3)[None])
    np.testing.assert_array_equal(path.transition, np.eye(11)[None])


def test_a_rate_without_bounds_is_refused() -> None:
    with pytest.raises((ValueError, OverflowError)):
        along(BODIES["any"], np.array([0.1, np.nan, 0.3]), np.array([0.0, 1.0]))


@pytest.mark.parametrize("n", [0.0, 1.1e-3, 0.3])
def test_orbits_over_many_times_are_those_over_each(n: float) -> None:
    times_s = np.array([0.0, 0.1, 40.0, 500.0])
    each = [hill_transition(n, float(t)) for t in times_s]
    np.testing.assert_array_equal(hill_transitions(n, times_s), each)
