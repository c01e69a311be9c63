"""Maximum a-posteriori fit of free rotations to the attitudes of an arc, many arcs at once.

What `map_arc_fit` does for the start of a depth track, for attitudes alone: the filter
linearises each attitude once, about an inertia that is hardly known yet, and what it drops then it
takes for knowledge ever after. The fit has no such memory. `rotation_arc` is the
same fit without a prior on the rate and with one of its own on the inertia.
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_triangular

from pcnav.core.arrays import BoolArray, FloatArray
from pcnav.core.spatial import left_jacobian, log_rotation
from pcnav.dynamics.inertia_parameters import INERTIA_UNITS, inertia_of
from pcnav.estimators.attitude_inertia.rotation_arc import positive
from pcnav.estimators.attitude_inertia.rotation_model import (
    INERTIA,
    SIZE,
    THETA,
    RotationState,
    TorqueFreeModel,
)

_MAX_STEPS = 30
_SETTLED = 0.02
"""Change of every component over its standard deviation: what is left is far below its noise."""
_THIN_SHARE, _THIN_SD = 0.01, 0.005
"""Shares of the second moments below a hundredth are lacking, by standard deviations of half that;
as in `pcnav.dynamics.inertia_parameters.thinness`."""
_FIRST_DAMPING, _MIN_DAMPING, _MAX_DAMPING = 1e-4, 1e-12, 1e10


@dataclass(frozen=True)
class RotationPrior:
    """What is believed of the states at the first time of an arc."""

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
    """(n, 3, 3) of each, body axes, rad^2; or (3n, 3n) of all, where their errors belong together.
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
class _Point:
    """The normal equations about a start."""

    measured: FloatArray
    """(B, 11, 11) of prior and attitudes: the information."""
    normal: FloatArray
    """(B, 11, 11) with what keeps the inertia a body's. It guides the fit; as a measurement it
    would claim too much."""
    gradient: FloatArray
    """(B, 11)"""
    cost: FloatArray
    """(B,)"""

    def chosen(self, which: BoolArray, other: "_Point") -> "_Point":
        """This where a run is marked, the other where not."""
        return _Point(
            np.where(which[:, None, None], self.measured, other.measured),
            np.where(which[:, None, None], self.normal, other.normal),
            np.where(which[:, None], self.gradient, other.gradient),
            np.where(which, self.cost, other.cost),
        )


def fit_rotations(
    model: TorqueFreeModel, prior: RotationPrior, arc: AttitudeArc, start: RotationState
) -> RotationFit:
    """Least squares over prior and attitudes by Levenberg and Marquardt.

    ``start`` (B,) is where the iteration begins. Process noise is left out: over the arcs this is
    for it is far below that of the attitudes.
    """
    state, here = start, _normal_equations(model, prior, arc, start)
    damping = np.full(len(here.cost), _FIRST_DAMPING)
    converged = np.zeros(len(damping), dtype=np.bool_)
    for _ in range(_MAX_STEPS):
        damped = here.normal + damping[:, None, None] * (here.normal * np.eye(SIZE))
        step = np.asarray(np.linalg.solve(damped, here.gradient[..., None])[..., 0], np.float64)
        step[converged] = 0.0
        tried = _moved(state, step)
        there = _normal_equations(model, prior, arc, tried)
        better = (there.cost <= here.cost * (1.0 + 1e-12)) & ~converged
        sd = 1.0 / np.sqrt(np.diagonal(here.normal, axis1=-2, axis2=-1))
        settled = np.all(np.abs(step) < _SETTLED * sd, axis=-1)
        state, here = _chosen(better, tried, state), there.chosen(better, here)
        damping = np.clip(damping * np.where(better, 0.1, 10.0), _MIN_DAMPING, _MAX_DAMPING)
        converged |= settled & better
        if np.all(converged | (damping >= _MAX_DAMPING)):
            break
    end, transition = _carried(model, arc.times_s, state)
    covariance = transition @ np.linalg.inv(here.measured) @ np.swapaxes(transition, -1, -2)
    covariance = 0.5 * (covariance + np.swapaxes(covariance, -1, -2))
    return RotationFit(state, end, covariance, here.cost, converged)


