"""Any shape: cold starts of targets that have no rectangle to be recognised by."""

from collections.abc import Sequence

import numpy as np

from pcnav.core.statistics import share
from pcnav.files.text_table import TextTable
from pcnav.simulation.random_truth import Spread

from ..tables import Claim, below, never
from . import starts
from .shapes import SHAPES, shape
from .starts import FRAMES, Outcome, Start, Starts, count, start_of

NAME = "any shape"
CASES = {name: (name,) for name in SHAPES}
QUICK_CASES = {name: (name,) for name in ("hexagonal bus", "asteroid")}
"""Two of them, for a look at the machinery."""
_NEAREST, _FARTHEST, _RATE_DEG_S, _SPEED = 3.2, 6.0, 12.0, 0.004
"""Distances and speed in diameters, and rate of the truths."""
_RIGHT_BAR, _MEDIAN_BAR_S, _SECONDS_BAR = 0.98, 0.5, 2.0


def run_shape(name: str, seed: int) -> Start:
    """One cold start of a shape: truth and noise are the seed's."""
    of = shape(name)
    diameter_m = of.target.diameter_m
    spread = Spread(
        (_NEAREST * diameter_m, _FARTHEST * diameter_m),
        (_RATE_DEG_S, _RATE_DEG_S),
        _SPEED * diameter_m,
    )
    return start_of(name, of, spread, seed)


def tables(found: Starts) -> list[TextTable]:
    """All starts, and those that were not right."""
    return starts.tables(found, "shape_start", shape)


def claims(found: Sequence[Start]) -> list[Claim]:
    """The bars of all shapes together."""
    right, seconds = count(found, Outcome.RIGHT), [start.seconds for start in found]
    median = float(np.median(seconds))
    return [
        Claim(
            NAME,
            f"right within {FRAMES} frames",
            f">= {_RIGHT_BAR:.0%}",
            share(right, len(found)),
            right >= _RIGHT_BAR * len(found),
        ),
        never(NAME, "locked on a wrong attitude", count(found, Outcome.WRONG)),
        Claim(NAME, "median start, s", f"<= {_MEDIAN_BAR_S:g}", median, median <= _MEDIAN_BAR_S),
        below(NAME, "slowest start, s", seconds, _SECONDS_BAR),
    ]
