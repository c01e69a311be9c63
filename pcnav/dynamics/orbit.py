"""Relative motion about a chaser on a circular orbit: Hill's linear equations.

Hill axes (DESIGN): x along-track, y minus orbit normal, z nadir. The orbit turns by +n about the
orbit normal, hence by -n about y. All functions accept a mean motion of 0 (straight lines).
"""

from functools import lru_cache

import numpy as np

from pcnav.core.arrays import FloatArray

EARTH_MU_M3_S2 = 3.986004418e14
"""Gravitational parameter of the Earth (EGM2008)."""

_SMALL_ORBIT_ANGLE_RAD = 0.1
"""Below this `t - sin t` is summed from its series, which loses no digits."""


def R_hill_world(time_s: float, mean_motion_rad_s: float) -> FloatArray:
    """(3, 3) rotation from world to Hill components, Rot_y(n t); the two agree at time 0."""
    angle = mean_motion_rad_s * time_s
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])


def hill_matrix(mean_motion_rad_s: float) -> FloatArray:
    """(6, 6) A of ``d(r, v)/dt = A (r, v)``: x'' = 2n z', y'' = -n^2 y, z'' = 3n^2 z - 2n x'."""
    n = mean_motion_rad_s
    matrix = np.zeros((6, 6))
    matrix[:3, 3:] = np.eye(3)
    matrix[4, 1] = -(n**2)
    matrix[5, 2] = 3.0 * n**2
    matrix[3, 5], matrix[5, 3] = 2.0 * n, -2.0 * n
    return matrix


@lru_cache(maxsize=64)
def hill_transition(mean_motion_rad_s: float, duration_s: float) -> FloatArray:
    """(6, 6) transition matrix of (r, v) in closed form (Clohessy and Wiltshire 1960).

    Read-only, cached: a sequence has few different steps.
    """
    transition = hill_transitions(mean_motion_rad_s, np.array(duration_s))
    transition.flags.writeable = False
    return transition


def hill_transitions(mean_motion_rad_s: float, durations_s: FloatArray) -> FloatArray:
    """(..., 6, 6) the same over times (...).

    Written in ``sin(a)/a`` of the orbit angle ``a = n t``, so nothing is divided by n.
    """
    n, t = mean_motion_rad_s, durations_s
    angle = n * t
    sine, cosine = np.sin(angle), np.cos(angle)
    # np.sinc(x) is sin(pi x) / (pi x).
    sine_over_n = t * np.sinc(angle / np.pi)
    versine = 2.0 * np.sin(0.5 * angle) ** 2
    versine_over_n = t * np.sin(0.5 * angle) * np.sinc(0.5 * angle / np.pi)
    transition = np.zeros((*t.shape, 6, 6))
    transition[..., range(6), range(6)] = 1.0
    transition[..., 0, 2] = 6.0 * _angle_minus_sine(angle)
    transition[..., 0, 3] = 4.0 * sine_over_n - 3.0 * t
    transition[..., 0, 5] = 2.0 * versine_over_n
    transition[..., 1, 1], transition[..., 1, 4] = cosine, sine_over_n
    transition[..., 2, 2] = 1.0 + 3.0 * versine
    transition[..., 2, 3] = -2.0 * versine_over_n
    transition[..., 2, 5] = sine_over_n
    transition[..., 3, 2] = 6.0 * n * versine
    transition[..., 3, 3], transition[..., 3, 5] = 1.0 - 4.0 * versine, 2.0 * sine
    transition[..., 4, 1], transition[..., 4, 4] = -n * sine, cosine
    transition[..., 5, 2] = 3.0 * n * sine
    transition[..., 5, 3], transition[..., 5, 5] = -2.0 * sine, cosine
    return transition


def _angle_minus_sine(angle: FloatArray) -> FloatArray:
    """``a - sin a`` without cancellation near 0."""
    square = angle**2
    # Horner form of a^3/3! - a^5/5! + a^7/7! - a^9/9!; the next term is below 1e-15 of the sum.
    series = 1.0 - square / 20.0 * (1.0 - square / 42.0 * (1.0 - square / 72.0))
    near = angle**3 / 6.0 * series
    return np.where(np.abs(angle) > _SMALL_ORBIT_ANGLE_RAD, angle - np.sin(angle), near)