def _normal_equations(
    model: TorqueFreeModel, prior: RotationPrior, arc: AttitudeArc, start: RotationState
) -> _Point:
    weight = np.linalg.inv(prior.covariance)
    # By a small error of the start: log(exp(a) exp(da)) = a + J_r(a)^-1 da.
    away = prior.mean.local(start)
    by_error = np.broadcast_to(np.eye(SIZE), (len(away), SIZE, SIZE)).copy()
    by_error[:, THETA, THETA] = np.linalg.inv(left_jacobian(-away[:, THETA]))
    weighted = np.swapaxes(by_error, -1, -2) @ weight
    normal = weighted @ by_error
    gradient = -(weighted @ away[..., None])[..., 0]
    cost = np.einsum("bi,bij,bj->b", away, np.broadcast_to(weight, normal.shape), away)
    rows = arc.whitened(_linearised(model, arc, start))
    H, error = rows[..., :SIZE], rows[..., SIZE]
    normal = normal + np.einsum("nbij,nbik->bjk", H, H)
    gradient = gradient + np.einsum("nbij,nbi->bj", H, error)
    cost = cost + np.einsum("nbi,nbi->b", error, error)
    lack, slopes = _thinness(start.parameters)
    guided = normal.copy()
    guided[:, INERTIA, INERTIA] += np.swapaxes(slopes, -1, -2) @ slopes
    gradient[:, INERTIA] -= (np.swapaxes(slopes, -1, -2) @ lack[..., None])[..., 0]
    return _Point(normal, guided, gradient, cost + np.sum(lack**2, axis=-1))


def _linearised(model: TorqueFreeModel, arc: AttitudeArc, start: RotationState) -> FloatArray:
    """(n, B, 3, 12) derivative of the attitudes by the errors of the start; their residuals."""
    state, transition = start, np.broadcast_to(np.eye(SIZE), (len(start.omega_body), SIZE, SIZE))
    rows = []
    for k, time_s in enumerate(arc.times_s.tolist()):
        if k > 0:
            before = float(arc.times_s[k - 1])
            state, step, _ = model.propagate(state, before, time_s - before)
            transition = step @ transition
        error = log_rotation(np.swapaxes(state.R_world_body, -1, -2) @ arc.R_world_body[k])
        H = np.linalg.inv(left_jacobian(error)) @ transition[:, THETA]
        rows.append(np.concatenate([H, error[..., None]], axis=-1))
    return np.stack(rows)


def _thinness(parameters: FloatArray) -> tuple[FloatArray, FloatArray]:
    """How far inertias (B, 5) are from those of bodies: residuals (B, 3), derivative (B, 3, 5).

    The shares of the principal axes in the second moments are ``1 - 2/3`` of the moments of N.
    """
    moments, axes = np.linalg.eigh(inertia_of(parameters))
    lack = np.maximum(_THIN_SHARE - 1.0 + moments / 1.5, 0.0) / _THIN_SD
    slopes = np.einsum("bik,pij,bjk->bkp", axes, INERTIA_UNITS, axes) / (1.5 * _THIN_SD)
    return lack, slopes * (lack > 0.0)[..., None]


def _carried(
    model: TorqueFreeModel, times_s: FloatArray, start: RotationState
) -> tuple[RotationState, FloatArray]:
    """The states at the last time and the transition (B, 11, 11) to there."""
    state, transition = start, np.eye(SIZE)
    for before, time_s in zip(times_s[:-1].tolist(), times_s[1:].tolist(), strict=True):
        state, step, _ = model.propagate(state, before, time_s - before)
        transition = step @ transition
    return state, np.broadcast_to(transition, (len(start.omega_body), SIZE, SIZE))


def _moved(state: RotationState, step: FloatArray) -> RotationState:
    """Moved by errors (B, 11), as far as the principal moments stay positive."""
    allowed = step.copy()
    allowed[:, INERTIA] = positive(state.parameters + step[:, INERTIA]) - state.parameters
    return state.retract(allowed)


def _chosen(which: BoolArray, new: RotationState, old: RotationState) -> RotationState:
    return RotationState(
        np.where(which[:, None, None], new.R_world_body, old.R_world_body),
        np.where(which[:, None], new.omega_body, old.omega_body),
        np.where(which[:, None], new.parameters, old.parameters),
    )
