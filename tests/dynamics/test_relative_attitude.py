"""The relative rate (19) and the inertial body rate are one motion."""

import numpy as np
from scipy.integrate import solve_ivp

from pcnav.core.spatial import exp_rotation, skew
from pcnav.dynamics.kepler import KeplerOrbit
from pcnav.dynamics.relative_attitude import inertial_rate, relative_rate, relative_rate_derivative
from pcnav.dynamics.rotation_step import rotate, torque_free

INERTIA = np.array([[96.0, 43.0, 20.0], [43.0, 104.0, 10.0], [20.0, 10.0, 133.0]])
ORBIT = KeplerOrbit(1.04e-3, 0.3, 0.4)


def test_the_two_descriptions_are_inverse():
    rng = np.random.default_rng(0)
    R = exp_rotation(rng.normal(size=(5, 3)))
    omega, chaser = rng.normal(size=(2, 5, 3))
    np.testing.assert_allclose(inertial_rate(R, relative_rate(R, omega, chaser), chaser), omega)


def test_relative_and_inertial_rates_integrate_to_the_same_motion():
    """Chaser aligned with the Hill axes of an eccentric orbit; printed (19) and (20), derived."""
    omega, R = np.array([0.02, -0.03, 0.015]), exp_rotation(np.array([0.3, -1.0, 0.7]))
    end, step = 200.0, 1.0

    def derivative(t, y):
        D, w = y[:9].reshape(3, 3), y[9:]
        point = ORBIT.at(t)
        rate = np.array([0.0, -point.rate_rad_s, 0.0])
        acceleration = np.array([0.0, -point.acceleration_rad_s2, 0.0])
        change = relative_rate_derivative(D, w, INERTIA, rate, acceleration)
        return np.concatenate([(skew(w) @ D).ravel(), change])

    start = np.concatenate([R.ravel(), relative_rate(R, omega, ORBIT.omega_hill(0.0))])
    solved = solve_ivp(derivative, (0.0, end), start, method="DOP853", rtol=1e-12, atol=1e-13)
    relative = solved.y[:, -1]
    turned, slope = R, torque_free(INERTIA, np.linalg.inv(INERTIA))
    for _ in range(int(end / step)):
        moved = rotate(slope, omega, step)
        turned, omega = turned @ moved.turn, moved.omega_body
    D = ORBIT.R_hill_world(end) @ turned
    np.testing.assert_allclose(relative[:9].reshape(3, 3), D, atol=1e-7)
    np.testing.assert_allclose(
        relative[9:], relative_rate(D, omega, ORBIT.omega_hill(end)), atol=1e-8
    )
