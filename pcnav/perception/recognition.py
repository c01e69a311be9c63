"""Which catalogue rectangles a segment can be: both sides and the area must agree."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from pcnav.core.chi_square import exceeds, upper_quantile
from pcnav.perception.rectangles import AREA, LENGTH, WIDTH, RectangleObservation
from pcnav.target.satellite import Rectangle

_MODEL_TOLERANCE = 0.01
"""A catalogue entry is a rectangle to 1 %, so its sides and area are known to 1 %."""


@dataclass(frozen=True)
class Recognition:
    """One catalogue entry that agrees with an observation."""

    rectangle: Rectangle
    chi_square: float
    """Of the differences in sides and area; small is good."""


def recognise(
    observation: RectangleObservation, catalogue: tuple[Rectangle, ...], gate_sigma: float
) -> tuple[Recognition, ...]:
    """Catalogue entries whose size agrees with the observation, best first.

    The gate is the chi-square quantile that ``gate_sigma`` standard deviations have in one
    dimension. Besides the observation's own errors the sides may differ by the 1 % to which an
    entry is a rectangle, and by a rim, as of a panel's thickness, too thin to be distinguished.
    """
    rows = [LENGTH, WIDTH] if np.isnan(observation.area_m2) else [LENGTH, WIDTH, AREA]
    gate = size_gate(gate_sigma, len(rows))
    found = []
    for rectangle in catalogue:
        size = np.array([rectangle.length_m, rectangle.width_m, rectangle.area_m2])[: len(rows)]
        seen = np.array([observation.length_m, observation.width_m, observation.area_m2])[
            : len(rows)
        ]
        rim_effect = observation.rim_m * np.array(
            [1.0, 1.0, rectangle.length_m + rectangle.width_m]
        )
        tolerance = np.diag((_MODEL_TOLERANCE * size) ** 2 + rim_effect[: len(rows)] ** 2)
        covariance = observation.covariance[np.ix_(rows, rows)] + tolerance
        difference = seen - size
        chi_square = float(difference @ np.linalg.solve(covariance, difference))
        if chi_square < gate:
            found.append(Recognition(rectangle, chi_square))
    return tuple(sorted(found, key=lambda recognition: recognition.chi_square))


@lru_cache(maxsize=16)
def size_gate(gate_sigma: float, dof: int) -> float:
    """Chi-square of ``dof`` differences that is as rare as one of ``gate_sigma`` deviations."""
    return float(upper_quantile(exceeds(gate_sigma**2, 1), dof))
