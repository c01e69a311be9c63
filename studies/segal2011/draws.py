"""Hypotheses of the inertia, drawn about the true one (17)."""

from enum import StrEnum

import numpy as np
from scipy.stats import wishart

from pcnav.core.arrays import FloatArray
from pcnav.dynamics.rigid_body import is_physical_inertia

from . import paper

_MAX_DRAWS = 10_000


class Draw(StrEnum):
    """How hypotheses are drawn: the truth plus a Wishart matrix with 3 degrees of freedom."""

    PRINTED = "as printed"
    """Scale I I^T / 3, so that the deviation is of the order of the square of the inertia."""
    PHYSICAL = "physical"
    """Scale I / 3, and only those that a body can have."""

    @property
    def scale(self) -> FloatArray:
        """(3, 3) of the Wishart matrix."""
        inertia = paper.TARGET_INERTIA
        return inertia / 3.0 if self is Draw.PHYSICAL else inertia @ inertia.T / 3.0


def draw_hypotheses(draw: Draw, count: int, rng: np.random.Generator) -> FloatArray:
    """(count, 3, 3) kg m^2."""
    found: list[FloatArray] = []
    for _ in range(_MAX_DRAWS * count):
        deviation = wishart.rvs(paper.DEGREES_OF_FREEDOM, draw.scale, random_state=rng)
        drawn = np.asarray(paper.TARGET_INERTIA + deviation, dtype=np.float64)
        if draw is Draw.PRINTED or is_physical_inertia(drawn):
            found.append(drawn)
        if len(found) == count:
            return np.stack(found)
    raise ValueError("no physical inertia among the draws")


def physical_share(draw: Draw, count: int, rng: np.random.Generator) -> float:
    """Share of plain draws that a body can have."""
    drawn = wishart.rvs(paper.DEGREES_OF_FREEDOM, draw.scale, size=count, random_state=rng)
    moments = np.linalg.eigvalsh(paper.TARGET_INERTIA + np.asarray(drawn))
    return float(np.mean(moments[:, 0] + moments[:, 1] >= moments[:, 2]))


def truth_only(_: np.random.Generator) -> FloatArray:
    """The true inertia as the one hypothesis."""
    return paper.TARGET_INERTIA[None]


def drawn_and_truth(rng: np.random.Generator) -> FloatArray:
    """Five physical draws, then the truth."""
    drawn = draw_hypotheses(Draw.PHYSICAL, paper.HYPOTHESES, rng)
    return np.concatenate([drawn, paper.TARGET_INERTIA[None]])


def drawn_as_printed(rng: np.random.Generator) -> FloatArray:
    """Five draws as printed."""
    return draw_hypotheses(Draw.PRINTED, paper.HYPOTHESES, rng)


def four_and_truth(rng: np.random.Generator) -> FloatArray:
    """Four physical draws, then the truth."""
    return drawn_and_truth(rng)[1:]


def four_moments_and_truth(rng: np.random.Generator) -> FloatArray:
    """Four bodies with the true principal axes and moments of their own, then the truth."""
    _, axes = np.linalg.eigh(paper.TARGET_INERTIA)
    # Second moments of the mass along the axes, whatever they are, are those of a body.
    second = rng.uniform(0.2, 1.0, (4, 3))
    moments = np.sum(second, axis=1, keepdims=True) - second
    bodies = (axes * moments[:, None, :]) @ axes.T
    return np.concatenate([bodies, paper.TARGET_INERTIA[None]])
