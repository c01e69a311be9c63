"""Statistics over the runs of a study; values that are nan are left out, nan stands for none."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.stats import binomtest

from pcnav.core.arrays import FloatArray
from pcnav.evaluation.metrics import chi_square_bounds


def known(values: ArrayLike) -> FloatArray:
    """(k,) those values of any shape that are finite."""
    array = np.asarray(values, dtype=np.float64)
    return np.asarray(array[np.isfinite(array)])


def percentile(values: ArrayLike, percent: float) -> float:
    """A percentile."""
    of = known(values)
    return float(np.percentile(of, percent)) if of.size else np.nan


def median(values: ArrayLike) -> float:
    """The median."""
    return percentile(values, 50.0)


def largest(values: ArrayLike) -> float:
    """The largest."""
    return percentile(values, 100.0)


def mean(values: ArrayLike) -> float:
    """The mean."""
    of = known(values)
    return float(np.mean(of)) if of.size else np.nan


def rms(values: ArrayLike) -> float:
    """The root mean square."""
    return float(np.sqrt(mean(np.square(np.asarray(values, dtype=np.float64)))))


def share(count: int, total: int) -> str:
    """A share and its Wilson 95 % interval, per cent."""
    interval = binomtest(count, total).proportion_ci(0.95, method="wilson")
    return f"{count / total:.1%} ({100.0 * interval.low:.1f} to {100.0 * interval.high:.1f})"


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
        """``inside``, ``above`` (covariances too small) or ``below`` (too large); ``-`` of none."""
        if not self.values:
            return "-"
        if self.mean > self.upper:
            return "above"
        return "below" if self.mean < self.lower else "inside"

    @property
    def bounds(self) -> str:
        """As text."""
        return f"{self.lower:.2f} to {self.upper:.2f}" if self.values else "-"

    def __str__(self) -> str:
        return f"{self.mean:.2f} ({self.bounds}) {self.verdict}" if self.values else "-"


def mean_squared(squared: FloatArray, degrees: FloatArray | int) -> MeanSquared:
    """Judge squared normalised errors (n,) of so many degrees of freedom each."""
    degrees = np.broadcast_to(degrees, squared.shape)
    used = np.isfinite(squared) & (degrees > 0)
    total = float(degrees[used].sum())
    if total == 0.0:
        return MeanSquared(np.nan, np.nan, np.nan, 0)
    lower, upper = chi_square_bounds(np.array(total))
    average = float(squared[used].sum()) / total
    return MeanSquared(average, float(lower) / total, float(upper) / total, int(used.sum()))


def mean_squared_over_time(
    squared: FloatArray, degrees: FloatArray | int
) -> tuple[MeanSquared, ...]:
    """Judge squared normalised errors (runs, n) at every time, degrees likewise or alike."""
    degrees = np.broadcast_to(degrees, squared.shape)
    columns: Sequence[tuple[FloatArray, FloatArray]] = list(zip(squared.T, degrees.T, strict=True))
    return tuple(mean_squared(column, of) for column, of in columns)
