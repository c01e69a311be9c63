"""The one filter engine: an iterated error-state Kalman filter on filterpy's linear algebra.

An estimator supplies a state that can be moved by an error (`ManifoldState`), a `MotionModel` that
propagates it, and `Measurement` values. The engine owns gating, iteration, Joseph form, error
injection and the reset Jacobian. filterpy keeps the error at zero mean between steps; the engine
injects what an update finds into the state and resets. `pcnav.filtering.batched_filter` has the
same equations for many states at once, and is tested to give the same numbers.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Generic, Protocol, Self, TypeVar, runtime_checkable

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter
from scipy.linalg import block_diag

from pcnav.core import chi_square
from pcnav.core.arrays import FloatArray

SETTLED_SD = 1e-3
"""An iteration that changes every component by less than this share of its deviation is the last:
there is nothing more to gain."""


class ManifoldState(Protocol):
    """A state whose errors live in a vector space of size n; or B of them, over a leading axis."""

    def retract(self, error: FloatArray, /) -> Self:
        """The state moved by an error (..., n)."""

    @property
    def curved(self) -> slice:
        """Components outside of which the retraction's Jacobian is the identity."""

    def retraction_block(self, error: FloatArray, /) -> FloatArray:
        """(..., k, k) within `curved`: how a small change of ``error`` moves the retracted state,
        in its own error."""

    def admissible(self, error: FloatArray, covariance: FloatArray, /) -> FloatArray:
        """The error (..., n) that leads to a state that can be, nearest to the given one.

        Nearest in the metric of the covariance (..., n, n); the given one where it is such.
        """


S = TypeVar("S", bound=ManifoldState)
Seen = TypeVar("Seen", contravariant=True)


def retraction_jacobian(state: ManifoldState, error: FloatArray) -> FloatArray:
    """(n, n) how a small change of ``error`` (n,) moves the retracted state, in its own error."""
    jacobian = np.eye(len(error))
    jacobian[state.curved, state.curved] = state.retraction_block(error)
    return jacobian


class Measurement(Protocol[Seen]):
    """A value that says how far a state is from what was measured."""

    @property
    def covariance(self) -> FloatArray:
        """(m, m) covariance of the measurement error, in the residual's units."""

    def residual(self, state: Seen, /) -> FloatArray:
        """(m,) measured minus predicted."""

    def jacobian(self, state: Seen, /) -> FloatArray:
        """(m, n) derivative of the prediction (minus that of the residual) by the state's error."""


@runtime_checkable
class ErrsBeside(Protocol):
    """A measurement that errs by more than it is weighed by."""

    @property
    def considered(self) -> FloatArray | None:
        """(m, k) derivative of the value by further errors of unit variance; None for none."""


class MotionModel(Protocol[S]):
    """How a state, or each of a batch, moves in time."""

    def propagate(
        self, state: S, time_s: float, step_s: float, /
    ) -> tuple[S, FloatArray, FloatArray]:
        """State after ``step_s``, transition matrix of its error and process noise, (..., n, n)."""


@dataclass(frozen=True)
class UpdateResult:
    """What an update did."""

    accepted: tuple[bool, ...]
    """Per measurement, whether it passed the gate."""
    nis: tuple[float, ...]
    """Per measurement, innovation squared over its covariance at the prediction."""
    dof: tuple[int, ...]
    """Per measurement, how many components it has."""
    joint_nis: float
    """Of all accepted measurements together; nan when there is none."""
    joint_dof: int
    iterations: int
    converged: bool
    gates: tuple[float, ...] = ()
    """Per measurement, what the ``nis`` of an accepted one stays below."""


@dataclass(frozen=True)
class Snapshot(Generic[S]):
    """A filter's state and covariance at one moment."""

    state: S
    covariance: FloatArray


