"""Nonlinear least squares of a relative motion on its matches, with a first-order covariance."""

from dataclasses import dataclass

import numpy as np

from pcnav.core import chi_square
from pcnav.core.arrays import BoolArray, FloatArray
from pcnav.core.spatial import exp_rotation, skew
from pcnav.estimators.image_motion.essential import essential_of, homogeneous

_MAX_STEPS = 60
_FEW_STEPS = 6
_MAX_EXCESS = 100.0
_FIT_PROBABILITY = 0.9999
_FIRST_DAMPING = 1e-4
_MAX_DAMPING = 1e8
_CONVERGED = 1e-9
"""A step that changes one plus the squared residuals by a smaller share ends the search."""
_MIN_EIGENVALUE = 1e-12
"""Share of the largest information below which a direction counts as unknown."""
_AXES = skew(np.eye(3))


@dataclass(frozen=True)
class RefinedMotion:
    """Minima of the squared Sampson errors, reached from B starts."""

    R: FloatArray
    """(B, 3, 3) R_second_first."""
    t: FloatArray
    """(B, 3) unit."""
    squared: FloatArray
    """(B,) sum of squared residuals over the noise: chi-square of n - 5 degrees."""
    settled: BoolArray
    """(B,) whether a minimum was reached. The others were given up."""


@dataclass(frozen=True)
class MotionGain:
    """How one relative motion depends on the noise of its matches, to first order."""

    covariance: FloatArray
    """(3, 3) of the rotation error eps, rad^2: ``R = R_hat exp(eps)``, axes of the first view."""
    by_first: FloatArray
    """(n, 3, 2) derivative of eps by the normalised coordinates of every match, first view."""
    by_second: FloatArray
    """(n, 3, 2) of the second view."""


def refine(
    R: FloatArray, t: FloatArray, first: FloatArray, second: FloatArray, sigma: float
) -> RefinedMotion:
    """Levenberg-Marquardt over rotation and direction of t, five numbers, from B starts at once.

    Args:
        R: (B, 3, 3) to start from.
        t: (B, 3) to start from.
        first: matches (n, 2), normalised coordinates, and ``second``.
        second: see ``first``.
        sigma: their noise.

    A start that still lies far above a minimum that explains the matches is given up after a few
    steps: the mirrored motion lies in a long curved valley that leads to the right one.
    """
    R, t = R.copy(), t.copy()
    enough = float(chi_square.quantile(_FIT_PROBABILITY, max(len(first) - 5, 1)))
    damping = np.full(len(R), _FIRST_DAMPING)
    residuals, jacobian = _linearised(R, t, first, second, sigma)
    squared = np.sum(residuals**2, axis=-1)
    active, settled = np.ones(len(R), dtype=np.bool_), np.zeros(len(R), dtype=np.bool_)
    for done in range(_MAX_STEPS):
        k = np.flatnonzero(active)
        step = _damped_step(jacobian[k], residuals[k], damping[k])
        R_new, t_new = R[k] @ exp_rotation(step[:, :3]), _moved(t[k], step[:, 3:])
        tried, jacobian_new = _linearised(R_new, t_new, first, second, sigma)
        lower = squared[k] - np.sum(tried**2, axis=-1)
        better = lower >= 0.0
        settled[k] = np.abs(lower) <= _CONVERGED * (1.0 + squared[k])
        at = k[better]
        R[at], t[at], squared[at] = R_new[better], t_new[better], squared[at] - lower[better]
        residuals[at], jacobian[at] = tried[better], jacobian_new[better]
        damping[k] *= np.where(better, 0.1, 10.0)
        active &= ~settled & (damping < _MAX_DAMPING)
        best = np.min(squared[settled], initial=np.inf)
        if done >= _FEW_STEPS and best <= enough:
            active &= squared <= best + _MAX_EXCESS
        if not active.any():
            break
    return RefinedMotion(R, t, squared, settled)


