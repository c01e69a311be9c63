"""Torque-free rotation by other means than the package's."""

import numpy as np
from scipy.integrate import solve_ivp

from pcnav.core.arrays import FloatArray
from pcnav.core.spatial import skew


def euler_acceleration(inertia: FloatArray, omega: FloatArray) -> FloatArray:
    """Euler's equation, in any units of the inertia."""
    return np.asarray(np.linalg.solve(inertia, -np.cross(omega, inertia @ omega)))


def turned(
    inertia: FloatArray, omega: FloatArray, duration_s: float
) -> tuple[FloatArray, FloatArray]:
    """The turn R_body0_body1 and the rate after it, by an adaptive integrator."""

    def derivative(_: float, y: FloatArray) -> FloatArray:
        R, w = y[:9].reshape(3, 3), y[9:]
        return np.concatenate([(R @ skew(w)).ravel(), euler_acceleration(inertia, w)])

    start = np.concatenate([np.eye(3).ravel(), omega])
    y = solve_ivp(derivative, (0.0, duration_s), start, method="DOP853", rtol=1e-12, atol=1e-13).y
    return y[:9, -1].reshape(3, 3), y[9:, -1]
