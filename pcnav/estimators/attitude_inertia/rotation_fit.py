"""Free rotations fitted to the attitudes of arcs, many arcs of the same times at once.

A filter linearises each attitude once, about an inertia that is hardly known yet, and the terms
dropped then leave false confidence. A fit has no such memory. `fit_rotations` has a prior on all
states, `fit_rotation_arc` only a weak one on the inertia: what the linear identification of Hu 2024
(11)-(14) asks of rates, it asks of the motion itself. Nothing that is measured is a regressor, so
noise does not bias the result, and an attitude weighs by its own covariance.
"""

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.linalg import solve_triangular

from pcnav.core.arrays import BoolArray, FloatArray
from pcnav.core.spatial import left_jacobian, log_rotation
from pcnav.dynamics.inertia_parameters import BALL, inertia_of, thinness
from pcnav.dynamics.rotation_step import at_rest, torque_free_by_inertia
from pcnav.estimators.attitude_inertia.rotation_model import (
    INERTIA,
    SIZE,
    THETA,
    RotationState,
    TorqueFreeModel,
)
from pcnav.filtering.least_squares import ArcProblem, Descent, NormalEquations, minimise

_DESCENT = Descent(max_steps=30, settled_sd=0.02, damping=(1e-4, 1e-12, 1e10))
_BALL_SD = 0.5
"""Of each inertia parameter about a ball's: what an arc does not show stays a ball's."""
_MIN_MOMENT = 0.05
"""Over the mean moment."""


@dataclass(frozen=True)
class RotationPrior:
    """Prior of the states at the first time of an arc."""

    mean: RotationState
    """(B,)"""
    covariance: FloatArray
    """(11, 11) or (B, 11, 11)."""


@dataclass(frozen=True)
class AttitudeArc:
    """Attitudes measured along arcs of the same times."""

    times_s: FloatArray
    """(n,) increasing; the first is the prior's."""
    R_world_body: FloatArray
    """(n, B, 3, 3)"""
    noise: FloatArray
    """(n, 3, 3) of each, body axes, rad^2; or (3n, 3n) of all, where their errors are correlated.
    """

    def whitened(self, rows: FloatArray) -> FloatArray:
        """(n, B, 3, m) rows of the attitudes in units of their noise, independent ones."""
        root = np.linalg.cholesky(self.noise)
        if root.ndim == 3:
            return np.asarray(np.linalg.solve(root[:, None], rows))
        n, runs, _, m = rows.shape
        stacked = np.moveaxis(rows, 1, 2).reshape(3 * n, runs * m)
        white = solve_triangular(root, stacked, lower=True, check_finite=False)
        return np.moveaxis(np.asarray(white).reshape(n, 3, runs, m), 2, 1)


@dataclass(frozen=True)
class RotationFit:
    """The motions that fit arcs best."""

    start: RotationState
    """(B,) at the first time."""
    end: RotationState
    """(B,) at the last."""
    covariance: FloatArray
    """(B, 11, 11) of the errors at the last."""
    cost: FloatArray
    """(B,) weighted squares, those of the prior included."""
    converged: BoolArray
    """(B,)"""


@dataclass(frozen=True)
class _Guided(NormalEquations):
    """Normal equations with what keeps the inertia a body's."""

    measured: FloatArray
    """(B, 11, 11) of prior and attitudes alone: the information. As a measurement the guidance
    would claim too much."""


