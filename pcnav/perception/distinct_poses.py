"""Poses that are told apart, up to the symmetry of a target."""

import numpy as np

from pcnav.core.arrays import FloatArray, IntArray
from pcnav.target.satellite import Target

_SAME_ANGLE_RAD = 0.15
_SAME_SHIFT_FRACTION = 0.08


def distinct(poses: FloatArray, order: IntArray, target: Target, most: int) -> list[int]:
    """Which of poses (k, 4, 4), taken in an order, no earlier one is equal to, up to the target's
    symmetry; at most so many."""
    kept: list[int] = []
    left = order
    while len(left) and len(kept) < most:
        first = int(left[0])
        kept.append(first)
        # One pose is another if what takes it there is nearly a symmetry.
        between = np.linalg.inv(poses[first]) @ poses[left[1:]]
        same = target.leave_no_trace(between, _SAME_ANGLE_RAD, _SAME_SHIFT_FRACTION)
        left = left[1:][~same]
    return kept
