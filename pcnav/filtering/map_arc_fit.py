"""Maximum a-posteriori fit of one trajectory to the measurements of a whole arc.

A filter linearises each measurement once, about its estimate at that time. At the start the
estimate is poor and measurements of millimetres make second-order terms larger than their noise,
which leaves false confidence. Fitting the initial state to the whole arc at once has no such
memory.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Generic, Protocol, Self, TypeVar

import numpy as np
from scipy.linalg import cho_factor, cho_solve, cholesky, solve_triangular
from scipy.optimize import least_squares

from pcnav.core.arrays import AnyDataclass, BoolArray, FloatArray, IntArray, picked
from pcnav.filtering.arc_curvature import LinearisedArc, bend_of
from pcnav.filtering.error_state import (
    ManifoldState,
    Measurement,
    MotionModel,
    Seen,
    retraction_jacobian,
)

_FEW_STEPS = 5
_SMALL_STEP = 0.1
"""A step of so many standard deviations, in the mean over the state, is the last."""
_MAX_STEPS = 40
"""Gauss-Newton converges in about ten; more means that the arc is not what it was taken for."""


class ArcState(ManifoldState, AnyDataclass, Protocol):
    """A state that arcs are fitted with; with a leading axis, the states at the times of one."""

    def local(self, other: Self, /) -> FloatArray:
        """(n,) the error that takes this state to another: the inverse of `retract`."""

    def thinness(self) -> tuple[FloatArray, FloatArray]:
        """Residuals (m,) that keep the fit among states that can be, and their derivative (m, n)
        by the error. They guide the fit and are no measurements."""

    @property
    def loose(self) -> slice:
        """Components that may be so uncertain that they bend the others, see `arc_curvature`."""


S = TypeVar("S", bound=ArcState)


@dataclass(frozen=True)
class Path(Generic[S]):
    """States at n times of an arc."""

    states: S
    """Over a leading axis."""
    by_first: FloatArray
    """(n, k, k) derivative of their errors by that of the first."""


class ArcModel(MotionModel[S], Protocol[S]):
    """How a state moves along an arc."""

    def along(self, state: S, times_s: FloatArray, /) -> Path[S]:
        """From a state at the first of times (n,) to all of them. `ValueError` if not finite."""


@dataclass(frozen=True)
class TimedMeasurements(Generic[S]):
    """What was measured at one time."""

    time_s: float
    measurements: tuple[Measurement[S], ...]


@dataclass(frozen=True)
class Whitened:
    """Measurements of unit variance in f frames of an arc, at most m components in each."""

    frames: IntArray
    """(f,) which of the states they are of."""
    residual: FloatArray
    """(f, m) measured minus predicted."""
    by_state: FloatArray
    """(f, m, k) derivative of the prediction by the error of that state."""
    is_measured: BoolArray
    """(f, m) which components there are."""


class ArcMeasurements(Protocol[Seen]):
    """All measurements of an arc."""

    def about(self, states: Seen, /) -> list[Whitened]:
        """Compared with the states at its times, over a leading axis."""


class OneByOne(Generic[S]):
    """Measurements of whatever kinds, each asked for itself."""

    def __init__(self, arc: Sequence[TimedMeasurements[S]]) -> None:
        self._all = [(k, m, _root(m.covariance)) for k, t in enumerate(arc) for m in t.measurements]

    def about(self, states: S) -> list[Whitened]:
        """See `ArcMeasurements.about`."""
        found, at, state = [], -1, None
        for k, measurement, root in self._all:
            if k != at or state is None:
                state, at = picked(states, k), k
            residual, by_state = measurement.residual(state), measurement.jacobian(state)
            if root is not None:
                both = np.column_stack([residual, by_state])
                whitened = solve_triangular(root, both, lower=True)
                residual, by_state = whitened[:, 0], whitened[:, 1:]
            all_of_it = np.ones((1, len(residual)), np.bool_)
            found.append(Whitened(np.array([k]), residual[None], by_state[None], all_of_it))
        return found


@dataclass(frozen=True)
class ArcFit(Generic[S]):
    """The trajectory that fits an arc best."""

    path: S
    """The states at all times of the arc, over a leading axis."""
    covariance: FloatArray
    """(n, n) of the last state's error."""
    chi_square: float
    """Of measurements and prior together."""
    dof: int
    """Number of measured components."""
    converged: bool
    first_error: FloatArray
    """(n,) that takes the guess to the fitted first state."""
    excess: float = 0.0
    """What linearisation leaves out of the normalised error squared, see `Bend`; the covariance has
    it."""

    @property
    def first(self) -> S:
        """The state at the first time."""
        return picked(self.path, 0)

    @property
    def last(self) -> S:
        """The state at the last time."""
        return picked(self.path, -1)


