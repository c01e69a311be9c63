"""What many runs come to: mean squared normalised errors with their bounds, shares, percentiles."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.special import ndtri

from pcnav.core import chi_square
from pcnav.core.arrays import BoolArray, FloatArray, IntArray

CONFIDENCE = 0.95
"""Of every interval and bound here."""
NONE = "-"
"""Stands where there is no number."""


def chi_square_bounds(degrees: npt.ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Two-sided 95 % bounds of a chi-square variable, element by element."""
    tail = 0.5 * (1.0 - CONFIDENCE)
    return chi_square.quantile(tail, degrees), chi_square.quantile(1.0 - tail, degrees)


@dataclass(frozen=True)
class MeanSquared:
    """Means over independent runs of squared normalised errors per degree of freedom.

    Of one quantity, or of many of any shape: ``means[k]`` is one of them.
    """

    mean: FloatArray
    """(...,) 1 when the stated covariances are right; nan without any error."""
    lower: FloatArray
    upper: FloatArray
    """(...,) 95 % bounds of the mean if the stated covariances are right."""
    values: IntArray
    """(...,) How many errors it is a mean of."""

    def __getitem__(self, place: int | tuple[int, ...]) -> "MeanSquared":
        """One of many."""
        mean, lower, upper = (each[place] for each in (self.mean, self.lower, self.upper))
        return MeanSquared(mean, lower, upper, self.values[place])

    @property
    def inside(self) -> BoolArray:
        """(...,) whether the mean is within its bounds; false without any error."""
        return np.asarray((self.mean >= self.lower) & (self.mean <= self.upper))

    @property
    def verdict(self) -> str:
        """Of a single mean: ``inside``, ``above`` (covariances too small) or ``below``."""
        if not self.values:
            return NONE
        if self.mean > self.upper:
            return "above"
        return "below" if self.mean < self.lower else "inside"

    @property
    def bounds(self) -> str:
        """Of a single mean, as text."""
        return f"{self.lower:.2f} to {self.upper:.2f}" if self.values else NONE

    def __str__(self) -> str:
        return f"{self.mean:.2f} ({self.bounds}) {self.verdict}" if self.values else NONE


def mean_squared(squared: FloatArray, degrees: npt.ArrayLike, axis: int = 0) -> MeanSquared:
    """Means along an axis of squared normalised errors, of so many degrees of freedom each.

    Errors that are nan, and those without degrees of freedom, are left out. The bounds are those
    of as many independent draws as there are errors.
    """
    degrees = np.broadcast_to(np.asarray(degrees, dtype=np.float64), squared.shape)
    known = np.isfinite(squared) & (degrees > 0.0)
    total = np.sum(degrees, axis=axis, where=known)
    # A chi-square variable without degrees of freedom has no quantiles, 0 / 0 no value.
    total = np.where(total > 0.0, total, np.nan)
    lower, upper = chi_square_bounds(total)
    mean = np.sum(squared, axis=axis, where=known) / total
    return MeanSquared(mean, lower / total, upper / total, np.asarray(known.sum(axis=axis)))


@dataclass(frozen=True)
class Share:
    """A share of independent runs and its Wilson 95 % interval."""

    count: int
    total: int
    low: float
    high: float

    @property
    def value(self) -> float:
        """From 0 to 1."""
        return self.count / self.total

    def __str__(self) -> str:
        return f"{self.value:.1%} ({100.0 * self.low:.1f} to {100.0 * self.high:.1f})"


def share(count: int, total: int) -> Share:
    """So many of so many runs, at least one. Wilson 1927."""
    z = float(ndtri(0.5 * (1.0 + CONFIDENCE)))
    p, scale = count / total, 1.0 + z**2 / total
    centre = (p + 0.5 * z**2 / total) / scale
    half = z * np.sqrt(p * (1.0 - p) / total + 0.25 * (z / total) ** 2) / scale
    low = float(centre - half) if count else 0.0
    return Share(count, total, low, float(centre + half) if count < total else 1.0)


def finite(values: npt.ArrayLike) -> FloatArray:
    """(k,) those of values of any shape that are finite."""
    array = np.asarray(values, dtype=np.float64)
    return np.asarray(array[np.isfinite(array)])


def percentile(values: npt.ArrayLike, percent: float) -> float:
    """Over all values of any shape, those that are not finite left out; nan without any."""
    known = finite(values)
    return float(np.percentile(known, percent)) if known.size else np.nan


def mean(values: npt.ArrayLike) -> float:
    """Over all values of any shape, those that are not finite left out; nan without any."""
    known = finite(values)
    return float(known.mean()) if known.size else np.nan


def root_mean_square(values: npt.ArrayLike) -> float:
    """Over all values of any shape, those that are not finite left out; nan without any."""
    known = finite(values)
    return float(np.sqrt(np.mean(known**2))) if known.size else np.nan
