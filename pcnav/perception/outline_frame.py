"""A frame as the outline of a target is read in it, where it holds more than the target.

An edge before space is told by returns that end at it. One before a wall is told as well, once what
is known to lie behind it is taken for space. Beside a table that the target stands on, a hand that
holds it, or a hole in the returns of a frame that is full of them, an edge says nothing.
"""

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from pcnav.core.arrays import BoolArray, DepthImage
from pcnav.perception.surroundings import Surroundings
from pcnav.target.rendering import RenderedDepth

_MARGIN_PX = 3
"""Beyond the pixels that edges are counted at, so much of what lies beside them is looked at."""
_PATCH_PX, _PATCH_SHARE = 5, 0.6
"""A pixel without a return is no lone dropout where so many about it have none, either."""
_ABOUT_PX = 41
_SPACE_SHARE = 0.5
"""No return is space where so many of the pixels about it that show no target have none."""


@dataclass(frozen=True)
class OutlineFrame:
    """A frame beside a view of the target."""

    depth_m: DepthImage
    """(height, width) 0 where nothing returned, and where what did lies behind the target."""
    unknown: BoolArray
    """(height, width) where what is seen may hide, touch or go on with the target."""


def outline_frame(
    depth_m: DepthImage,
    rendered: RenderedDepth,
    surroundings: Surroundings | None,
    tolerance_m: float,
    reach_px: int,
    unseen: BoolArray | None = None,
) -> OutlineFrame | None:
    """The frame for the outline of a view; None where it is the frame itself.

    Args:
        depth_m: (height, width) the frame.
        rendered: the view.
        surroundings: the parts of the frame, where it holds more than the target.
        tolerance_m: returns so near to a predicted surface belong to it.
        reach_px: the outline may be so far from where it is predicted.
        unseen: (height, width) pixels of which nothing is known.
    """
    if surroundings is None:
        return None if unseen is None else OutlineFrame(depth_m, unseen)
    nothing = np.zeros(depth_m.shape, dtype=np.bool_)
    cleared, unknown = depth_m.copy(), nothing if unseen is None else unseen.copy()
    # Lone returns are false ones: where they are, nothing is known to have returned.
    cleared[surroundings.labels == 0] = 0.0
    margin = reach_px + _MARGIN_PX
    part = _widened(rendered, margin)
    surface = rendered.triangle[part] >= 0
    if not surface.any():
        return OutlineFrame(cleared, unknown)
    seen, predicted = cleared[part], rendered.depth_m[part]
    returned = seen > 0.0
    width = 2 * margin + 1
    farthest = ndimage.maximum_filter(np.where(surface, predicted, 0.0), width)
    nearest = ndimage.minimum_filter(np.where(surface, predicted, np.inf), width)
    # Surfaces that end there may be inclined: displaced, they would be seen farther than they are.
    beside = farthest > 0.0
    with np.errstate(invalid="ignore"):
        bound = farthest + (farthest - nearest) + tolerance_m
    behind = returned & beside & (seen > bound)
    # What is no part of the view so far from it is no displaced rim of the target.
    off = ~ndimage.binary_dilation(surface, iterations=reach_px) & beside
    attached = off & returned & ~behind
    # So, displaced, may faces that are seen at grazing incidence appear nearer than predicted.
    steepest = ndimage.grey_dilation(predicted, (3, 3)) - ndimage.grey_erosion(predicted, (3, 3))
    before = np.where(steepest > tolerance_m, nearest, predicted) - tolerance_m
    hiding = surface & returned & (seen < before)
    hidden = ndimage.binary_dilation(attached | hiding, iterations=reach_px + 1)
    unknown[part] |= hidden | _holes(returned, surface, reach_px)
    cleared[part] = np.where(behind, 0.0, seen)
    return OutlineFrame(cleared, unknown)


def _holes(returned: BoolArray, surface: BoolArray, reach_px: int) -> BoolArray:
    """Patches without returns that begin inside the view, where there is no space about it: the
    sensor sees nothing of that surface, and where the target ends is not told.

    A patch beside the view alone is the shadow that a sensor with a baseline leaves behind whatever
    is near: the target ends where its returns do.
    """
    missing = (~returned).astype(np.float32)
    patch = ndimage.uniform_filter(missing, _PATCH_PX, mode="nearest") > _PATCH_SHARE
    # Sensors that match or modulate lose the pixels along a step in depth: a strip of them is no
    # patch, and what lies beyond it is known.
    patch &= ndimage.binary_opening(~returned, np.ones((_PATCH_PX, _PATCH_PX), dtype=np.bool_))
    # At its corners a patch is no patch.
    patch = ~returned & ndimage.binary_dilation(patch, iterations=_PATCH_PX // 2)
    other = ndimage.uniform_filter((~surface).astype(np.float32), _ABOUT_PX)
    empty = ndimage.uniform_filter((~surface & ~returned).astype(np.float32), _ABOUT_PX)
    patch &= empty < _SPACE_SHARE * other
    inside = ndimage.binary_erosion(surface, iterations=reach_px + 1)
    return np.asarray(ndimage.binary_propagation(patch & inside, mask=patch))


def _widened(rendered: RenderedDepth, margin: int) -> tuple[slice, slice]:
    rows, columns = rendered.window
    height, width = rendered.depth_m.shape
    return (
        slice(max(rows.start - margin, 0), min(rows.stop + margin, height)),
        slice(max(columns.start - margin, 0), min(columns.stop + margin, width)),
    )