class ArcError(ValueError):
    """An arc that no trajectory can be fitted to: the numbers broke down."""


def fit_arc(
    model: ArcModel[S],
    guess: S,
    prior_covariance: FloatArray,
    arc: Sequence[TimedMeasurements[S]],
    start: S | None = None,
    gathered: ArcMeasurements[S] | None = None,
    *,
    bends: bool = True,
) -> ArcFit[S]:
    """Fit the state at the arc's first time; the guess is also the mean of the prior.

    Process noise is left out: over the short arcs this is for it is far below the measurements'.

    Args:
        model: how the state moves.
        guess: state at the first time.
        prior_covariance: (n, n) of the guess; large where nothing is known.
        arc: in order of time.
        start: state at the first time to iterate from, as an earlier fit found it; the guess
            if None.
        gathered: the measurements of the arc as they are compared; None for one by one.
        bends: whether the covariance counts the second-order part, see `arc_curvature`.

    Raises `ArcError` when a covariance is not positive definite or an iterate is not finite.
    """
    try:
        measured = gathered or OneByOne(arc)
        trajectory = _Trajectory(model, guess, prior_covariance, arc, measured, bends=bends)
        begin = np.zeros(len(prior_covariance)) if start is None else guess.local(start)
        settled = None if start is None else _settled(trajectory, begin)
        if settled is not None:
            return trajectory.fit(settled, converged=True)
        solution = least_squares(
            trajectory.residual,
            begin,
            jac=trajectory.jacobian,
            # A trust region that starts at one standard deviation of the prior: a first step a
            # hundred times that, as other methods allow, may try rates that take ages to propagate.
            method="trf",
            x_scale=np.sqrt(np.diag(prior_covariance)),
            max_nfev=_MAX_STEPS,
        )
        return trajectory.fit(solution.x, converged=bool(solution.success))
    except (np.linalg.LinAlgError, ValueError, OverflowError) as error:
        raise ArcError(f"no trajectory through {len(arc)} frames: {error}") from error


def _settled(trajectory: "_Trajectory[S]", error: FloatArray) -> FloatArray | None:
    """Where a few plain Gauss-Newton steps settle from a good start; None if they do not."""
    cost = np.inf
    for _ in range(_FEW_STEPS):
        residual, jacobian = trajectory.residual(error), trajectory.jacobian(error)
        if not residual @ residual < cost:
            return None
        cost = float(residual @ residual)
        step = -cho_solve(cho_factor(jacobian.T @ jacobian), jacobian.T @ residual)
        error = error + step
        # What is left of the step squares with every further one.
        if np.sum((jacobian @ step) ** 2) < _SMALL_STEP**2 * len(error):
            return error
    return None


