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
    inverse = np.linalg.inv(poses)
    for k in order.tolist():
        if len(kept) == most:
            break
        # One pose is another if what takes it there is nearly a symmetry.
        between = inverse[kept] @ poses[k]
        if not target.leave_no_trace(between, _SAME_ANGLE_RAD, _SAME_SHIFT_FRACTION).any():
            kept.append(k)
    return kept
