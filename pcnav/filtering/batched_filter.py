"""The filter engine on many states at once: the equations of `ErrorStateFilter` on batches.

A bank of hypotheses, and a Monte Carlo study of banks, run thousands of filters of one shape in
step. Here they are one array with a leading batch dimension B: same gate, same iterated update with
residuals taken anew at every iterate, same Joseph form, injection and reset. The tests hold both
paths to the same numbers.
"""

from collections.abc import Callable
from dataclasses import Field, dataclass
from typing import Any, ClassVar, Generic, Protocol, Self, TypeVar

import numpy as np
from scipy.linalg import block_diag

from pcnav.core.arrays import BoolArray, FloatArray, IntArray, picked
from pcnav.filtering.error_state import (
    SETTLED_SD,
    ManifoldState,
    MotionModel,
    innovation_gate,
    symmetric,
)


class BatchedStates(ManifoldState, Protocol):
    """B states as a dataclass of arrays over the leading dimension."""

    __dataclass_fields__: ClassVar[dict[str, Field[Any]]]


S = TypeVar("S", bound=BatchedStates)
Seen = TypeVar("Seen", contravariant=True)


class MeasurementSet(Protocol[Seen]):
    """m independent measurements of s components each, of a state or of every one of a batch."""

    @property
    def noise(self) -> FloatArray:
        """(m, s, s) covariance of each measurement's error, the same for the whole batch."""

    def residual(self, states: Seen, /) -> FloatArray:
        """(..., m, s) measured minus predicted."""

    def jacobian(self, states: Seen, /) -> FloatArray:
        """(..., m, s, n) derivative of the prediction by the states' errors."""


class BatchedMeasurements(MeasurementSet[Seen], Protocol[Seen]):
    """Such sets for B states that may be taken apart."""

    def take(self, index: IntArray, /) -> Self:
        """Those of the (b,) places of the batch."""


@dataclass(frozen=True)
class Member(Generic[Seen]):
    """One measurement of a set, as the engine for a single state takes it: gated by itself."""

    whole: MeasurementSet[Seen]
    place: int

    @property
    def covariance(self) -> FloatArray:
        """(s, s)"""
        return np.asarray(self.whole.noise[self.place])

    def residual(self, state: Seen) -> FloatArray:
        """(s,)"""
        return np.asarray(self.whole.residual(state)[self.place])

    def jacobian(self, state: Seen) -> FloatArray:
        """(s, n)"""
        return np.asarray(self.whole.jacobian(state)[self.place])


@dataclass(frozen=True)
class Together(Generic[Seen]):
    """All measurements of a set as one of a single state."""

    whole: MeasurementSet[Seen]

    @property
    def covariance(self) -> FloatArray:
        """(ms, ms)"""
        return np.asarray(block_diag(*self.whole.noise))

    def residual(self, state: Seen) -> FloatArray:
        """(ms,)"""
        return self.whole.residual(state).ravel()

    def jacobian(self, state: Seen) -> FloatArray:
        """(ms, n)"""
        jacobian = self.whole.jacobian(state)
        return jacobian.reshape(-1, jacobian.shape[-1])


@dataclass(frozen=True)
class BatchedUpdate:
    """What an update did to each of B states."""

    accepted: BoolArray
    """(B, m) whether each measurement was used."""
    nis: FloatArray
    """(B, m) innovation squared over its covariance at the prediction."""
    joint_nis: FloatArray
    """(B,) of all accepted measurements together."""
    joint_dof: IntArray
    """(B,) how many components they have."""
    log_determinant: FloatArray
    """(B,) of their innovation covariance at the prediction."""
    noise_squares: FloatArray
    """(B,) their innovation squared over the measurement noise alone (Segal 2011 (12))."""
    iterations: IntArray
    """(B,)"""
    converged: BoolArray
    """(B,)"""
    gate: float
    """What the ``nis`` of a measurement stays below that a state would accept by itself."""


