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
        between = inverse[kept] @ poses[k] if kept else np.empty((0, 4, 4))
        if not _nearly_symmetric(between, target):
            kept.append(k)
    return kept


def _nearly_symmetric(motions: FloatArray, target: Target) -> bool:
    group = target.symmetry_transforms
    cosine = np.einsum("kij,gij->kg", motions[:, :3, :3], group[:, :3, :3])
    turned = 0.5 * (cosine - 1.0) > np.cos(_SAME_ANGLE_RAD)
    # What a motion does to the middle of the target, not to a far-off origin.
    middle = np.asarray(target.mesh.bounds).mean(axis=0)
    moved = motions[:, :3, :3] @ middle + motions[:, :3, 3]
    mapped = group[:, :3, :3] @ middle + group[:, :3, 3]
    apart = np.linalg.norm(moved[:, None] - mapped[None], axis=2)
    return bool(np.any(turned & (apart < _SAME_SHIFT_FRACTION * target.diameter_m)))
