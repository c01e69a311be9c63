"""The time stamps of recorded frames: put in order, told apart, and counted from a zero."""

from dataclasses import dataclass

import numpy as np

from pcnav.core.arrays import FloatArray, IntArray

EPOCH_S = 1e7
"""A clock that a recording began reads less at its first frame; one of an epoch reads more."""
MAX_STAMP_S = 1e11
"""Seconds of no epoch reach so far: such stamps are counted in another unit."""
_MAX_OVERLAP = 10
"""So many frames may come after later ones; more, and the clock began anew."""
_GAP_STEPS = 5.0
"""A step so many times the median one is a gap."""
_MIN_FRAMES_FOR_GAPS = 5


@dataclass(frozen=True)
class TimeLine:
    """In which order frames were taken, and which of them have a time of their own."""

    kept: IntArray
    """(m,) rows of the frames with a time of their own, in order of time."""
    remarks: tuple[str, ...]
    """What was not as expected, in words."""


def time_line(time_s: FloatArray, numbers: IntArray) -> TimeLine:
    """The order of frames by their stamps (n,); ``numbers`` name them in remarks.

    Of frames with one stamp the first is kept. See `begins_anew` for what cannot be put in order.
    """
    order = np.argsort(time_s, kind="stable")
    earlier = int(np.count_nonzero(np.diff(time_s) < 0.0))
    new = np.concatenate([[True], np.diff(time_s[order]) > 0.0])
    kept, dropped = order[new], numbers[order[~new]]
    remarks = []
    if earlier:
        remarks.append(f"{earlier} of {len(order)} frames come before the one they follow: sorted")
    if len(dropped):
        first = f"the first is frame {int(dropped.min())}"
        remarks.append(f"{len(dropped)} frames with the time stamp of another left out, {first}")
    remarks += _gaps(time_s[kept], numbers[kept])
    return TimeLine(kept, tuple(remarks))


def begins_anew(time_s: FloatArray) -> int | None:
    """Row of the frame at which the clock begins anew; None where frames are merely out of order.

    Two stretches of rising stamps that overlap by many frames are no frames that changed places:
    sorted, they would be mixed.
    """
    breaks = np.flatnonzero(np.diff(time_s) < 0.0) + 1
    edges = [0, *breaks.tolist(), len(time_s)]
    for begin, middle, end in zip(edges[:-2], edges[1:-1], edges[2:], strict=True):
        before, after = time_s[begin:middle], time_s[middle:end]
        low, high = max(before[0], after[0]), min(before[-1], after[-1])
        common = [np.count_nonzero((part >= low) & (part <= high)) for part in (before, after)]
        if min(common) > _MAX_OVERLAP:
            return int(middle)
    return None


def zero_of(first_s: float, stated_s: float | None) -> float:
    """The stamp that is time 0: the one stated, or the first of an epoch, or 0."""
    if stated_s is not None:
        return stated_s
    return first_s if abs(first_s) > EPOCH_S else 0.0


def _gaps(time_s: FloatArray, numbers: IntArray) -> list[str]:
    if len(time_s) < _MIN_FRAMES_FOR_GAPS:
        return []
    steps = np.diff(time_s)
    gaps = np.flatnonzero(steps > _GAP_STEPS * np.median(steps))
    if not gaps.size:
        return []
    longest = int(gaps[np.argmax(steps[gaps])])
    many = "a gap" if gaps.size == 1 else f"{gaps.size} gaps, the longest"
    return [f"{many} of {steps[longest]:.3g} s before frame {int(numbers[longest + 1])}"]
