"""What a finite, noisy arc tells of the states, for any motion model and any measurements.

Local rank says what an endless, noiseless look at an instant would show. It does not say how long
one has to look. Along a trajectory the engine's own linearisation answers that: with the transition
F and noise Q of each step and the information ``H^T R^-1 H`` of each frame, the information of the
arc about the states at its start is ``sum Phi^T H^T R^-1 H Phi`` (the empirical Gramian weighed by
the noise), and the covariance at its end, process noise and prior included, is what a filter would
state that is right about the trajectory (posterior Cramer-Rao bound; Tichavsky, Muravchik and
Nehorai 1998).

An error of the prior is carried by ``Psi = prod (1 - K H) F``, so ``Psi P0 Psi^T`` is the prior's
part of the covariance at the end; its share of a variance says whether the data or the prior speak
(`pcnav.evaluation.knowledge`).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np

from pcnav.core.arrays import FloatArray
from pcnav.filtering.error_state import ErrorStateFilter, ManifoldState, Measurement, MotionModel

S = TypeVar("S", bound=ManifoldState)

Sensor = Callable[[S, int], Sequence[Measurement[S]]]
"""From a state and the number of its frame to what would be measured there, without error: the
residuals at the state are zero."""


@dataclass(frozen=True)
class ReferenceArc(Generic[S]):
    """States at the times of frames, and what each frame measures of them."""

    model: MotionModel[S]
    times_s: FloatArray
    """(n,) increasing."""
    states: tuple[S, ...]
    """n, from a simulation or as estimated; transitions are taken at them."""
    sensor: Sensor[S]
    weights: FloatArray
    """(n,) how many frames each stands for: an arc may be thinned."""

    def first(self, frames: int) -> "ReferenceArc[S]":
        """The arc of so many of its frames."""
        return ReferenceArc(
            self.model,
            self.times_s[:frames],
            self.states[:frames],
            self.sensor,
            self.weights[:frames],
        )


def reference_arc(
    model: MotionModel[S],
    start: S,
    times_s: FloatArray,
    sensor: Sensor[S],
    weights: FloatArray | None = None,
) -> ReferenceArc[S]:
    """The arc that a state at the first time leads to by its own motion."""
    states = [start]
    for before, time_s in zip(times_s[:-1].tolist(), times_s[1:].tolist(), strict=True):
        states.append(model.propagate(states[-1], before, time_s - before)[0])
    weights = np.ones(len(times_s)) if weights is None else weights
    return ReferenceArc(model, times_s, tuple(states), sensor, weights)


def frame_information(measurements: Sequence[Measurement[S]], state: S, size: int) -> FloatArray:
    """(n, n) ``sum H^T R^-1 H`` of one frame; zero without measurements."""
    information = np.zeros((size, size))
    for measurement in measurements:
        H = measurement.jacobian(state)
        information += H.T @ np.linalg.solve(measurement.covariance, H)
    return information


def start_information(arc: ReferenceArc[S], size: int) -> FloatArray:
    """(n, n) what all frames say of the errors at the first time; process noise left out."""
    information, transition = np.zeros((size, size)), np.eye(size)
    for k, state in enumerate(arc.states):
        if k > 0:
            before = float(arc.times_s[k - 1])
            step_s = float(arc.times_s[k]) - before
            transition = arc.model.propagate(arc.states[k - 1], before, step_s)[1] @ transition
        here = frame_information(arc.sensor(state, k), state, size)
        information += arc.weights[k] * (transition.T @ here @ transition)
    return 0.5 * (information + information.T)


@dataclass(frozen=True)
class ExpectedKnowledge:
    """What a filter that is right about the trajectory would state after each frame."""

    times_s: FloatArray
    """(n,)"""
    sd: FloatArray
    """(n, size)"""
    prior_part: FloatArray
    """(n, size) variances that stem from the prior."""
    covariance: FloatArray
    """(size, size) at the frame asked for."""
    covariance_from_prior: FloatArray
    """(size, size) the prior's part of it."""


