"""Inertia ratios and angular momentum from the attitudes of an arc: (10)-(16) of Hu 2024.

Without torque ``I omega = R_g_world H`` with constant I and H, which is linear in both (11). The
printed least squares takes omega, a regressor, from differentiated attitudes. Its noise does not
average out: it biases the solution as noise in regressors does. `errors_in_variables` takes the
known covariance of the rates into account; `rotation_arc` fits the motion itself
and is the default everywhere. All functions work over leading dimensions.
"""

import numpy as np

from pcnav.core.arrays import FloatArray
from pcnav.core.spatial import log_rotation
from pcnav.dynamics.rigid_body import symmetric_units

_ENTRIES = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
"""Order of the six entries of an inertia matrix in this module; (9) divides by the first."""


_UNITS = symmetric_units(_ENTRIES)


def angular_rate(R_world_g: FloatArray, times_s: FloatArray) -> FloatArray:
    """(..., n - 2, 3) rates of attitudes (..., n, 3, 3) at the inner times, axes of g, rad/s.

    Central differences on the rotation group. To first order in the step that is (15) with the
    quaternion differentiated; unlike it, it stays exact for a constant rate.
    """
    turned = np.swapaxes(R_world_g[..., :-2, :, :], -1, -2) @ R_world_g[..., 2:, :, :]
    # The rotation vector is the integral of the rate in body axes up to third order in the step.
    return np.asarray(log_rotation(turned) / (times_s[2:] - times_s[:-2])[:, None])


def momentum_rows(R_world_g: FloatArray, omega_g: FloatArray) -> FloatArray:
    """(..., 3, 9) rows of ``I omega - R_g_world H = 0`` by the six entries of I and by H.

    The first column, negated, is b of (12), the other eight are a.
    """
    by_entries = np.einsum("eij,...j->...ie", _UNITS, omega_g)
    return np.concatenate([by_entries, -np.swapaxes(R_world_g, -1, -2)], axis=-1)


def batch_least_squares(R_world_g: FloatArray, omega_g: FloatArray) -> FloatArray:
    """(..., 3, 3) inertia over Ixx, axes of g (9): the printed solution (13)-(14).

    From attitudes (..., n, 3, 3) and rates (..., n, 3).
    """
    rows = momentum_rows(R_world_g, omega_g)
    return solve_normal(np.einsum("...nie,...nif->...ef", rows, rows))


def solve_normal(normal: FloatArray) -> FloatArray:
    """(..., 3, 3) the printed solution from the sum of ``rows^T rows`` (..., 9, 9)."""
    x = np.linalg.solve(normal[..., 1:, 1:], -normal[..., 1:, :1])[..., 0]
    return _inertia(np.concatenate([np.ones((*x.shape[:-1], 1)), x[..., :5]], axis=-1))


def errors_in_variables(
    R_world_g: FloatArray, omega_g: FloatArray, rate_noise: FloatArray
) -> FloatArray:
    """(..., 3, 3) inertia over Ixx that the noise of the rates does not bias.

    From attitudes (..., n, 3, 3) and rates (..., n, 3).

    ``rate_noise`` (..., n, 3, 3) is the covariance of the rates, of any scale. In the homogeneous
    rows the noise adds ``sum of A_i Cov A_j`` to the normal matrix of the six entries, whatever
    the entries are. The entries sought minimise the squared residual over what noise alone makes of
    it: the smallest generalised eigenvalue. H is eliminated first; attitudes are as good as
    exact beside rates differentiated from them.
    """
    rows = momentum_rows(R_world_g, omega_g)
    normal = np.einsum("...nie,...nif->...ef", rows, rows)
    cross, momentum = normal[..., :6, 6:], normal[..., 6:, 6:]
    reduced = normal[..., :6, :6] - cross @ np.linalg.solve(momentum, np.swapaxes(cross, -1, -2))
    total = rate_noise.sum(axis=-3)
    noise = np.einsum("eij,...jk,fik->...ef", _UNITS, total, _UNITS)
    root = np.linalg.inv(np.linalg.cholesky(noise))
    _, vectors = np.linalg.eigh(root @ reduced @ np.swapaxes(root, -1, -2))
    entries = (np.swapaxes(root, -1, -2) @ vectors[..., :1])[..., 0]
    return _inertia(entries / entries[..., :1])


def _inertia(entries: FloatArray) -> FloatArray:
    """(..., 3, 3) of its six entries (..., 6)."""
    return np.asarray(np.einsum("...e,eij->...ij", entries, _UNITS))
