"""Bars: what the tracker must show, said once and judged alike in every chapter."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import binomtest

from pcnav.core.arrays import FloatArray
from pcnav.evaluation.metrics import chi_square_bounds
from pcnav.files.text_table import number

NONE = "-"
"""Stands in a table where there is no number."""


@dataclass(frozen=True)
class Bar:
    """One line of the verdict."""

    chapter: str
    quantity: str
    bar: str
    ours: str
    met: bool


@dataclass(frozen=True)
class MeanSquared:
    """Squared normalised errors of independent runs, per degree of freedom."""

    mean: float
    """nan without any."""
    lower: float
    upper: float
    """95 % bounds of the mean if the stated covariances are right."""
    values: int

    @property
    def verdict(self) -> str:
        """``inside``, ``above`` (covariances too small) or ``below`` (too large)."""
        if not self.values:
            return NONE
        if self.mean > self.upper:
            return "above"
        return "below" if self.mean < self.lower else "inside"

    @property
    def bounds(self) -> str:
        """As text."""
        return f"{self.lower:.2f} to {self.upper:.2f}" if self.values else NONE

    def __str__(self) -> str:
        if not self.values:
            return NONE
        return f"{self.mean:.2f} ({self.bounds}) {self.verdict}"


def mean_squared(squared: FloatArray, degrees: FloatArray | int) -> MeanSquared:
    """Judge squared normalised errors (n,) of so many degrees of freedom each; nan is left out."""
    degrees = np.broadcast_to(degrees, squared.shape)
    known = np.isfinite(squared) & (degrees > 0)
    total = float(degrees[known].sum())
    if total == 0.0:
        return MeanSquared(np.nan, np.nan, np.nan, 0)
    lower, upper = chi_square_bounds(np.array(total))
    mean = float(squared[known].sum()) / total
    return MeanSquared(mean, float(lower) / total, float(upper) / total, int(known.sum()))


def share(count: int, total: int) -> str:
    """A share and its Wilson 95 % interval, per cent."""
    interval = binomtest(count, total).proportion_ci(0.95, method="wilson")
    return f"{count / total:.1%} ({100.0 * interval.low:.1f} to {100.0 * interval.high:.1f})"


def at(percent: float, values: FloatArray) -> float:
    """A percentile of values (n,), those that are nan left out; nan without any."""
    known = values[np.isfinite(values)]
    return float(np.percentile(known, percent)) if known.size else np.nan


def joined(*values: float) -> str:
    """Several numbers in one cell."""
    return " / ".join(number(value) for value in values)


def numbers(values: Sequence[float]) -> tuple[str, ...]:
    """Cells of a table."""
    return tuple(number(value) for value in values)