class _Trajectory(Generic[S]):
    """The residuals of an arc as a function of the error of its first state."""

    def __init__(
        self,
        model: ArcModel[S],
        guess: S,
        prior_covariance: FloatArray,
        arc: Sequence[TimedMeasurements[S]],
        measured: ArcMeasurements[S],
        *,
        bends: bool,
    ) -> None:
        self._model, self._guess, self._measured = model, guess, measured
        self._times_s, self._bends = np.array([timed.time_s for timed in arc]), bends
        self._prior_root = cholesky(np.linalg.inv(prior_covariance), lower=False)
        size = len(prior_covariance)
        self._bound_rows = slice(size, size + len(guess.thinness()[0]))
        # Residual and Jacobian come from one pass along the arc; scipy asks for them in turn.
        self._last: tuple[bytes, _Pass[S]] | None = None

    def residual(self, error: FloatArray) -> FloatArray:
        """Whitened residuals of prior and measurements."""
        return self._evaluated(error).residual

    def jacobian(self, error: FloatArray) -> FloatArray:
        """Their derivative by the error."""
        return self._evaluated(error).jacobian

    def fit(self, error: FloatArray, *, converged: bool) -> ArcFit[S]:
        """The fit that an error stands for."""
        at = self._evaluated(error)
        size = len(error)
        at_fit = self._linearised(at)
        J = at_fit.jacobian
        by_error = cho_solve(cho_factor(J.T @ J), np.eye(size))
        admissible = self._guess.admissible(error, by_error)
        moved = at if np.array_equal(admissible, error) else self._evaluated(admissible)
        # A covariance of the error at the guess: carry it to the last state.
        covariance, excess = moved.sensitivity @ by_error @ moved.sensitivity.T, 0.0
        if self._bends:
            bend = bend_of(at_fit, error, by_error, self._guess.loose, self._beside)
            covariance, excess = covariance + bend.second_moment, bend.excess
        return ArcFit(
            path=moved.states,
            covariance=0.5 * (covariance + covariance.T),
            chi_square=float(at.residual @ at.residual),
            dof=len(J) - size,
            converged=converged,
            first_error=error,
            excess=excess,
        )

    def _beside(self, error: FloatArray) -> LinearisedArc:
        """Raises `ValueError` where no state can be."""
        if self._guess.retract(error).thinness()[0].any():
            raise ValueError("no body")
        return self._linearised(self._evaluate(error))

    def _linearised(self, at: "_Pass[S]") -> LinearisedArc:
        # That the inertia is a body's guides the fit; as a measurement it would claim too much.
        measured = np.delete(at.jacobian, self._bound_rows, axis=0)
        return LinearisedArc(measured, at.sensitivity)

    def _evaluated(self, error: FloatArray) -> "_Pass[S]":
        key = error.tobytes()
        if self._last is None or self._last[0] != key:
            self._last = (key, self._evaluate(error))
        return self._last[1]

    def _evaluate(self, error: FloatArray) -> "_Pass[S]":
        state = self._guess.retract(error)
        by_error = retraction_jacobian(self._guess, error)
        bound, by_state = state.thinness()
        residuals = [self._prior_root @ error, bound]
        jacobians = [self._prior_root, by_state @ by_error]
        path = self._model.along(state, self._times_s)
        for seen in self._measured.about(path.states):
            residuals.append(seen.residual[seen.is_measured])
            by_first = seen.by_state @ path.by_first[seen.frames]
            jacobians.append(-by_first[seen.is_measured] @ by_error)
        residual, jacobian = np.concatenate(residuals), np.vstack(jacobians)
        return _Pass(path.states, path.by_first[-1] @ by_error, residual, jacobian)


@dataclass(frozen=True)
class _Pass(Generic[S]):
    """An arc gone through from one first state."""

    states: S
    """Over a leading axis."""
    sensitivity: FloatArray
    """(n, n) derivative of the last state's error by the error at the guess."""
    residual: FloatArray
    jacobian: FloatArray


def _root(covariance: FloatArray) -> FloatArray | None:
    """Lower Cholesky factor, None for the identity: whitened already."""
    if np.array_equal(covariance, np.eye(len(covariance))):
        return None
    return np.asarray(cholesky(covariance, lower=True))