@dataclass(frozen=True)
class _Pass:
    """A linearisation of b states: innovation covariance and what the gain is made of."""

    H: FloatArray
    """(b, ms, n)"""
    HP: FloatArray
    S: FloatArray
    """(b, ms, ms)"""

    @staticmethod
    def of(H: FloatArray, P: FloatArray, R: FloatArray) -> "_Pass":
        """With covariances P (b, n, n) and noise R (ms, ms)."""
        HP = H @ P
        return _Pass(H, HP, HP @ _transposed(H) + R)

    def masked(self, mask: BoolArray, R: FloatArray) -> "_Pass":
        """Without the rows that (b, ms) masks out: such rows say nothing and keep their noise."""
        if np.all(mask):
            return self
        rows = mask[..., None]
        both = rows & mask[:, None, :]
        return _Pass(self.H * rows, self.HP * rows, np.where(both, self.S - R, 0.0) + R)


@dataclass(frozen=True)
class _Gain:
    """What the last pass of every state used, and what it found."""

    error: FloatArray
    """(B, n)"""
    H: FloatArray
    """(B, ms, n)"""
    K: FloatArray
    """(B, n, ms)"""
    joint_nis: FloatArray
    """(B,) of the first pass: at the prediction."""
    iterations: IntArray
    converged: BoolArray


class BatchedFilter(Generic[S]):
    """States and covariances (B, n, n), moved by `predict` and `update`."""

    def __init__(
        self,
        states: S,
        covariance: FloatArray,
        *,
        gate_probability: float = 0.9999,
        max_iterations: int = 5,
    ) -> None:
        self.states = states
        self.covariance = covariance
        self._gate_probability = gate_probability
        self._max_iterations = max_iterations

    def predict(self, model: MotionModel[S], time_s: float, step_s: float) -> None:
        """Move states and covariances forward by ``step_s`` from ``time_s``."""
        self.states, F, Q = model.propagate(self.states, time_s, step_s)
        self.covariance = symmetric(F @ self.covariance @ _transposed(F) + Q)

    def gate(self, nis: FloatArray, size: int) -> BoolArray:
        """(B, m) which measurements of ``size`` components each state would accept by itself."""
        return np.asarray(nis <= innovation_gate(self._gate_probability, size))

    def update(
        self,
        measurements: BatchedMeasurements[S],
        choose: Callable[[BoolArray], BoolArray] = lambda accepted: accepted,
    ) -> BatchedUpdate:
        """Gate, then one iterated update of every state with the measurements that pass.

        ``choose`` turns what each state's gate says, (B, m), into what is used: a bank whose
        filters are compared by their innovations must use the same in all of them. The equations
        are explained at `ErrorStateFilter.update`.
        """
        noise = measurements.noise
        size = noise.shape[1]
        R = np.asarray(block_diag(*noise))
        residual = measurements.residual(self.states)
        first = _Pass.of(_flat(measurements.jacobian(self.states)), self.covariance, R)
        nis = _single_nis(residual, first.S)
        accepted = choose(self.gate(nis, size))
        mask = np.repeat(accepted, size, axis=1)
        first = first.masked(mask, R)
        innovation = _rows(residual) * mask
        gain = self._iterate(measurements, mask, first, innovation, R)
        posterior = _joseph(self.covariance, gain.H, gain.K, R)
        error = self.states.admissible(gain.error, posterior)
        block, curved = self.states.retraction_block(error), self.states.curved
        self.states = self.states.retract(error)
        self.covariance = symmetric(_reset(posterior, block, curved))
        left_out = (~accepted) @ np.linalg.slogdet(noise)[1]
        weighed = innovation @ np.linalg.inv(R)
        return BatchedUpdate(
            accepted=accepted,
            nis=nis,
            joint_nis=gain.joint_nis,
            joint_dof=size * np.sum(accepted, axis=1),
            log_determinant=_log_determinant(first.S) - left_out,
            noise_squares=np.sum(innovation * weighed, axis=1),
            iterations=gain.iterations,
            converged=gain.converged,
            gate=innovation_gate(self._gate_probability, size),
        )

    def _iterate(
        self,
        measurements: BatchedMeasurements[S],
        mask: BoolArray,
        first: _Pass,
        innovation: FloatArray,
        R: FloatArray,
    ) -> _Gain:
        """Gauss-Newton on the posterior; states that have settled take no further part."""
        prior, P = self.states, self.covariance
        inverse = np.linalg.inv(first.S)
        spread = (inverse @ innovation[..., None])[..., 0]
        K = _transposed(inverse @ first.HP)
        error, H = (K @ innovation[..., None])[..., 0], first.H
        settled = _settled(error, K, first.HP, P)
        iterations = np.ones(len(P), dtype=np.intp)
        for _ in range(self._max_iterations - 1):
            active = np.flatnonzero(~settled)
            if len(active) == 0:
                break
            some, seen = picked(prior, active), measurements.take(active)
            P_some, rows, at = P[active], mask[active], error[active]
            iterate = some.retract(at)
            H_some = _flat(seen.jacobian(iterate))
            H_some[..., prior.curved] = H_some[..., prior.curved] @ some.retraction_block(at)
            here = _Pass.of(H_some, P_some, R).masked(rows, R)
            left = _rows(seen.residual(iterate)) * rows + (here.H @ at[..., None])[..., 0]
            K_some = _transposed(np.linalg.inv(here.S) @ here.HP)
            found = (K_some @ left[..., None])[..., 0]
            iterations[active] += 1
            settled[active] = _settled(found - at, K_some, here.HP, P_some)
            error[active], K[active], H[active] = found, K_some, here.H
        nis = np.sum(innovation * spread, axis=1)
        return _Gain(error, H, K, nis, iterations, settled)


