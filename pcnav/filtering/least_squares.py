"""The one least-squares fit of arcs: Levenberg and Marquardt on many problems of one shape at once.

A problem gives its normal equations about a state and moves the state by a step. The engine owns
the damping, what counts as an improvement and when a problem has settled.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np

from pcnav.core.arrays import AnyDataclass, BoolArray, FloatArray, chosen

S = TypeVar("S", bound=AnyDataclass)


@dataclass(frozen=True)
class NormalEquations:
    """Of B problems with n unknowns, about their states."""

    normal: FloatArray
    """(B, n, n)"""
    gradient: FloatArray
    """(B, n) what the normal matrix times the step is to be."""
    cost: FloatArray
    """(B,) weighted squared residuals, those of priors included."""


E = TypeVar("E", bound=NormalEquations)


@dataclass(frozen=True)
class Descent:
    """How a problem is descended."""

    max_steps: int
    settled_sd: float
    """A step that changes every unknown by less than this share of its deviation is the last."""
    damping: tuple[float, float, float]
    """At first, at least and at most, over the diagonal of the normal matrix."""
    slack: float = 1e-12
    """A cost that is larger by this share is no worse: rounding."""


class ArcProblem(ABC, Generic[S, E]):
    """B fits of one shape; the states are a dataclass of arrays over the leading dimension."""

    @abstractmethod
    def linearised(self, state: S) -> E:
        """The normal equations about a state."""

    @abstractmethod
    def moved(self, state: S, step: FloatArray) -> S:
        """The state moved by steps (B, n), as far as it can be."""

    def step(self, state: S, damped: FloatArray, gradient: FloatArray) -> FloatArray:
        """(B, n) steps of damped normal equations (B, n, n), (B, n)."""
        return np.asarray(np.linalg.solve(damped, gradient[..., None])[..., 0], np.float64)

    def choose(self, which: BoolArray, tried: S, before: S) -> S:
        """The state that was tried where a problem is marked (B,), the one before where not."""
        return chosen(which, tried, before)


@dataclass(frozen=True)
class Minimum(Generic[S, E]):
    """Where the descents ended."""

    state: S
    equations: E
    converged: BoolArray
    """(B,)"""


def minimise(problem: ArcProblem[S, E], start: S, descent: Descent) -> Minimum[S, E]:
    """Descend from a start; problems that settle early wait for the others."""
    state, here = start, problem.linearised(start)
    first, least, most = descent.damping
    damping = np.full(len(here.cost), first)
    converged = np.zeros(len(damping), dtype=np.bool_)
    for _ in range(descent.max_steps):
        diagonal = here.normal * np.eye(here.normal.shape[-1])
        step = problem.step(state, here.normal + damping[:, None, None] * diagonal, here.gradient)
        tried = problem.moved(state, step)
        there = problem.linearised(tried)
        better = (there.cost <= here.cost * (1.0 + descent.slack)) & ~converged
        sd = 1.0 / np.sqrt(np.diagonal(here.normal, axis1=-2, axis2=-1))
        settled = np.all(np.abs(step) < descent.settled_sd * sd, axis=-1)
        state, here = problem.choose(better, tried, state), chosen(better, there, here)
        damping = np.clip(damping * np.where(better, 0.1, 10.0), least, most)
        converged |= settled & better
        if np.all(converged | (damping >= most)):
            break
    return Minimum(state, here, converged)


class ArcGrowth:
    """When a growing arc is fitted anew: a filter carries each fit on to the next.

    At a first length and whenever it has grown by a factor, so that what was linearised about a
    worse estimate never makes up much of what is known; up to a longest arc, after which the
    filter goes on alone.
    """

    def __init__(self, first: int, factor: float, longest: float = np.inf) -> None:
        self._next, self._factor, self._longest = first, factor, longest

    def is_due(self, length: int) -> bool:
        """Whether an arc of so many frames is to be fitted; asked once a length."""
        if length < self._next:
            return False
        self._next = int(np.ceil(self._factor * length))
        return True

    def is_over(self, length: int) -> bool:
        """Whether an arc of so many frames is the last to be fitted."""
        return length >= self._longest
