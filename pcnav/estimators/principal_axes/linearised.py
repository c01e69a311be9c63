"""Smoothing about a trajectory that is roughly known: the engine on deviations from it.

A filter that starts from nothing linearises where its first frames happen to put it. Where every
frame tells its pose, deviations from the poses as they are seen are small from the first frame on,
however wide the prior and however strong a disturbance. The trajectory need not obey the dynamics:
by how much it does not is carried along, and charged to the process noise.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from pcnav.core.arrays import FloatArray
from pcnav.estimators.principal_axes.arc_fit import bounded_steps
from pcnav.estimators.principal_axes.feature_measurements import FeatureView
from pcnav.estimators.principal_axes.feature_states import (
    PA_RATIOS,
    PA_THETA,
    PrincipalAxesModel,
    PrincipalState,
)
from pcnav.filtering.error_state import (
    ErrorStateFilter,
    UpdateResult,
    retraction_jacobian,
    symmetric,
)

_MAX_PASSES = 15
_SETTLED, _USABLE = 0.01, 0.3
"""Squared last step over covariance and degrees of freedom: to stop at, and to be of use."""
_MAX_TURN_RAD, _MAX_CHANGE, _MAX_RATIO = 0.5, 0.3, 0.99
"""Of the axes and of a ratio in one step, and the largest ratio that one leads to: beyond it are
moments that are equal, a turn of whose axes is none."""
_TAKE_ALL = 1.0 - 1e-15


@dataclass(frozen=True)
class Deviation:
    """An error of the trajectory, as a state of its own."""

    error: FloatArray
    """(n,)"""

    def retract(self, error: FloatArray) -> "Deviation":
        """Errors add: to first order about the trajectory."""
        return Deviation(self.error + error)

    @property
    def curved(self) -> slice:
        """See `ManifoldState`: nothing."""
        return slice(0, 0)

    def retraction_block(self, error: FloatArray) -> FloatArray:
        """See `ManifoldState`."""
        return np.empty((0, 0))

    def admissible(self, error: FloatArray, covariance: FloatArray) -> FloatArray:
        """Any; the trajectory's own state sees to it in the end."""
        return error


@dataclass(frozen=True)
class Leg:
    """A part of the trajectory, and how deviations move along it: a `MotionModel`."""

    transition: FloatArray
    """(n, n)"""
    noise: FloatArray
    """(n, n)"""
    defect: FloatArray
    """(n,) from the trajectory's next state to where the dynamics lead from this one."""

    def propagate(
        self, state: Deviation, time_s: float, step_s: float
    ) -> tuple[Deviation, FloatArray, FloatArray]:
        """See `MotionModel.propagate`; whatever the times."""
        return Deviation(self.transition @ state.error + self.defect), self.transition, self.noise


@dataclass(frozen=True)
class _LinearMeasurement:
    offset: FloatArray
    H: FloatArray
    covariance: FloatArray

    def residual(self, state: Deviation) -> FloatArray:
        return np.asarray(self.offset - self.H @ state.error)

    def jacobian(self, state: Deviation) -> FloatArray:
        return self.H


class Deviations(NamedTuple):
    """What all frames together say of the deviations from a trajectory."""

    errors: FloatArray
    """(k, n) of every state."""
    covariance: FloatArray
    """(n, n) of the last."""
    result: UpdateResult
    """Of the last frame."""


class Prior(NamedTuple):
    """What is known at the first time; without its state, that is whatever the frames say."""

    covariance: FloatArray
    """(n, n)"""
    state: PrincipalState | None = None

    def about(self, first: PrincipalState) -> tuple[FloatArray, FloatArray]:
        """(n,) and (n, n) the deviation of its state from another and its covariance there."""
        if self.state is None:
            return np.zeros(len(self.covariance)), self.covariance
        there = retraction_jacobian(self.state, self.state.local(first))
        return first.local(self.state), there @ self.covariance @ there.T


class Smoothed(NamedTuple):
    """The end of a trajectory that was smoothed until linearisation no longer mattered."""

    state: PrincipalState
    covariance: FloatArray
    """(n, n)"""
    result: UpdateResult
    """Of the last frame, about the trajectory that came of it."""
    is_settled: bool
    """Whether linearisation no longer mattered; else state and covariance are not to be used."""


@dataclass
class _Pass:
    """What the way back needs of a time."""

    predicted: FloatArray
    P: FloatArray
    by_residual: FloatArray
    """(n,) what the frame adds to the adjoint: ``H^T S^-1 (r - H e)``."""
    weighted: FloatArray | None = None
    """(n, m) ``H^T S^-1``, and H (m, n)."""
    H: FloatArray | None = None
    back: FloatArray = field(default_factory=lambda: np.empty((0, 0)))
    """(n, n) transition from the time before."""

    def take(self, H: FloatArray, residual: FloatArray, noise: FloatArray) -> None:
        """Keep what a frame measured (m,)."""
        weighted = np.asarray(np.linalg.solve(H @ self.P @ H.T + noise, H).T, np.float64)
        self.H, self.weighted = H, weighted
        self.by_residual = np.asarray(weighted @ (residual - H @ self.predicted))

    def carried(self, adjoint: FloatArray) -> FloatArray:
        """(n,) the adjoint of later times before this one's frame: ``(1 - K H)^T`` of it."""
        if self.weighted is None or self.H is None:
            return adjoint
        return np.asarray(adjoint - self.weighted @ (self.H @ (self.P @ adjoint)))


