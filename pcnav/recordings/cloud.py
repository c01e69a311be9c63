"""A cloud of points that a sensor has seen, and when it saw each."""

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from pcnav.core.arrays import FloatArray

MAX_POINTS = 64_000_000
_TIME_NAMES = ("time_s", "t", "time", "timestamp", "time_stamp", "offset_time", "time_offset")
_UNITS_S = (1.0, 1e-3, 1e-6, 1e-9)
_SHORTEST_S, _LONGEST_S = 4e-3, 3.9
"""Of a scan: in which unit its times are counted is told by how long it lasts."""


@dataclass(frozen=True)
class Cloud:
    """Points in the axes of the sensor, in its unit, in rows and columns."""

    points: FloatArray
    """(rows, columns, 3); (1, n, 3) of points in no order. nan or all 0 where nothing returned."""
    time: FloatArray | None = None
    """(rows, columns) when they were seen, as stored; None where that is not."""


def time_name(names: Collection[str]) -> str | None:
    """The one of some fields that tells when a point was seen; None without."""
    return next((name for name in _TIME_NAMES if name in names), None)


def times_of_scan(time: FloatArray) -> tuple[FloatArray, str]:
    """(n,) seconds from the earliest of times (n,) as stored, and in which unit these were.

    Raises `ValueError` where no unit makes it a scan of 4 ms to 3.9 s. Times that are all the same
    tell of no motion.
    """
    since = time - time.min()
    span = float(since.max())
    if span == 0.0:
        return since, "s"
    for unit_s, name in zip(_UNITS_S, ("s", "ms", "us", "ns"), strict=True):
        if _SHORTEST_S <= unit_s * span <= _LONGEST_S:
            return unit_s * since, name
    raise ValueError(
        f"expected times of a scan of {_SHORTEST_S:g} to {_LONGEST_S:g} s, got {span:g}"
    )


def has_returned(points: FloatArray) -> "np.ndarray[tuple[int, ...], np.dtype[np.bool_]]":
    """(...) which of points (..., 3) are some."""
    return np.asarray(np.isfinite(points).all(axis=-1) & (points != 0.0).any(axis=-1))