@dataclass(frozen=True)
class _PriorProblem(ArcProblem[RotationState, _Guided]):
    """Prior and attitudes."""

    model: TorqueFreeModel
    prior: RotationPrior
    arc: AttitudeArc

    def linearised(self, state: RotationState) -> _Guided:
        weight = np.linalg.inv(self.prior.covariance)
        # By a small error of the start: log(exp(a) exp(da)) = a + J_r(a)^-1 da.
        away = self.prior.mean.local(state)
        by_error = np.broadcast_to(np.eye(SIZE), (len(away), SIZE, SIZE)).copy()
        by_error[:, THETA, THETA] = np.linalg.inv(left_jacobian(-away[:, THETA]))
        weighted = np.swapaxes(by_error, -1, -2) @ weight
        normal = weighted @ by_error
        gradient = -(weighted @ away[..., None])[..., 0]
        cost = np.einsum("bi,bij,bj->b", away, np.broadcast_to(weight, normal.shape), away)
        rows = self.arc.whitened(self._rows(state))
        H, error = rows[..., :SIZE], rows[..., SIZE]
        normal = normal + np.einsum("nbij,nbik->bjk", H, H)
        gradient = gradient + np.einsum("nbij,nbi->bj", H, error)
        cost = cost + np.einsum("nbi,nbi->b", error, error)
        lack, slopes = thinness(state.parameters)
        guided = normal.copy()
        guided[:, INERTIA, INERTIA] += np.swapaxes(slopes, -1, -2) @ slopes
        gradient[:, INERTIA] -= (np.swapaxes(slopes, -1, -2) @ lack[..., None])[..., 0]
        return _Guided(guided, gradient, cost + np.sum(lack**2, axis=-1), normal)

    def moved(self, state: RotationState, step: FloatArray) -> RotationState:
        return _moved(state, step)

    def _rows(self, start: RotationState) -> FloatArray:
        """(n, B, 3, 12) derivative of the attitudes by the errors of the start; residuals."""
        rows = []
        for (state, transition), seen in zip(self.along(start), self.arc.R_world_body, strict=True):
            error = log_rotation(np.swapaxes(state.R_world_body, -1, -2) @ seen)
            H = np.linalg.inv(left_jacobian(error)) @ transition[:, THETA]
            rows.append(np.concatenate([H, error[..., None]], axis=-1))
        return np.stack(rows)

    def along(self, start: RotationState) -> Iterator[tuple[RotationState, FloatArray]]:
        """The states at all times, and the transitions (B, 11, 11) to them."""
        transition = np.broadcast_to(np.eye(SIZE), (len(start.omega_body), SIZE, SIZE))
        yield start, transition
        for before, time_s in pairwise(self.arc.times_s.tolist()):
            start, step, _ = self.model.propagate(start, before, time_s - before)
            transition = step @ transition
            yield start, transition


def fit_rotations(
    model: TorqueFreeModel, prior: RotationPrior, arc: AttitudeArc, start: RotationState
) -> RotationFit:
    """Least squares over prior and attitudes.

    ``start`` (B,) is where the iteration begins. Process noise is left out: over the arcs this is
    for it is far below that of the attitudes.
    """
    problem = _PriorProblem(model, prior, arc)
    found = minimise(problem, start, _DESCENT)
    ((end, transition),) = deque(problem.along(found.state), maxlen=1)
    P = transition @ np.linalg.inv(found.equations.measured) @ np.swapaxes(transition, -1, -2)
    P = 0.5 * (P + np.swapaxes(P, -1, -2))
    return RotationFit(found.state, end, P, found.equations.cost, found.converged)


def positive(parameters: FloatArray) -> FloatArray:
    """(..., 5) moved towards a ball's until all moments are positive.

    The triangle inequality is left alone: a fit that errs past it is no worse for that, and one
    that is held at it would not know how far it errs.
    """
    least = np.linalg.eigvalsh(inertia_of(parameters))[..., 0]
    # The ball's moments are all 1; the smallest moment is concave along the way to it.
    part = np.where(least < _MIN_MOMENT, (1.0 - _MIN_MOMENT) / (1.0 - np.minimum(least, 0.5)), 1.0)
    return np.asarray(BALL + part[..., None] * (parameters - BALL), dtype=np.float64)


def _moved(state: RotationState, step: FloatArray) -> RotationState:
    """Moved by errors (B, 11), as far as the principal moments stay positive."""
    allowed = step.copy()
    allowed[:, INERTIA] = positive(state.parameters + step[:, INERTIA]) - state.parameters
    return state.retract(allowed)


