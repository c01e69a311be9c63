"""The part of a depth frame that may be the target, as a user knows it beforehand."""

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy import ndimage

from pcnav.core.arrays import BoolArray, DepthImage, FloatArray
from pcnav.core.camera import PinholeCamera, range_per_depth
from pcnav.core.errors import InputError
from pcnav.recordings.sequence import Frame

_MARGIN_SIGMA = 4.0
"""A return so many deviations nearer than the background is no part of it."""
_MEDIAN_OF_HALF_NORMAL = 0.6745
_MAX_BINS = 8
_MIN_IN_BIN = 200
"""Pixels by which the noise at a depth is told."""
_ABOUT_PX = 3
"""A return is compared with the nearest background about it: depth edges move by a pixel."""


@dataclass(frozen=True)
class Background:
    """Depths of a scene without the target."""

    depth_m: DepthImage
    """(height, width) z-depth, m; 0 = no return."""

    @cached_property
    def _nearest_m(self) -> FloatArray:
        """(height, width) nearest depth about each pixel, infinite where there is none."""
        known = np.where(self.depth_m > 0.0, self.depth_m, np.inf)
        return np.asarray(ndimage.minimum_filter(known, _ABOUT_PX, mode="nearest"))

    def holds(self, depth_m: DepthImage) -> BoolArray:
        """(height, width) returns that are not nearer than the background by a margin.

        The margin is four deviations of the noise of both images, which is learnt from the returns
        that are farther than the background: the target hides it and only makes returns nearer.
        Where the background has no return, none is part of it.
        """
        both = (depth_m > 0.0) & (self.depth_m > 0.0)
        margin = np.zeros_like(depth_m)
        margin[both] = _margins(self.depth_m[both], depth_m[both])
        return np.asarray(both & (depth_m >= self._nearest_m - margin))


@dataclass(frozen=True)
class Region:
    """What a frame is restricted to; by default nothing is."""

    mask: BoolArray | None = None
    """(height, width) pixels that show the target."""
    min_range_m: float = 0.0
    """Near gate, along the ray."""
    max_range_m: float = math.inf
    """Far gate, along the ray."""
    box_px: tuple[int, int, int, int] | None = None
    """First column and row that belong to it, and first column and row that do not any more."""
    background: Background | None = None

    @property
    def is_everything(self) -> bool:
        """Whether it restricts nothing."""
        gated = self.min_range_m > 0.0 or self.max_range_m < math.inf
        others = (self.mask, self.box_px, self.background)
        return not gated and all(other is None for other in others)


def restricted(frame: Frame, region: Region) -> Frame:
    """A frame in which only a region may hold returns.

    Beyond the far gate and at the background its depth is 0: nothing is there. So it is outside the
    mask, but what returned there is kept as `masked_m`. Pixels outside the box and nearer than the
    near gate are `unseen`. Raises `InputError` for a
    mask or background of another size, and for a box outside the image.
    """
    if region.is_everything:
        return frame
    _require_fit(frame, region)
    depth_m = frame.depth_m.copy()
    unseen = _outside(frame.camera, region.box_px)
    if region.min_range_m > 0.0 or region.max_range_m < math.inf:
        range_m = depth_m * range_per_depth(frame.camera)
        unseen |= (range_m > 0.0) & (range_m < region.min_range_m)
        depth_m[range_m > region.max_range_m] = 0.0
    if region.background is not None:
        depth_m[region.background.holds(depth_m)] = 0.0
    masked_m = frame.masked_m
    if region.mask is not None:
        left_out = np.where(region.mask, np.float32(0.0), depth_m)
        masked_m = left_out if masked_m is None else np.maximum(masked_m, left_out)
        depth_m[~region.mask] = 0.0
    if frame.unseen is not None:
        unseen |= frame.unseen
    depth_m[unseen] = 0.0
    unseen_or_none = unseen if unseen.any() else None
    return replace(frame, depth_m=depth_m, unseen=unseen_or_none, masked_m=masked_m)


def _outside(camera: PinholeCamera, box_px: tuple[int, int, int, int] | None) -> BoolArray:
    outside = np.full((camera.height, camera.width), box_px is not None)
    if box_px is not None:
        u0, v0, u1, v1 = box_px
        outside[v0:v1, u0:u1] = False
    return outside


def _require_fit(frame: Frame, region: Region) -> None:
    where, camera = f"frame {frame.index}", frame.camera
    images = {
        "mask": region.mask,
        "background": None if region.background is None else region.background.depth_m,
    }
    for field, image in images.items():
        if image is not None and image.shape != (camera.height, camera.width):
            expected = f"expected {camera.height} rows of {camera.width}, as the frame has"
            raise InputError(where, field, f"{expected}, got an array of shape {image.shape}")
    if region.mask is not None and region.mask.dtype != np.bool_:
        raise InputError(where, "mask", f"expected truth values, got {region.mask.dtype}")
    if region.box_px is not None:
        u0, v0, u1, v1 = region.box_px
        if not (0 <= u0 < u1 and 0 <= v0 < v1 and u0 < camera.width and v0 < camera.height):
            expected = f"expected pixels of an image of {camera.width} x {camera.height}"
            raise InputError(where, "box_px", f"{expected}, got {u0} {v0} {u1} {v1}")


def _margins(background_m: DepthImage, depth_m: DepthImage) -> FloatArray:
    """(n,) m by which returns may be nearer than a background (n,) and still be part of it.

    Noise grows with depth, by a law that nobody states: it is told in bins of as many pixels each,
    by depth of the background.
    """
    order = np.argsort(background_m, kind="stable")
    margins = np.zeros(len(order))
    bins = max(min(_MAX_BINS, len(order) // _MIN_IN_BIN), 1)
    for bin_ in np.array_split(order, bins):
        farther = depth_m[bin_] - background_m[bin_]
        farther = farther[farther > 0.0]
        if farther.size:
            margins[bin_] = _MARGIN_SIGMA * np.median(farther) / _MEDIAN_OF_HALF_NORMAL
    return margins
