"""Which samples of a long series have to be drawn."""

import numpy as np

from pcnav.core.arrays import FloatArray, IntArray

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
