"""Inertia ratios and angular momentum from the attitudes of an arc: (10)-(16) of Hu 2024.

Without torque ``I omega = R_g_world H`` with constant I and H, which is linear in both (11). The
printed least squares takes omega, a regressor, from differentiated attitudes. Its noise does not
average out: it biases the solution as noise in regressors does. `errors_in_variables` takes the
known covariance of the rates into account; `rotation_arc` fits the motion itself
and is the default everywhere. All functions work over leading dimensions.
"""

from dataclasses import dataclass

import numpy as np

from pcnav.core.arrays import FloatArray
from pcnav.core.spatial import log_rotation
from pcnav.dynamics.rigid_body import ratios_from_inertia

_ENTRIES = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
"""Order of the six entries of an inertia matrix in this module; (9) divides by the first."""


def _entry_units() -> FloatArray:
    units = np.zeros((6, 3, 3))
    for unit, (i, j) in zip(units, _ENTRIES, strict=True):
        unit[i, j] = unit[j, i] = 1.0
    return units


_UNITS = _entry_units()


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


@dataclass(frozen=True)
class MomentumFit:
    """What a linear fit found."""

    inertia: FloatArray
    """(..., 3, 3) over Ixx, axes of g: (9)."""
    momentum_world: FloatArray
    """(..., 3) H over Ixx, rad/s."""


def batch_least_squares(R_world_g: FloatArray, omega_g: FloatArray) -> MomentumFit:
    """The printed solution (13)-(14) from attitudes (..., n, 3, 3) and rates (..., n, 3)."""
    rows = momentum_rows(R_world_g, omega_g)
    return solve_normal(np.einsum("...nie,...nif->...ef", rows, rows))


def solve_normal(normal: FloatArray) -> MomentumFit:
    """The printed solution from the sum of ``rows^T rows`` (..., 9, 9)."""
    x = np.linalg.solve(normal[..., 1:, 1:], -normal[..., 1:, :1])[..., 0]
    return _fit(np.concatenate([np.ones((*x.shape[:-1], 1)), x], axis=-1))


@dataclass(frozen=True)
class RecursiveLeastSquares:
    """(13) one epoch after the other: the solution so far and the inverse of its normal matrix.

    With the wide prior of `RecursiveLeastSquares.start` it equals the batch solution but for what
    the prior holds back.
    """

    solution: FloatArray
    """(8,) ratios Iyy, Izz, Ixy, Ixz, Iyz over Ixx, then H."""
    inverse: FloatArray
    """(8, 8)"""

    @staticmethod
    def start(prior_sd: float = 1e4) -> "RecursiveLeastSquares":
        """Nothing known: a ball, with a standard deviation in units of the row noise."""
        ball = np.array([1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
        return RecursiveLeastSquares(ball, prior_sd**2 * np.eye(8))

    def add(self, R_world_g: FloatArray, omega_g: FloatArray) -> "RecursiveLeastSquares":
        """Take in attitude (3, 3) and rate (3,) of an epoch."""
        rows = momentum_rows(R_world_g, omega_g)
        a, b = rows[:, 1:], -rows[:, 0]
        spread = self.inverse @ a.T
        gain = spread @ np.linalg.inv(np.eye(3) + a @ spread)
        inverse = self.inverse - gain @ spread.T
        return RecursiveLeastSquares(
            self.solution + gain @ (b - a @ self.solution), 0.5 * (inverse + inverse.T)
        )

    def fit(self) -> MomentumFit:
        """Inertia and momentum so far."""
        return _fit(np.concatenate([[1.0], self.solution]))


def errors_in_variables(
    R_world_g: FloatArray, omega_g: FloatArray, rate_noise: FloatArray
) -> MomentumFit:
    """The fit that the noise of the rates does not bias, from (..., n, 3, 3) and (..., n, 3).

    ``rate_noise`` (..., n, 3, 3) is the covariance of the rates, of any scale. In the homogeneous
    rows the noise adds ``sum of A_i Cov A_j`` to the normal matrix of the six entries, whatever
    the entries are. The entries sought minimise the squared residual over what noise alone makes of
    it: the smallest generalised eigenvalue. H is eliminated first; attitudes are as good as
    exact beside rates differentiated from them.
    """
    rows = momentum_rows(R_world_g, omega_g)
    normal = np.einsum("...nie,...nif->...ef", rows, rows)
    cross, momentum = normal[..., :6, 6:], normal[..., 6:, 6:]
    back = np.linalg.solve(momentum, np.swapaxes(cross, -1, -2))
    reduced = normal[..., :6, :6] - cross @ back
    total = rate_noise.sum(axis=-3)
    noise = np.einsum("eij,...jk,fik->...ef", _UNITS, total, _UNITS)
    root = np.linalg.inv(np.linalg.cholesky(noise))
    _, vectors = np.linalg.eigh(root @ reduced @ np.swapaxes(root, -1, -2))
    entries = (np.swapaxes(root, -1, -2) @ vectors[..., :1])[..., 0]
    entries = entries / entries[..., :1]
    return _fit(np.concatenate([entries, -(back @ entries[..., None])[..., 0]], axis=-1))


def _fit(x: FloatArray) -> MomentumFit:
    """Of the six entries and H (..., 9)."""
    inertia = np.einsum("...e,eij->...ij", x[..., :6], _UNITS)
    return MomentumFit(inertia, x[..., 6:])


def ratios_of(fit: MomentumFit) -> FloatArray:
    """(5,) of one fit: l of (9)."""
    return ratios_from_inertia(fit.inertia)
