"""Unbroken stretches of the crossings of an edge, and how straight they are seen."""

from dataclasses import dataclass

import numpy as np

from pcnav.core.arrays import BoolArray, FloatArray, IntArray
from pcnav.perception.edge_crossings import EdgeCrossings

_STRAIGHT_PX2 = 0.25
"""Pixels counted along a straight edge scatter by no more: they are n or n + 1."""
_MISFIT_SD = 3.0
"""Scatter so many deviations above that is no chance: the edge is not seen straight."""


@dataclass(frozen=True)
class Stretches:
    """Unbroken stretches of n crossings, k of them."""

    starts: IntArray
    """(k,) the first crossing of each."""
    n: IntArray
    """(k,) how many crossings."""
    spread: FloatArray
    """(k,) sum of the squared distances of their crossings from their middle."""
    weights: tuple[FloatArray, FloatArray]
    """(n,) each, of a mean and of a tilt over the stretch of each crossing."""

    @staticmethod
    def of(crossings: EdgeCrossings, kind: IntArray) -> "Stretches":
        """Of crossings before kinds (n,) of what lies behind; at least one."""
        starts = np.concatenate([[0], np.flatnonzero(~goes_on(crossings, kind)) + 1])
        n = np.diff(np.append(starts, len(kind)))
        offset = np.arange(len(kind)) - np.repeat(starts + 0.5 * (n - 1), n)
        spread = np.add.reduceat(offset**2, starts)
        tilt_weight = offset / np.repeat(np.maximum(spread, 0.5), n)
        return Stretches(starts, n, spread, (np.repeat(1.0 / n, n), tilt_weight))

    def total(self, values: FloatArray) -> FloatArray:
        """(k, ...) sums of values (n, ...) of the crossings."""
        return np.asarray(np.add.reduceat(values, self.starts))

    def largest(self, values: FloatArray) -> FloatArray:
        """(k,) of values (n,) of the crossings."""
        return np.asarray(np.maximum.reduceat(values, self.starts))

    def ragged_px2(self, displacement_px: FloatArray, extra_px2: FloatArray) -> FloatArray:
        """(k,) variance of the mean because the edge is seen ragged; 0 where it is seen straight.

        Args:
            displacement_px: (n,) of the crossings.
            extra_px2: (k,) variance of each, beyond that of the pixel grid.
        """
        mean, tilt = (self.total(displacement_px * weight) for weight in self.weights)
        offset = self.weights[1] * np.repeat(np.maximum(self.spread, 0.5), self.n)
        left = displacement_px - np.repeat(mean, self.n) - np.repeat(tilt, self.n) * offset
        scatter = self.total(left**2) / self.n
        allowed = (_STRAIGHT_PX2 + extra_px2) * (1.0 + _MISFIT_SD * np.sqrt(2.0 / self.n))
        # Neighbours are displaced alike: as many pieces err independently as there are between the
        # places where the edge crosses its own line.
        crosses = np.append(left[1:] * left[:-1] < 0.0, [False])
        crosses[self.starts[1:] - 1] = False
        pieces = 1.0 + self.total(crosses.astype(np.float64))
        return np.where(scatter > allowed, scatter / pieces, 0.0)


def goes_on(crossings: EdgeCrossings, kind: IntArray) -> BoolArray:
    """(n - 1,) whether the next crossing is the next along the same edge, before the same kind."""
    along = (np.diff(crossings.edge) == 0) & (np.diff(crossings.major) == 1)
    return np.asarray(
        along & (np.diff(kind) == 0) & (crossings.upright[1:] == crossings.upright[:-1])
    )
