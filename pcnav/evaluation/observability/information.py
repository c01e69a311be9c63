"""What a finite, noisy arc tells of the states, for any motion model and any measurements.

Local rank says what an endless, noiseless look at an instant would show. It does not say how long
one has to look. Along a trajectory the estimator's own linearisation answers that: with the
transition F and noise Q of each step and the whitened Jacobian ``W = R^-1/2 H`` of each frame, the
covariance at the end of the arc, process noise and prior included, is what a filter would state
that is right about the trajectory (posterior Cramer-Rao bound; Tichavsky, Muravchik and Nehorai
1998).

An error of the prior is carried by ``Psi = prod (1 - K H) F``, so ``Psi P0 Psi^T`` is the prior's
part of the covariance at the end; its share of a variance says whether the data or the prior speak
(`pcnav.evaluation.information_gain`).
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Generic, TypeVar

import numpy as np

from pcnav.core.arrays import FloatArray

S = TypeVar("S")

Propagate = Callable[[S, float, float], tuple[S, FloatArray, FloatArray]]
"""From a state, its time and a step, s, to the state after it, transition and noise (n, n)."""
Sensor = Callable[[S, int], FloatArray]
"""From a state and the number of its frame to W (m, n): how what is measured there depends on the
state's error, in units of its noise; m is 0 where nothing is measured."""


@dataclass(frozen=True)
class ReferenceArc(Generic[S]):
    """States at the times of frames, and what each frame measures of them."""

    propagate: Propagate[S]
    times_s: FloatArray
    """(n,) increasing."""
    states: tuple[S, ...]
    """n, from a simulation or as estimated; transitions are taken at them."""
    sensor: Sensor[S]
    weights: FloatArray
    """(n,) how many frames each stands for: an arc may be thinned."""

    def first(self, frames: int) -> "ReferenceArc[S]":
        """The arc of so many of its frames."""
        times_s, weights = self.times_s[:frames], self.weights[:frames]
        return replace(self, times_s=times_s, states=self.states[:frames], weights=weights)

    def step(self, k: int) -> tuple[FloatArray, FloatArray]:
        """Transition and noise (n, n) from frame k - 1 to frame k."""
        before = float(self.times_s[k - 1])
        return self.propagate(self.states[k - 1], before, float(self.times_s[k]) - before)[1:]

    def measured(self, k: int) -> FloatArray:
        """(m, n) W of frame k, its weight included."""
        return np.asarray(np.sqrt(self.weights[k]) * self.sensor(self.states[k], k))


def reference_arc(
    propagate: Propagate[S],
    start: S,
    times_s: FloatArray,
    sensor: Sensor[S],
    weights: FloatArray | None = None,
) -> ReferenceArc[S]:
    """The arc that a state at the first time leads to by its own motion."""
    states = [start]
    for before, time_s in zip(times_s[:-1].tolist(), times_s[1:].tolist(), strict=True):
        states.append(propagate(states[-1], before, time_s - before)[0])
    weights = np.ones(len(times_s)) if weights is None else weights
    return ReferenceArc(propagate, times_s, tuple(states), sensor, weights)


def whitened(jacobian: FloatArray, noise: FloatArray) -> FloatArray:
    """(m s, n) W of m measurements of size s: Jacobians (m, s, n) and covariances (m, s, s)."""
    if not len(jacobian):
        return np.zeros((0, jacobian.shape[-1]))
    rows = np.linalg.solve(np.linalg.cholesky(noise), jacobian)
    return np.asarray(rows.reshape(-1, jacobian.shape[-1]))


@dataclass(frozen=True)
class ExpectedUncertainty:
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


def expected_uncertainty(
    arc: ReferenceArc[S],
    prior_covariance: FloatArray,
    output_jacobian: Callable[[S], FloatArray] | None = None,
    frame: int | None = None,
) -> ExpectedUncertainty:
    """Carry a covariance along an arc with measurements that hold no error.

    Args:
        arc: the trajectory and what is measured.
        prior_covariance: (n, n) before the first frame.
        output_jacobian: of a state, (m, n) from its errors to those reported; the identity by
            default.
        frame: whose covariance is kept whole, the last by default.
    """
    kept_at = len(arc.states) - 1 if frame is None else frame
    P, from_prior = prior_covariance, np.eye(len(prior_covariance))
    sd, parts, kept = [], [], (P, P)
    for k, state in enumerate(arc.states):
        if k > 0:
            F, Q = arc.step(k)
            P, from_prior = F @ P @ F.T + Q, F @ from_prior
        W = arc.measured(k)
        if len(W):
            gain = np.linalg.solve(W @ P @ W.T + np.eye(len(W)), W @ P).T
            remains = np.eye(len(P)) - gain @ W
            # Joseph's form: the covariance stays positive.
            P, from_prior = remains @ P @ remains.T + gain @ gain.T, remains @ from_prior
        out = np.eye(len(P)) if output_jacobian is None else output_jacobian(state)
        reported, root = out @ P @ out.T, out @ from_prior
        reported_from_prior = root @ prior_covariance @ root.T
        sd.append(np.sqrt(np.maximum(np.diag(reported), 0.0)))
        parts.append(np.diag(reported_from_prior))
        if k == kept_at:
            kept = (reported, reported_from_prior)
    return ExpectedUncertainty(arc.times_s, np.array(sd), np.array(parts), *kept)


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