class ErrorStateFilter(Generic[S]):
    """State and covariance of an estimator, moved by `predict` and `update`."""

    def __init__(
        self,
        state: S,
        covariance: FloatArray,
        *,
        gate_probability: float = 0.9999,
        max_iterations: int = 5,
    ) -> None:
        self.state = state
        self._gate_probability = gate_probability
        self._max_iterations = max_iterations
        self._kalman = ExtendedKalmanFilter(dim_x=len(covariance), dim_z=1)
        self._kalman.P = covariance.copy()

    @property
    def covariance(self) -> FloatArray:
        """(n, n) covariance of the state's error."""
        return np.asarray(self._kalman.P, dtype=np.float64)

    @property
    def transition(self) -> FloatArray:
        """(n, n) by which the last `predict` moved an error of the state."""
        return np.asarray(self._kalman.F, dtype=np.float64)

    def snapshot(self) -> Snapshot[S]:
        """State and covariance as they are now, for `restore`."""
        return Snapshot(self.state, self.covariance.copy())

    def restore(self, snapshot: Snapshot[S]) -> None:
        """Go back to a snapshot."""
        self.state = snapshot.state
        self._kalman.P = snapshot.covariance.copy()

    def predict(self, model: MotionModel[S], time_s: float, step_s: float) -> None:
        """Move state and covariance forward by ``step_s`` from ``time_s``."""
        self.state, self._kalman.F, self._kalman.Q = model.propagate(self.state, time_s, step_s)
        self._kalman.x = np.zeros((len(self._kalman.Q), 1))
        self._kalman.predict()
        self._kalman.P = symmetric(self._kalman.P)

    def innovation(self, measurement: Measurement[S]) -> tuple[float, int]:
        """Normalised innovation squared of a measurement at the present state, and its size.

        What is considered beside the filter, see `ErrsBeside`, counts in it, though in no gain.
        """
        residual = measurement.residual(self.state)
        H = measurement.jacobian(self.state)
        S_matrix = H @ self.covariance @ H.T + measurement.covariance
        if isinstance(measurement, ErrsBeside) and measurement.considered is not None:
            S_matrix = S_matrix + measurement.considered @ measurement.considered.T
        return float(residual @ np.linalg.solve(S_matrix, residual)), len(residual)

    def would_accept(self, measurement: Measurement[S]) -> bool:
        """Whether a measurement passes the gate at the present state."""
        squared, size = self.innovation(measurement)
        return squared <= innovation_gate(self._gate_probability, size)

    def update(
        self,
        measurements: Sequence[Measurement[S]],
        shared: Sequence[FloatArray] = (),
        max_iterations: int | None = None,
    ) -> UpdateResult:
        """Gate, then one iterated update with all measurements that pass.

        Their errors are independent but for those of unit variance that enter each by a matrix
        (m, k) of ``shared``, and are part of its covariance already. ``max_iterations`` is that of
        this update; None takes the filter's own.

        Gauss-Newton on the posterior: every pass linearises about the last iterate ``x (+) d`` and
        asks the Kalman update for the whole error from the prediction, with the innovation
        ``e(d) + H d`` (Bell and Cathey 1993). ``H`` includes how the error of the iterate depends
        on d, and the covariance is carried to the new state by the same Jacobian (the reset).
        """
        tests = [self.innovation(measurement) for measurement in measurements]
        gates = tuple(innovation_gate(self._gate_probability, size) for _, size in tests)
        accepted = tuple(nis <= gate for (nis, _), gate in zip(tests, gates, strict=True))
        used = [m for m, passed in zip(measurements, accepted, strict=True) if passed]
        nis, dof = tuple(t[0] for t in tests), tuple(t[1] for t in tests)
        if not used:
            return UpdateResult(accepted, nis, dof, float("nan"), 0, 0, True, gates)
        common = [c for c, passed in zip(shared, accepted, strict=True) if passed] if shared else []
        alone = len(measurements) == 1
        joint = used[0] if alone else Stack(used, common)
        joint_nis, joint_dof = tests[0] if alone else self.innovation(joint)
        limit = max_iterations or self._max_iterations
        prior, prior_covariance = self.state, self.covariance.copy()
        error = np.zeros(len(prior_covariance))
        converged, iteration = False, 0
        while iteration < limit and not converged:
            iteration += 1
            iterate = prior.retract(error)
            H = joint.jacobian(iterate) @ retraction_jacobian(prior, error)
            step = self._kalman_step(
                joint.residual(iterate) + H @ error, H, joint.covariance, prior_covariance
            )
            change, error = step - error, step
            sd = np.sqrt(np.diag(self.covariance))
            converged = bool(np.all(np.abs(change) <= SETTLED_SD * sd))
        # The covariance stays: a bound tells less than it seems, the truth may be anywhere inside.
        error = prior.admissible(error, self.covariance)
        reset = retraction_jacobian(prior, error)
        self.state = prior.retract(error)
        self._kalman.P = symmetric(reset @ self.covariance @ reset.T)
        return UpdateResult(
            *(accepted, nis, dof, joint_nis, joint_dof, iteration, converged),
            gates=gates,
        )

    def _kalman_step(
        self, innovation: FloatArray, H: FloatArray, R: FloatArray, prior_covariance: FloatArray
    ) -> FloatArray:
        """The error (n,) that filterpy's update finds from the prior; leaves the posterior in P."""
        self._kalman.x = np.zeros((len(prior_covariance), 1))
        self._kalman.P = prior_covariance
        self._kalman.update(
            innovation[:, None],
            HJacobian=lambda _: H,
            Hx=lambda _: np.zeros((len(innovation), 1)),
            R=R,
        )
        return np.asarray(self._kalman.x, dtype=np.float64).ravel()


@lru_cache(maxsize=64)
def innovation_gate(probability: float, dof: int) -> float:
    """Normalised innovation squared that a true measurement stays below with a probability."""
    return float(chi_square.quantile(probability, dof))


class Stack(Generic[S]):
    """Several measurements as one, independent but for errors that they share."""

    def __init__(self, parts: Sequence[Measurement[S]], shared: Sequence[FloatArray] = ()) -> None:
        self._parts = parts
        self.covariance: FloatArray = np.asarray(block_diag(*(part.covariance for part in parts)))
        if shared:
            across = np.vstack(shared)
            own = block_diag(*(part @ part.T for part in shared))
            self.covariance = self.covariance + across @ across.T - own

    def residual(self, state: S) -> FloatArray:
        return np.concatenate([part.residual(state) for part in self._parts])

    def jacobian(self, state: S) -> FloatArray:
        return np.vstack([part.jacobian(state) for part in self._parts])


def symmetric(matrix: FloatArray) -> FloatArray:
    """(..., n, n) without what rounding does to the symmetry."""
    return np.asarray(0.5 * (matrix + np.swapaxes(matrix, -1, -2)), dtype=np.float64)
