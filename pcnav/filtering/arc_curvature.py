"""What the fit of an arc leaves open beyond its linearisation.

While some components are loose and their combinations with others are sharp, the states that
explain an arc lie on a bent surface: an inertia that is off by a tenth goes with another rate,
known to a millionth, and that rate is a curved function of it. The ellipsoid of a linearised fit
leaves that surface, and a true state well within the deviations of every single component is many
deviations off in combinations of them.

So the second moment of the error is taken to second order. With whitened errors z of the first
state, the best state given z lies beside ``x + L z`` by ``1/2 sum_ij k_ij z_i z_j`` (Clarke 1980),
where ``k_ij`` is what a Gauss-Newton step makes of the residuals' second derivatives. Fourth
moments of a normal z give the rest. How far this is from nothing is the measure of nonlinearity of
Bates and Watts (1980), on the scale of the normalised error squared.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.linalg import cholesky, solve_triangular

from pcnav.core.arrays import FloatArray

_NEGLIGIBLE = 0.1
"""A loose direction that adds less to the normalised error squared of the state bends nothing;
those that are known better still are not looked at."""
_STEPS = (1.0, -1.0, 0.5, -0.5, 0.25, -0.25)
"""In deviations: where there is no state so far away, the other side is tried, and nearer ones."""


@dataclass(frozen=True)
class LinearisedArc:
    """Residuals and last state of an arc, by the error of its first state."""

    jacobian: FloatArray
    """(m, n) of the whitened residuals."""
    sensitivity: FloatArray
    """(n, n) of the last state's error."""


@dataclass(frozen=True)
class Bend:
    """The second-order part of the last state's error."""

    second_moment: FloatArray
    """(n, n)"""
    excess: float
    """What it adds to the mean of the normalised error squared, which is n of a linear arc."""


def bend_of(
    at: LinearisedArc,
    error: FloatArray,
    covariance: FloatArray,
    loose: slice,
    linearised: Callable[[FloatArray], LinearisedArc],
) -> Bend:
    """The bend of an arc about its fit.

    Args:
        at: the arc at the fit.
        error: (n,) of the first state at the fit.
        covariance: (n, n) of it, to first order.
        loose: the components that may bend the others.
        linearised: the arc at another error (n,); raises `ValueError` where there is no state.
    """
    size, root = len(error), cholesky(covariance, lower=True)
    directions = _loosest_first(covariance, loose)
    whitened = solve_triangular(root, directions, lower=True)
    basis = _completed(whitened)
    last_root = at.sensitivity @ root
    second, mean, excess = np.zeros((size, size)), np.zeros(size), 0.0
    for k, direction in enumerate(directions.T):
        beside = _beside(linearised, error, direction)
        if beside is None:
            continue
        there, step = beside
        by_direction = (there.jacobian - at.jacobian) / step
        first_state = -covariance @ (at.jacobian.T @ by_direction)
        turned = (there.sensitivity - at.sensitivity) / step
        # Column j is k_kj: in the first k columns of the basis each pair is met twice.
        bends = (at.sensitivity @ first_state + turned) @ root @ basis
        weights = np.where(np.arange(size) <= k, 1.0, 2.0)
        weights[:k] = 0.0
        own = 0.5 * float(weights @ np.sum(np.linalg.solve(last_root, bends) ** 2, axis=0))
        second += 0.5 * (bends * weights) @ bends.T
        mean += 0.5 * bends[:, k]
        excess += own
        if excess < _NEGLIGIBLE:
            break
    excess += float(np.sum(np.linalg.solve(last_root, mean) ** 2))
    return Bend(second + np.outer(mean, mean), excess)


def _loosest_first(covariance: FloatArray, loose: slice) -> FloatArray:
    """(n, k) one deviation along each principal direction of the loose components, and all others
    as they go along with it."""
    variances, axes = np.linalg.eigh(covariance[loose, loose])
    return np.asarray((covariance[:, loose] @ axes / np.sqrt(variances))[:, ::-1])


def _completed(columns: FloatArray) -> FloatArray:
    """(n, n) an orthonormal basis that begins with orthonormal columns (n, k)."""
    size, count = columns.shape
    q, _ = np.linalg.qr(np.hstack([columns, np.eye(size)]))
    return np.hstack([columns, q[:, count:size]])


def _beside(
    linearised: Callable[[FloatArray], LinearisedArc], error: FloatArray, direction: FloatArray
) -> tuple[LinearisedArc, float] | None:
    for step in _STEPS:
        try:
            return linearised(error + step * direction), step
        except (ValueError, OverflowError):
            continue
    return None