def _settled(change: FloatArray, K: FloatArray, HP: FloatArray, P: FloatArray) -> BoolArray:
    """(b,) whether a change is far below the standard deviation of every component."""
    # Of the posterior P - K H P; its rounding does not matter for this test.
    explained = np.einsum("bnk,bkn->bn", K, HP)
    variance = np.diagonal(P, axis1=1, axis2=2) - explained
    return np.asarray(np.all(np.abs(change) <= SETTLED_SD * np.sqrt(np.maximum(variance, 0.0)), 1))


def _single_nis(residual: FloatArray, S_matrix: FloatArray) -> FloatArray:
    """(B, m) of each measurement alone."""
    batch, m, s = residual.shape
    which = np.arange(m)
    blocks = S_matrix.reshape(batch, m, s, m, s)[:, which, :, which, :]
    spread = np.linalg.solve(np.moveaxis(blocks, 0, 1), residual[..., None])[..., 0]
    return np.asarray(np.sum(residual * spread, axis=-1))


def _joseph(P: FloatArray, H: FloatArray, K: FloatArray, R: FloatArray) -> FloatArray:
    """(B, n, n) ``(1 - K H) P (1 - K H)^T + K R K^T``."""
    left = np.eye(P.shape[-1]) - K @ H
    return np.asarray(left @ P @ _transposed(left) + K @ R @ _transposed(K))


def _reset(P: FloatArray, block: FloatArray, curved: slice) -> FloatArray:
    """``J P J^T`` with J the identity but for the block; changes the P (B, n, n) it is given."""
    P[:, curved] = block @ P[:, curved]
    P[..., curved] = P[..., curved] @ _transposed(block)
    return P


def _log_determinant(S_matrix: FloatArray) -> FloatArray:
    diagonal = np.diagonal(np.linalg.cholesky(S_matrix), axis1=-2, axis2=-1)
    return np.asarray(2.0 * np.sum(np.log(diagonal), axis=-1))


def _flat(jacobian: FloatArray) -> FloatArray:
    """(B, m, s, n) as (B, ms, n)."""
    return jacobian.reshape(jacobian.shape[0], -1, jacobian.shape[-1])


def _rows(residual: FloatArray) -> FloatArray:
    return residual.reshape(len(residual), -1)


def _transposed(matrix: FloatArray) -> FloatArray:
    return np.swapaxes(matrix, -1, -2)
