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


def draw_hypotheses(
    draw: Draw, count: int, rng: np.random.Generator, inertia: FloatArray = paper.TARGET_INERTIA
) -> FloatArray:
    """(count, 3, 3) kg m^2, about an inertia (3, 3)."""
    scale = inertia / 3.0 if draw is Draw.PHYSICAL else inertia @ inertia.T / 3.0
    found: list[FloatArray] = []
    for _ in range(_MAX_DRAWS * count):
        deviation = wishart.rvs(paper.DEGREES_OF_FREEDOM, scale, random_state=rng)
        drawn = np.asarray(inertia + deviation, dtype=np.float64)
        if draw is Draw.PRINTED or is_physical_inertia(drawn):
            found.append(drawn)
        if len(found) == count:
            return np.stack(found)
    raise ValueError("no physical inertia among the draws")


def moments_only(
    count: int, rng: np.random.Generator, inertia: FloatArray = paper.TARGET_INERTIA
) -> FloatArray:
    """(count, 3, 3) bodies with the principal axes of an inertia and moments of their own."""
    _, axes = np.linalg.eigh(inertia)
    # Second moments of the mass along the axes, whatever they are, are those of a body.
    second = rng.uniform(0.2, 1.0, (count, 3))
    moments = np.sum(second, axis=1, keepdims=True) - second
    return np.asarray((axes * moments[:, None, :]) @ axes.T)


def physical_share(draw: Draw, count: int, rng: np.random.Generator) -> float:
    """Share of plain draws that a body can have."""
    inertia = paper.TARGET_INERTIA
    scale = inertia / 3.0 if draw is Draw.PHYSICAL else inertia @ inertia.T / 3.0
    drawn = wishart.rvs(paper.DEGREES_OF_FREEDOM, scale, size=count, random_state=rng)
    moments = np.linalg.eigvalsh(inertia + np.asarray(drawn))
    return float(np.mean(moments[:, 0] + moments[:, 1] >= moments[:, 2]))
