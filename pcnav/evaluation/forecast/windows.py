"""When a point can be captured, and for how long a forecast is good enough."""

from dataclasses import dataclass

import numpy as np

from pcnav.core.arrays import FloatArray
from pcnav.evaluation.forecast.point import Forecast

SURE, LIKELY = 0.95, 0.5
"""Probabilities from which on a point counts as within its limits."""


@dataclass(frozen=True)
class Window:
    """A span of a forecast in which a point is within its limits."""

    begin_s: float
    end_s: float
    """Since the estimate: the first and the last of the forecast's times in it."""
    probability: float
    """The least within it."""


def windows(forecast: Forecast, probability: float) -> tuple[Window, ...]:
    """Spans in which the point is within its limits with at least a probability."""
    each = np.array([instant.probability for instant in forecast.instants])
    edges = np.diff(np.concatenate([[0], (each >= probability).astype(np.intp), [0]]))
    spans = zip(np.flatnonzero(edges == 1), np.flatnonzero(edges == -1), strict=True)
    ahead = forecast.ahead_s
    return tuple(
        Window(float(ahead[a]), float(ahead[b - 1]), float(each[a:b].min())) for a, b in spans
    )


def stays_within(ahead_s: FloatArray, radius: FloatArray, tolerance: float) -> float:
    """For how long, s, the radius (n,) that holds 95 % stays within a tolerance.

    nan where it is above from the first time on; infinite where it never is.
    """
    above = np.flatnonzero(radius > tolerance)
    if not above.size:
        return np.inf
    return float(ahead_s[above[0] - 1]) if above[0] else np.nan
