"""Edges of one frame that contradict each other, or what its ranges say.

Returns may end before the target does: a mask was cut too tight, a table was taken out and the
target's foot with it, a sensor sees nothing at grazing incidence. Where they end is then no edge of
the target, though it looks like one. One frame tells by its other edges: a target whose upper and
lower edge are nearer to each other than its mesh has them is cut at one of the two, and where
nothing else says at which, neither is worth more than what they are apart.
"""

from typing import NamedTuple

import numpy as np

from pcnav.core.arrays import BoolArray, FloatArray

_GATE_SIGMA = 4.0
"""Edges further apart than so many standard deviations contradict each other ..."""
_WHOLE_PX = 1.0
"""... if they do by more than a pixel: that much a sensor may see an edge off by."""
_OUTVOTED = 4
"""An edge that contradicts others is believed where it does so many times fewer than another."""


_FRAMES_ALIKE = 10
"""What cuts a target cuts it in one frame like in the next: so many tell no more than one."""


class KnownError(NamedTuple):
    """What is known of the error of a pose without its outline."""

    mean: FloatArray
    """(6,)"""
    covariance: FloatArray
    """(6, 6)"""


def conflicts_px(
    value: FloatArray, variance: FloatArray, jacobian: FloatArray, known: KnownError
) -> FloatArray:
    """(n,) how far outward edges are of where others, or the pose as it is known, have them,
    pixels; 0 for those that agree.

    Args:
        value: (n,) displacement of each, measured minus predicted.
        variance: (n,) of its error.
        jacobian: (n, 6) by the pose.
        known: of the pose, without them.
    """
    value = value - jacobian @ known.mean
    joint = jacobian @ known.covariance @ jacobian.T
    own = np.diag(joint) + variance
    alone = _is_far(value, own)
    found = np.where(alone, value, 0.0)
    # How far each is from where the pose would be that each other one leads to: column from row.
    gain = joint / own[:, None]
    beyond = value[None, :] - gain * value[:, None]
    left = np.maximum(own[None, :] - gain * joint, variance[None, :])
    conflicts = _is_far(beyond, left)
    conflicts &= conflicts.T & ~(alone[:, None] | alone[None, :])
    np.fill_diagonal(conflicts, val=False)
    while conflicts.any():
        out = _suspects(conflicts)
        worst = np.argmax(np.where(conflicts, np.abs(beyond), 0.0), axis=0)
        found = np.where(out, beyond[worst, np.arange(len(out))], found)
        conflicts[out] = conflicts[:, out] = False
    return found


def in_doubt(apart_px: FloatArray) -> tuple[FloatArray, FloatArray]:
    """What is to be subtracted from the displacement of edges (n,), and added to its variance.

    An edge that was cut, or that something touches, is where it is seen, where the others have it,
    or between: half the way, give or take as much.
    """
    half = 0.5 * apart_px
    return half, _FRAMES_ALIKE * half**2


def _is_far(apart_px: FloatArray, variance: FloatArray) -> BoolArray:
    far = np.abs(apart_px)
    return np.asarray((far > _WHOLE_PX) & (far > _GATE_SIGMA * np.sqrt(variance)))


def _suspects(conflicts: BoolArray) -> BoolArray:
    """(n,) edges to be doubted, of those with conflicts (n, n): those with most of them, and all
    that do not have far fewer."""
    counts = conflicts.sum(axis=1)
    return np.asarray(_OUTVOTED * counts > counts.max())
