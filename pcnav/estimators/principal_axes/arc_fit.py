"""All states of Hu 2024's filter fitted to the pixels of an arc, as if without process noise."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from pcnav.core.arrays import BoolArray, FloatArray
from pcnav.estimators.principal_axes.feature_measurements import FeatureView
from pcnav.estimators.principal_axes.feature_states import (
    PA_MOTION_SIZE,
    PA_RATIOS,
    PA_THETA,
    PrincipalAxesModel,
    PrincipalState,
)
from pcnav.filtering.least_squares import ArcProblem, Descent, NormalEquations, minimise

_MAX_FRAMES = 40
_DESCENT = Descent(max_steps=12, settled_sd=0.02, damping=(1e-4, 1e-12, 1e6), slack=1e-9)
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


def bounded_steps(before_s: float, after_s: float) -> Iterator[tuple[float, float]]:
    """Start and length of equal steps that are short enough for the process noise's formulas."""
    span = after_s - before_s
    steps = max(1, int(np.ceil(span / MAX_STEP_S - 1e-9)))
    for k in range(steps):
        yield before_s + k * span / steps, span / steps


def fit_pixels(
    times_s: FloatArray,
    views: Sequence[FeatureView],
    model: PrincipalAxesModel,
    start: PrincipalState,
) -> ArcFit:
    """Least squares from a start near by, robust against single wrong pixels.

    Residuals and Jacobians are the filter's own, carried to the first time by its transition
    matrices. Weak priors hold what the arc does not show: axes, ratios, and the mass centre
    within the reach of the points.
    """
    every = -(-len(times_s) // _MAX_FRAMES)
    kept = sorted({*range(0, len(times_s), every), len(times_s) - 1})
    problem = _PixelProblem(times_s[kept].tolist(), [views[k] for k in kept], model, start)
    found = minimise(problem, start, _DESCENT)
    covariance = np.asarray(np.linalg.inv(found.equations.normal[0]), np.float64)
    degrees = max(problem.residuals - len(covariance), 1)
    misfit = float(found.equations.cost[0]) / degrees
    return ArcFit(found.state, covariance, misfit, bool(found.converged[0]))


@dataclass(frozen=True)
class _PixelProblem(ArcProblem[PrincipalState, NormalEquations]):
    """One arc: a batch of one."""

    times_s: Sequence[float]
    views: Sequence[FeatureView]
    model: PrincipalAxesModel
    start: PrincipalState

    @property
    def residuals(self) -> int:
        """How many there are."""
        return sum(4 * len(view.features) for view in self.views)

    def linearised(self, state: PrincipalState) -> NormalEquations:
        size = PA_MOTION_SIZE + 3 * len(state.points)
        transition = np.eye(size)
        normal, gradient, cost = _priors(state, self.start)
        for k, view in enumerate(self.views):
            if k > 0:
                before = self.times_s[k - 1]
                state, moved, _ = self.model.propagate(state, before, self.times_s[k] - before)
                transition = moved @ transition
            residual, jacobian = view.at(state)
            sigma = np.sqrt(np.diag(view.covariance))
            scaled = (residual / sigma).ravel()
            H = (jacobian / sigma[:, None]).reshape(-1, size) @ transition
            off = np.abs(scaled)
            weight = np.minimum(1.0, _ROBUST_SD / np.maximum(off, 1e-12))
            normal += H.T @ (weight[:, None] * H)
            gradient += H.T @ (weight * scaled)
            linear = 2.0 * _ROBUST_SD * off - _ROBUST_SD**2
            cost += float(np.where(off > _ROBUST_SD, linear, scaled**2).sum())
        return NormalEquations(normal[None], gradient[None], np.array([cost]))

    def step(self, state: PrincipalState, damped: FloatArray, gradient: FloatArray) -> FloatArray:
        inverse = np.asarray(np.linalg.inv(damped[0]), np.float64)
        return state.admissible(inverse @ gradient[0], inverse)[None]

    def moved(self, state: PrincipalState, step: FloatArray) -> PrincipalState:
        return state.retract(step[0])

    def choose(
        self, which: BoolArray, tried: PrincipalState, before: PrincipalState
    ) -> PrincipalState:
        return tried if which[0] else before


def _priors(first: PrincipalState, start: PrincipalState) -> tuple[FloatArray, FloatArray, float]:
    """What the weak priors add."""
    size = PA_MOTION_SIZE + 3 * len(first.points)
    normal, gradient, cost = np.zeros((size, size)), np.zeros(size), 0.0
    away = first.local(start)
    for block, sd in ((PA_THETA, _TILT_SD_RAD), (PA_RATIOS, _RATIO_SD)):
        normal[block, block] = np.eye(block.stop - block.start) / sd**2
        gradient[block] = away[block] / sd**2
        cost += float(away[block] @ away[block]) / sd**2
    n = len(first.points)
    middle = first.points.mean(axis=0)
    reach = float(np.square(first.points - middle).sum(axis=1).max())
    by = np.zeros((3, size))
    by[:, PA_MOTION_SIZE:] = np.tile(np.eye(3), n) / n
    normal += by.T @ by / reach
    gradient -= by.T @ middle / reach
    return normal, gradient, cost + float(middle @ middle) / reach


def weakly_held(state: PrincipalState, covariance: FloatArray) -> FloatArray:
    """(n, n) a covariance of the state's error after the weak priors."""
    normal, _, _ = _priors(state, state)
    size = len(covariance)
    # (P^-1 + N)^-1 without inverting P, which may be nearly singular.
    return np.asarray(np.linalg.solve(np.eye(size) + covariance @ normal, covariance), np.float64)
