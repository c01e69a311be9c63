"""Maximum a-posteriori fit of one trajectory to the measurements of a whole arc.

A filter linearises each measurement once, about what it believes then. At the start that belief is
poor and measurements of millimetres make second-order terms larger than their noise, which leaves
false confidence behind. Fitting the initial state to the whole arc at once has no such memory.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve, cholesky, solve_triangular
from scipy.optimize import least_squares

from pcnav.arrays import FloatArray
from pcnav.estimation.error_state import Measurement, MotionModel
from pcnav.state import NavigationState

State = NavigationState

_MOST_STEPS = 40
"""Gauss-Newton converges in about ten; more means that the arc is not what it was taken for."""


@dataclass(frozen=True)
class TimedMeasurements:
    """What was measured at one time."""

    time_s: float
    measurements: tuple[Measurement[State], ...]


@dataclass(frozen=True)
class ArcFit:
    """The trajectory that fits an arc best."""

    states: tuple[State, ...]
    """At every time of the arc."""
    covariance: FloatArray
    """(n, n) of the last state's error."""
    initial_covariance: FloatArray
    """(n, n) of the first state's error."""
    chi_square: float
    """Of measurements and prior together."""
    dof: int
    """Number of measured components."""
    converged: bool


def fit_arc(
    model: MotionModel[State],
    guess: State,
    prior_covariance: FloatArray,
    arc: Sequence[TimedMeasurements],
    start: State | None = None,
) -> ArcFit:
    """Fit the state at the arc's first time; the guess is also the mean of the prior.

    Process noise is left out: over the short arcs this is for it is far below the measurements'.

    Args:
        model: how the state moves.
        guess: state at the first time.
        prior_covariance: (n, n) of the guess; large where nothing is known.
        arc: in order of time.
        start: state at the first time to iterate from, as an earlier fit found it; the guess
            if None.
    """
    size = len(prior_covariance)
    prior_root = cholesky(np.linalg.inv(prior_covariance), lower=False)
    roots = [[cholesky(m.covariance, lower=True) for m in timed.measurements] for timed in arc]

    def evaluate(error: FloatArray) -> tuple[list[State], FloatArray, FloatArray]:
        state = guess.retract(error)
        sensitivity = guess.retraction_jacobian(error)
        states, residuals, jacobians = [], [prior_root @ error], [prior_root]
        time_s = arc[0].time_s
        for timed, timed_roots in zip(arc, roots, strict=True):
            if timed.time_s != time_s:
                state, transition, _ = model.propagate(state, time_s, timed.time_s - time_s)
                sensitivity = transition @ sensitivity
                time_s = timed.time_s
            states.append(state)
            for measurement, root in zip(timed.measurements, timed_roots, strict=True):
                whitened = np.column_stack(
                    [measurement.residual(state), -measurement.jacobian(state) @ sensitivity]
                )
                whitened = solve_triangular(root, whitened, lower=True)
                residuals.append(whitened[:, 0])
                jacobians.append(whitened[:, 1:])
        return states, np.concatenate(residuals), np.vstack(jacobians)

    # Residual and Jacobian come from one pass along the arc; scipy asks for them one after another.
    last: dict[bytes, tuple[list[State], FloatArray, FloatArray]] = {}

    def cached(error: FloatArray) -> tuple[list[State], FloatArray, FloatArray]:
        key = error.tobytes()
        if key not in last:
            last.clear()
            last[key] = evaluate(error)
        return last[key]

    def residual_of(error: FloatArray) -> FloatArray:
        return cached(error)[1]

    def jacobian_of(error: FloatArray) -> FloatArray:
        return cached(error)[2]

    solution = least_squares(
        residual_of,
        np.zeros(size) if start is None else guess.local(start),
        jac=jacobian_of,
        # A trust region that starts at one standard deviation of the prior: a first step a hundred
        # times that, as other methods allow, may try rates that take ages to propagate.
        method="trf",
        x_scale=np.sqrt(np.diag(prior_covariance)),
        max_nfev=_MOST_STEPS,
    )
    states, residual, jacobian = evaluate(solution.x)
    initial = cho_solve(cho_factor(jacobian.T @ jacobian), np.eye(size))
    # So far a covariance of the error vector at the guess: carry it to the first state, then on.
    reset = guess.retraction_jacobian(solution.x)
    initial = reset @ initial @ reset.T
    carried, time_s = np.eye(size), arc[0].time_s
    for state, timed in zip(states[:-1], arc[1:], strict=True):
        _, transition, _ = model.propagate(state, time_s, timed.time_s - time_s)
        carried, time_s = transition @ carried, timed.time_s
    covariance = carried @ initial @ carried.T
    return ArcFit(
        states=tuple(states),
        covariance=0.5 * (covariance + covariance.T),
        initial_covariance=initial,
        chi_square=float(residual @ residual),
        dof=len(residual) - size,
        converged=bool(solution.success),
    )