@dataclass(frozen=True)
class _FreeProblem(ArcProblem[RotationState, NormalEquations]):
    """Attitudes alone, and a ball's inertia where they show none."""

    times_s: FloatArray
    measured: FloatArray
    """(B, n, 3, 3)"""
    weight: FloatArray
    """(B, n, 3, 3)"""

    def linearised(self, state: RotationState) -> NormalEquations:
        R, parameters, batch = state.R_world_body, state.parameters, len(state.parameters)
        inertia = inertia_of(parameters)
        slope = torque_free_by_inertia(inertia, np.asarray(np.linalg.inv(inertia), np.float64))
        done = at_rest(state.omega_body, SIZE - 3)
        away = (parameters - BALL) / _BALL_SD**2
        normal = np.zeros((batch, SIZE, SIZE))
        normal[:, INERTIA, INERTIA] = np.eye(5) / _BALL_SD**2
        gradient = np.concatenate([np.zeros((batch, 6)), -away], axis=1)
        cost = np.sum((parameters - BALL) * away, axis=1)
        for k, weight in enumerate(np.moveaxis(self.weight, 1, 0)):
            if k > 0:
                done = done.then(slope, float(self.times_s[k] - self.times_s[k - 1]))
            # A rate that a step throws far off turns by no number: it costs more than any other.
            finite = np.asarray(np.isfinite(done.turn).all(axis=(-1, -2)))
            turn = np.where(finite[:, None, None], done.turn, np.eye(3))
            transition = np.concatenate([np.swapaxes(turn, -1, -2), done.by_start], axis=-1)
            transition = np.where(finite[:, None, None], transition, 0.0)
            cost, normal[~finite] = np.where(finite, cost, np.inf), np.eye(SIZE)
            error = log_rotation(np.swapaxes(R @ turn, -1, -2) @ self.measured[:, k])
            # log(exp(-theta) exp(e)) = e - theta to first order in small e.
            weighted = np.swapaxes(transition, -1, -2) @ weight
            normal += weighted @ transition
            gradient += (weighted @ error[..., None])[..., 0]
            cost += (error[:, None] @ weight @ error[..., None])[:, 0, 0]
        return NormalEquations(normal, gradient, cost)

    def moved(self, state: RotationState, step: FloatArray) -> RotationState:
        return _moved(state, step)


@dataclass(frozen=True)
class RotationArc:
    """Rotations that pass through arcs of attitudes."""

    start: RotationState
    """(B,) at the first time."""
    covariance: FloatArray
    """(B, 11, 11) of its errors."""
    cost: FloatArray
    """(B,) weighted squared residual, prior included."""
    converged: BoolArray
    """(B,)"""


def fit_rotation_arc(
    times_s: FloatArray,
    R_world_body: FloatArray,
    noise: FloatArray,
    omega_body: FloatArray,
    parameters: FloatArray,
    max_steps: int = 25,
) -> RotationArc:
    """Least squares over arcs of attitudes alone.

    Args:
        times_s: (n,) increasing.
        R_world_body: (B, n, 3, 3) measured attitudes.
        noise: (B, n, 3, 3) their covariances, body axes, rad^2.
        omega_body: (B, 3) rates at the first time to start from.
        parameters: (B, 5) inertia to start from.
        max_steps: of the iteration.
    """
    weight = np.asarray(np.linalg.inv(noise), np.float64)
    start = RotationState(R_world_body[:, 0], omega_body, positive(parameters))
    descent = Descent(max_steps, settled_sd=1e-3, damping=(1e-3, 1e-9, 1e9))
    found = minimise(_FreeProblem(times_s, R_world_body, weight), start, descent)
    covariance = np.asarray(np.linalg.inv(found.equations.normal), np.float64)
    return RotationArc(found.state, covariance, found.equations.cost, found.converged)
