"""How far inside a predicted edge the returns of a target end, where they end far inside.

Within the few pixels that are counted on each side such an edge looks displaced by as many,
wherever its returns end: by which the pose would be drawn after whatever is missing of the target.
"""

from dataclasses import dataclass

import numpy as np

from pcnav.core.arrays import BoolArray, DepthImage, FloatArray, IntArray, picked
from pcnav.perception.edge_crossings import EdgeCrossings
from pcnav.target.rendering import RenderedDepth

_MIN_PX, _CHANCE = 3, 1e-4
"""Gaps are no shorter, nor such as lone lost returns make more often than that."""
_MAX_PX = 64
_MAX_CUT_SHARE = 0.5
"""Of an edge whose returns end far inside over more than this share, the rest is no better."""


@dataclass(frozen=True)
class EdgeGaps:
    """Where nothing returns along a predicted edge, at n crossings of it."""

    length_px: FloatArray
    """(n,) inwards from the edge; 0 where it is none to speak of."""
    is_cut: BoolArray
    """(n,) where a stretch of an edge is missing that is seen elsewhere: straight edges are no
    shorter in one place than in another."""


def edge_gaps(
    crossings: EdgeCrossings,
    first: IntArray,
    depth_m: DepthImage,
    rendered: RenderedDepth,
    lost: BoolArray,
    usable: BoolArray,
    reach: int,
    dropout: float,
) -> EdgeGaps:
    """Gaps of a frame.

    Args:
        crossings: n of them.
        first: (n,) the first pixel inside each, along what is crossed.
        depth_m: (height, width) the frame.
        rendered: the view.
        lost: (n,) where that pixel did not return, before space.
        usable: (n,) crossings of which the view has what it takes to count at them.
        reach: as many pixels are counted.
        dropout: share of the returns that are lost at random.
    """
    by_chance = np.log(_CHANCE) / np.log(dropout) if dropout > 0.0 else 0.0
    length = np.zeros(len(first))
    if lost.any():
        length[lost] = _missing_px(picked(crossings, lost), first[lost], depth_m, rendered)
        length[length < max(_MIN_PX, by_chance)] = 0.0
    is_cut = length > reach
    size = int(crossings.edge.max(initial=0)) + 1
    cut, all_of_it = (
        np.bincount(crossings.edge[which], minlength=size) for which in (is_cut, usable | is_cut)
    )
    partly = cut <= _MAX_CUT_SHARE * all_of_it
    return EdgeGaps(length, is_cut & partly[crossings.edge])


def _missing_px(
    crossings: EdgeCrossings, first: IntArray, depth_m: DepthImage, rendered: RenderedDepth
) -> FloatArray:
    """(n,) how many pixels show nothing where a view has its part, from ``first`` (n,) inwards."""
    minor = first[:, None] + crossings.side[:, None] * np.arange(_MAX_PX)
    u, v = crossings.across(minor)
    height, width = depth_m.shape
    inside = (u >= 0) & (u < width) & (v >= 0) & (v < height)
    u, v = np.clip(u, 0, width - 1), np.clip(v, 0, height - 1)
    missing = inside & (depth_m[v, u] <= 0.0) & (rendered.triangle[v, u] >= 0)
    return np.asarray(np.cumprod(missing, axis=1).sum(axis=1), dtype=np.float64)