def motion_gain(
    R: FloatArray, t: FloatArray, first: FloatArray, second: FloatArray, sigma: float
) -> MotionGain:
    """Covariance and noise gains at a minimum: R (3, 3), t (3,), matches (n, 2) of noise sigma.

    A direction that the matches do not tell gets a large variance, not an infinite one.
    """
    J = _linearised(R[None], t[None], first, second, 1.0)[1][0]
    values, vectors = np.linalg.eigh(J.T @ J)
    values = np.maximum(values, _MIN_EIGENVALUE * values[-1])
    inverse = (vectors / values) @ vectors.T
    onto = -(inverse @ J.T)[:3].T
    E = essential_of(R, t)
    lines, back = homogeneous(first) @ E.T, homogeneous(second) @ E
    length = np.sqrt(np.sum(lines[:, :2] ** 2, axis=1) + np.sum(back[:, :2] ** 2, axis=1))
    by_first = onto[:, :, None] * (back[:, None, :2] / length[:, None, None])
    by_second = onto[:, :, None] * (lines[:, None, :2] / length[:, None, None])
    return MotionGain(sigma**2 * inverse[:3, :3], by_first, by_second)


def _linearised(
    R: FloatArray, t: FloatArray, first: FloatArray, second: FloatArray, sigma: float
) -> tuple[FloatArray, FloatArray]:
    """Sampson errors (B, n) over sigma, derivatives (B, n, 5) by eps and the tangent of t."""
    E = essential_of(R, t)
    tangents = _tangents(t)
    by = np.concatenate([E[:, None] @ _AXES, skew(tangents) @ R[:, None]], axis=1)
    a, b = homogeneous(first), homogeneous(second)
    lines, back = a @ np.swapaxes(E, -1, -2), b @ E
    error = np.sum(b * lines, axis=-1)
    squared = np.sum(lines[..., :2] ** 2, axis=-1) + np.sum(back[..., :2] ** 2, axis=-1)
    squared = np.maximum(squared, np.finfo(np.float64).tiny)
    d_lines = a @ np.swapaxes(by, -1, -2)
    d_back = b @ by
    d_error = np.sum(b * d_lines, axis=-1)
    d_squared = 2.0 * (
        np.sum(d_lines[..., :2] * lines[:, None, :, :2], axis=-1)
        + np.sum(d_back[..., :2] * back[:, None, :, :2], axis=-1)
    )
    root = np.sqrt(squared)
    jacobian = d_error / root[:, None] - 0.5 * (error / root**3)[:, None] * d_squared
    return error / (sigma * root), np.swapaxes(jacobian, -1, -2) / sigma


def _damped_step(jacobian: FloatArray, residuals: FloatArray, damping: FloatArray) -> FloatArray:
    """(B, 5) Levenberg's step, damped in proportion to the information (Marquardt)."""
    Jt = np.swapaxes(jacobian, -1, -2)
    information = Jt @ jacobian
    diagonal = np.einsum("bii->bi", information)
    floor = 1e-12 * np.max(diagonal, axis=-1, keepdims=True) + np.finfo(np.float64).tiny
    information = (
        information + np.eye(5) * (damping[:, None] * np.maximum(diagonal, floor) + floor)[:, None]
    )
    gradient = Jt @ residuals[..., None]
    return np.asarray(-np.linalg.solve(information, gradient)[..., 0])


def _moved(t: FloatArray, step: FloatArray) -> FloatArray:
    """(B, 3) unit directions moved along their tangents (B, 2)."""
    moved = t + np.einsum("bki,bk->bi", _tangents(t), step)
    return np.asarray(moved / np.linalg.norm(moved, axis=-1, keepdims=True))


def _tangents(t: FloatArray) -> FloatArray:
    """(B, 2, 3) orthonormal and across unit directions (B, 3)."""
    axis = np.eye(3)[np.argmin(np.abs(t), axis=-1)]
    across = axis - np.sum(axis * t, axis=-1, keepdims=True) * t
    across = across / np.sqrt(np.sum(across**2, axis=-1, keepdims=True))
    return np.stack([across, (skew(t) @ across[..., None])[..., 0]], axis=-2)
