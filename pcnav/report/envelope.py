"""Which samples of a long series have to be drawn."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from pcnav.core.arrays import BoolArray, FloatArray, IntArray

BUCKETS = 250
"""Long series are drawn by the extremes of this many spans of time."""


def envelope(values: FloatArray, buckets: int = BUCKETS) -> IntArray:
    """Indices that draw (n,) values without losing a peak: each bucket's smallest and largest.

    All of them when there are at most two per bucket; a bucket of nan stays a gap.
    """
    if len(values) <= 2 * buckets:
        return np.arange(len(values))
    size = -(-len(values) // buckets)
    padded = np.full((-(-len(values) // size), size), np.nan)
    padded.ravel()[: len(values)] = values
    first = np.arange(0, len(values), size)
    # In a bucket of nan both extremes are the first index, and the line breaks there.
    smallest = first + np.where(np.isnan(padded), np.inf, padded).argmin(axis=1)
    largest = first + np.where(np.isnan(padded), -np.inf, padded).argmax(axis=1)
    return np.unique(np.concatenate([smallest, largest]))


@dataclass(frozen=True)
class Spans:
    """The frames of a run in at most `BUCKETS` spans of as many frames each."""

    time_s: FloatArray
    """(n,) of the frames, at least one."""

    @cached_property
    def edges_s(self) -> FloatArray:
        """(spans + 1,) when they begin, and when the last frame ends, as long as the one before."""
        t = self.time_s
        end = 2.0 * t[-1] - t[-2] if len(t) > 1 else t[0] + 1.0
        return np.append(t[self._first], end)

    def mean(self, values: FloatArray | IntArray | BoolArray) -> FloatArray:
        """(spans,) of (n,) values."""
        counts = np.diff(np.append(self._first, len(self.time_s)))
        return np.add.reduceat(np.asarray(values, dtype=np.float64), self._first) / counts

    def extremes(self, values: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(spans,) smallest and largest of (n,) values."""
        return np.minimum.reduceat(values, self._first), np.maximum.reduceat(values, self._first)

    @cached_property
    def _first(self) -> IntArray:
        return np.arange(0, len(self.time_s), -(-len(self.time_s) // BUCKETS))
