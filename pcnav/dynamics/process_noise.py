"""What disturbances that are white add to a state over a time step."""

from functools import lru_cache

import numpy as np
from scipy.linalg import expm

from pcnav.core.arrays import FloatArray
from pcnav.dynamics.orbit import hill_matrix


@lru_cache(maxsize=64)
def hill_process_noise(
    mean_motion_rad_s: float, duration_s: float, acceleration_psd_m2_s3: float
) -> FloatArray:
    """(6, 6) covariance that white acceleration adds to (r, v) over a time step.

    The power spectral density (m^2/s^3) is the same along the three axes. Van Loan's (1978)
    matrix exponential, exact for any mean motion. Read-only, cached.
    """
    A = hill_matrix(mean_motion_rad_s)
    block = np.zeros((12, 12))
    block[:6, :6] = -A
    block[3:6, 9:12] = np.eye(3)
    block[6:, 6:] = A.T
    exponential = expm(block * duration_s)
    covariance = exponential[6:, 6:].T @ exponential[:6, 6:]
    noise = np.asarray(0.5 * acceleration_psd_m2_s3 * (covariance + covariance.T))
    noise.flags.writeable = False
    return noise


def white_acceleration_noise(density: FloatArray | float, step_s: float) -> FloatArray:
    """(6, 6) covariance that a white acceleration adds to a value and its rate, 3 components each.

    Of a translation or of a rotation that turns little in the step. The power spectral density
    (m^2/s^3 or rad^2/s^3) is one for all components, or (3,).
    """
    noise = np.zeros((6, 6))
    value, rate = np.arange(3), np.arange(3, 6)
    noise[value, value] = density * step_s**3 / 3.0
    noise[value, rate] = noise[rate, value] = density * step_s**2 / 2.0
    noise[rate, rate] = density * step_s
    return noise