def expected_knowledge(
    arc: ReferenceArc[S],
    prior_covariance: FloatArray,
    edge: Callable[[S], FloatArray] | None = None,
    frame: int | None = None,
) -> ExpectedKnowledge:
    """Run the shared engine along an arc with measurements that hold no error.

    Args:
        arc: the trajectory and what is measured.
        prior_covariance: (n, n) before the first frame.
        edge: matrix (m, n) from the state's errors to those that are told, the identity by default.
        frame: whose covariance is kept whole, the last by default.
    """
    size, kept_at = len(prior_covariance), len(arc.states) - 1 if frame is None else frame
    kalman: ErrorStateFilter[S] = ErrorStateFilter(arc.states[0], prior_covariance)
    from_prior: FloatArray = np.eye(size)
    sd, parts, kept = [], [], (prior_covariance, prior_covariance)
    for k, state in enumerate(arc.states):
        if k > 0:
            step = _Step.between(arc, k)
            kalman.predict(step, float(arc.times_s[k - 1]), step.step_s)
            from_prior = step.transition @ from_prior
        seen = [_Weighted(each, float(arc.weights[k])) for each in arc.sensor(state, k)]
        if seen:
            # 1 - K H = (1 + P H^T R^-1 H)^-1
            lever = np.eye(size) + kalman.covariance @ frame_information(seen, state, size)
            from_prior = np.asarray(np.linalg.solve(lever, from_prior), np.float64)
            kalman.update(seen)
        change = np.eye(size) if edge is None else edge(state)
        told, root = change @ kalman.covariance @ change.T, change @ from_prior
        told_from_prior = root @ prior_covariance @ root.T
        sd.append(np.sqrt(np.maximum(np.diag(told), 0.0)))
        parts.append(np.diag(told_from_prior))
        if k == kept_at:
            kept = (told, told_from_prior)
    return ExpectedKnowledge(arc.times_s, np.array(sd), np.array(parts), *kept)


class _Step(MotionModel[S]):
    """One step of an arc: the state after it is the trajectory's."""

    def __init__(self, state: S, transition: FloatArray, noise: FloatArray, step_s: float) -> None:
        self._state, self.transition, self._noise = state, transition, noise
        self.step_s = step_s

    @staticmethod
    def between(arc: ReferenceArc[S], k: int) -> "_Step[S]":
        """From frame k - 1 to frame k, linearised at the trajectory."""
        before = float(arc.times_s[k - 1])
        step_s = float(arc.times_s[k]) - before
        _, transition, noise = arc.model.propagate(arc.states[k - 1], before, step_s)
        return _Step(arc.states[k], transition, noise, step_s)

    def propagate(self, state: S, time_s: float, step_s: float) -> tuple[S, FloatArray, FloatArray]:
        return self._state, self.transition, self._noise


def time_to_reach(times_s: FloatArray, sd: FloatArray, wanted: float) -> float:
    """Length of arc, s, after which a standard deviation (n,) first is a wanted one or less.

    Interpolated between frames; infinite where the arc ends before.
    """
    reached = np.flatnonzero(sd <= wanted)
    if not len(reached):
        return float("inf")
    first = int(reached[0])
    if first == 0:
        return 0.0
    before, after = float(times_s[first - 1]), float(times_s[first])
    high, low = float(sd[first - 1]), float(sd[first])
    share = np.log(high / wanted) / np.log(high / low) if low > 0.0 else 1.0
    return float(before + share * (after - before) - times_s[0])


@dataclass(frozen=True)
class _Weighted(Generic[S]):
    """A measurement that stands for several of its kind."""

    one: Measurement[S]
    weight: float

    @property
    def covariance(self) -> FloatArray:
        return self.one.covariance / self.weight

    def residual(self, state: S) -> FloatArray:
        return self.one.residual(state)

    def jacobian(self, state: S) -> FloatArray:
        return self.one.jacobian(state)
