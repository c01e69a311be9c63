"""All states of Hu 2024's filter fitted to the pixels of an arc, as if without process noise."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from pcnav.core.arrays import FloatArray
from pcnav.estimators.principal_axes.feature_measurements import FrameView
from pcnav.estimators.principal_axes.feature_states import (
    MOTION_SIZE,
    RATIOS,
    THETA,
    PrincipalAxesModel,
    PrincipalState,
)

_MAX_FRAMES = 40
_MAX_STEPS = 12
_SETTLED = 0.02
"""Of the standard deviations: what is left is a matter of noise."""
_ROBUST_SD = 4.0
"""A coordinate that is off by more weighs less (Huber 1964)."""
_TILT_SD_RAD = 0.5
_RATIO_SD = 0.5
"""Where the arc shows neither axes nor ratios, the start stays what they are."""
MAX_STEP_S = 0.5


@dataclass(frozen=True)
class ArcFit:
    """The fitted state at the first time."""

    state: PrincipalState
    covariance: FloatArray
    """(n, n)"""
    misfit: float
    """Squared residuals over degrees of freedom: 1 for what the model can explain."""
    converged: bool


def longest_steps(before_s: float, after_s: float) -> Iterator[tuple[float, float]]:
    """Start and length of equal steps that are short enough for the process noise's formulas."""
    span = after_s - before_s
    steps = max(1, int(np.ceil(span / MAX_STEP_S - 1e-9)))
    for k in range(steps):
        yield before_s + k * span / steps, span / steps


def fit_pixels(
    times_s: FloatArray,
    views: Sequence[FrameView],
    model: PrincipalAxesModel,
    start: PrincipalState,
) -> ArcFit:
    """Gauss-Newton with damping from a start near by; robust against single wrong pixels.

    Residuals and Jacobians are the filter's own, carried to the first time by its transition
    matrices. Weak priors hold what the arc does not show: axes, ratios, and the mass centre
    within the reach of the points.
    """
    every = -(-len(times_s) // _MAX_FRAMES)
    chosen = sorted({*range(0, len(times_s), every), len(times_s) - 1})
    times, seen = times_s[chosen], [views[k] for k in chosen]
    state, damping = start, 1e-4
    normal, gradient, cost, size = _normal_equations(times, seen, model, state, start)
    converged = False
    for _ in range(_MAX_STEPS):
        damped = normal + damping * np.diag(np.diag(normal))
        inverse = np.asarray(np.linalg.inv(damped), np.float64)
        step = state.admissible(inverse @ gradient, inverse)
        tried = state.retract(step)
        after = _normal_equations(times, seen, model, tried, start)
        converged = bool(np.all(np.abs(step) < _SETTLED / np.sqrt(np.diag(normal))))
        if after[2] <= cost * (1.0 + 1e-9):
            state, damping = tried, max(0.1 * damping, 1e-12)
            normal, gradient, cost, size = after
        else:
            damping = min(10.0 * damping, 1e6)
        if converged:
            break
    degrees = max(size - len(gradient), 1)
    covariance = np.asarray(np.linalg.inv(normal), np.float64)
    return ArcFit(state, covariance, cost / degrees, converged)


def _normal_equations(
    times: FloatArray,
    views: Sequence[FrameView],
    model: PrincipalAxesModel,
    first: PrincipalState,
    start: PrincipalState,
) -> tuple[FloatArray, FloatArray, float, int]:
    """Normal matrix (n, n), right-hand side (n,), cost and number of residuals."""
    size = MOTION_SIZE + 3 * len(first.points)
    transition = np.eye(size)
    normal, gradient, cost = _priors(first, start)
    state, count = first, 0
    for k, view in enumerate(views):
        if k > 0:
            step = float(times[k] - times[k - 1])
            state, moved, _ = model.propagate(state, float(times[k - 1]), step)
            transition = moved @ transition
        residual, jacobian = view.at(state)
        sigma = np.sqrt(np.diag(view.covariance))
        scaled = (residual / sigma).ravel()
        H = (jacobian / sigma[:, None]).reshape(-1, size) @ transition
        weight = np.minimum(1.0, _ROBUST_SD / np.maximum(np.abs(scaled), 1e-12))
        normal += H.T @ (weight[:, None] * H)
        gradient += H.T @ (weight * scaled)
        beyond = np.abs(scaled) > _ROBUST_SD
        squares = np.where(beyond, 2.0 * _ROBUST_SD * np.abs(scaled) - _ROBUST_SD**2, scaled**2)
        cost += float(squares.sum())
        count += len(scaled)
    return normal, gradient, cost, count


def _priors(first: PrincipalState, start: PrincipalState) -> tuple[FloatArray, FloatArray, float]:
    """What the weak priors add."""
    size = MOTION_SIZE + 3 * len(first.points)
    normal, gradient, cost = np.zeros((size, size)), np.zeros(size), 0.0
    away = first.local(start)
    for block, sd in ((THETA, _TILT_SD_RAD), (RATIOS, _RATIO_SD)):
        normal[block, block] = np.eye(block.stop - block.start) / sd**2
        gradient[block] = away[block] / sd**2
        cost += float(away[block] @ away[block]) / sd**2
    n = len(first.points)
    middle = first.points.mean(axis=0)
    reach = float(np.square(first.points - middle).sum(axis=1).max())
    by = np.zeros((3, size))
    by[:, MOTION_SIZE:] = np.tile(np.eye(3), n) / n
    normal += by.T @ by / reach
    gradient -= by.T @ middle / reach
    return normal, gradient, cost + float(middle @ middle) / reach


def weakly_held(state: PrincipalState, covariance: FloatArray) -> FloatArray:
    """(n, n) a covariance of the state's error after the weak priors."""
    normal, _, _ = _priors(state, state)
    size = len(covariance)
    # (P^-1 + N)^-1 without inverting P, which may be nearly singular.
    return np.asarray(np.linalg.solve(np.eye(size) + covariance @ normal, covariance), np.float64)