def smoothed(
    trajectory: Sequence[PrincipalState],
    times_s: Sequence[float],
    views: Sequence[FeatureView | None],
    model: PrincipalAxesModel,
    prior: Prior,
    gate_probability: float,
) -> Smoothed:
    """The last state by all views, with process noise along the way.

    The trajectory is moved by what all views say of it until that is little next to what they leave
    open (Bell 1994: least squares of Gauss and Newton on all states).
    """
    states, first = list(trajectory), views[0]
    views = [None, *views[1:]]
    for k in range(_MAX_PASSES):
        legs = _legs(states, times_s, model)
        # What is refused while the trajectory is rough may be what would mend it.
        gate = gate_probability if k > 0 else _TAKE_ALL
        known = prior.about(states[0])
        if first is not None:
            known = _with_view(known, first, states[0])
        found = deviations(states, legs, views, known, gate)
        covariance, last = found.covariance, found.errors[-1]
        step = float(last @ np.linalg.solve(covariance, last)) / len(covariance)
        errors = _step_share(states[-1], last) * found.errors
        if not np.isfinite(errors).all():
            raise np.linalg.LinAlgError("the deviations grew beyond numbers")
        reset = retraction_jacobian(states[-1], errors[-1])
        states = [state.retract(error) for state, error in zip(states, errors, strict=True)]
        if k > 0 and step < _SETTLED:
            break
    is_settled = step < _USABLE
    return Smoothed(states[-1], reset @ covariance @ reset.T, found.result, is_settled)


def _with_view(
    known: tuple[FloatArray, FloatArray], view: FeatureView, state: PrincipalState
) -> tuple[FloatArray, FloatArray]:
    """Deviation (n,) and covariance (n, n) with the first view, of a state that it is seen from.

    Before it nothing is known to less than metres, after it points are to a tenth of a millimetre:
    ten orders of magnitude in variance, at which the gain of a filter loses its digits to rounding.
    The sum of information, brought to a unit diagonal, does not.
    """
    mean, covariance = known
    residual, jacobian = view.at(state)
    H = jacobian.reshape(-1, len(mean))
    weighted = np.linalg.solve(view.covariance, jacobian).reshape(H.shape)
    information = np.linalg.inv(covariance) + weighted.T @ H
    scale = 1.0 / np.sqrt(np.diag(information))
    inverse = np.asarray(np.linalg.inv(information * np.outer(scale, scale)), np.float64)
    after = symmetric(inverse) * np.outer(scale, scale)
    return mean + after @ (weighted.T @ (residual.ravel() - H @ mean)), after


def _step_share(state: PrincipalState, error: FloatArray) -> float:
    """How much of a step (n,) is taken: no more than the coordinates of the inertia bear, and to
    ratios that a body can have. All states take the same, for it is one body."""
    turn, change = np.abs(error[PA_THETA]).max(), np.abs(error[PA_RATIOS])
    room = _MAX_RATIO - np.sign(error[PA_RATIOS]) * state.ratios
    shares = (
        _MAX_TURN_RAD / max(float(turn), 1e-12),
        _MAX_CHANGE / max(float(change.max()), 1e-12),
        float((np.maximum(room, 0.0) / np.maximum(change, 1e-12)).min()),
    )
    return min(1.0, *shares)


def _legs(
    states: Sequence[PrincipalState], times_s: Sequence[float], model: PrincipalAxesModel
) -> list[Leg]:
    """From every state to the next, by the dynamics."""
    legs = []
    for k in range(len(states) - 1):
        state, size = states[k], states[k].size
        whole, spread = np.eye(size), np.zeros((size, size))
        for time, step in bounded_steps(times_s[k], times_s[k + 1]):
            state, transition, noise = model.propagate(state, time, step)
            whole, spread = transition @ whole, transition @ spread @ transition.T + noise
        legs.append(Leg(whole, spread, states[k + 1].local(state)))
    return legs


def deviations(
    trajectory: Sequence[PrincipalState],
    legs: Sequence[Leg],
    views: Sequence[FeatureView | None],
    first: tuple[FloatArray, FloatArray],
    gate_probability: float,
) -> Deviations:
    """Those by all views: forward the filter, back Bryson and Frazier 1963.

    The way back in that form inverts no covariance: the points have no process noise, and after a
    wide prior theirs is nearly singular. ``legs[k]`` leads from the state of view k to that of
    view k + 1; None is a time without a view. ``first`` is the first state's deviation (n,) and its
    covariance (n, n).
    """
    mean, covariance = first
    size = len(covariance)
    kalman = ErrorStateFilter(
        Deviation(mean), covariance, gate_probability=gate_probability, max_iterations=1
    )
    passes, result = list[_Pass](), UpdateResult((), (), (), float("nan"), 0, 0, True)
    for k, (state, view) in enumerate(zip(trajectory, views, strict=True)):
        if k > 0:
            kalman.predict(legs[k - 1], 0.0, 0.0)
        passes.append(_Pass(kalman.state.error, kalman.covariance.copy(), np.zeros(size)))
        if k > 0:
            passes[-1].back = legs[k - 1].transition
        if view is None:
            continue
        residual, jacobian = view.at(state)
        rows = zip(residual, jacobian, strict=True)
        result = kalman.update([_LinearMeasurement(r, H, view.covariance) for r, H in rows])
        used = np.flatnonzero(result.accepted)
        passes[-1].take(
            jacobian[used].reshape(-1, size),
            residual[used].ravel(),
            np.asarray(np.kron(np.eye(len(used)), view.covariance), np.float64),
        )
    errors, adjoint = np.empty((len(passes), size)), np.zeros(size)
    for k in range(len(passes) - 1, -1, -1):
        each = passes[k]
        adjoint = each.by_residual + each.carried(adjoint)
        errors[k] = each.predicted + each.P @ adjoint
        if k > 0:
            adjoint = each.back.T @ adjoint
    return Deviations(errors, kalman.covariance, result)
