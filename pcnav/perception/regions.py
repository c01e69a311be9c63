"""Where in a frame the target may be: parts of the image whose returns are of its size.

A frame may show walls, a table, hands and other things besides the target. Whatever is flat over
more than the target's own flat faces is a support or a background and is taken out; what then hangs
together without a step in depth is an object. Objects of the target's size are candidates; larger
ones are looked at in pieces, smaller ones that lie together are joined, for something in front may
have cut the target in two. A frame in which nothing but the target returned is one region: itself.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage

from pcnav.core.arrays import BoolArray, FloatArray, IntArray
from pcnav.core.camera import PinholeCamera, pixel_rays
from pcnav.perception.image_parts import bounding_box, mask_of, part_sizes, parts_of
from pcnav.perception.surfaces import (
    SmoothFrame,
    extended_planes,
    extent,
    smooth_frame,
    squared_distances,
)
from pcnav.perception.surroundings import surroundings_of
from pcnav.recordings.sequence import Frame
from pcnav.target.satellite import Target

_WHOLE_FRACTION = 1.05
"""Returns that span less than this share of the diameter (besides their noise) may be all of one
target."""
_MIN_EXTENT_FRACTION = 0.2
_MAX_EXTENT_FRACTION = 1.3
"""What spans between these shares of the diameter may be the target. What exceeds it is another
thing, or touches one."""
_JOINED_EXTENT_FRACTION = 1.15
_WINDOW_RADIUS_FRACTION = 0.55
"""Of the balls, over the diameter, that larger objects are looked at in."""
_MAX_WINDOWS = 6
_MIN_RETURNS = 40
_MAX_REGIONS = 16
_SMOOTH_QUANTILE = 0.25
"""Of the pixels of a part, that look no rougher than its noise makes them."""
_FAR_QUANTILE = 0.98
_MIN_ADDED = 1.1
"""A joined region has so many times the returns of its largest part."""


@dataclass(frozen=True)
class Region:
    """A part of a frame that may be the target."""

    frame: Frame
    """The frame with this part alone: what is farther than it is space, what is nearer or beside
    it at its own depth hides whatever is behind."""
    extent_m: float
    """Of its returns, as the diameter of a ball about them."""
    n_returns: int
    sigma_m: float
    """Noise along the rays, as the smooth surfaces of the frame show it about there."""
    is_whole: bool = False
    """Whether it is the frame itself, and nothing else returned."""
    is_window: bool = False
    """Whether it was cut out of a larger object, whose other parts it may still hold."""

    @property
    def depths(self) -> FloatArray:
        """(n,) of its returns, m."""
        return np.asarray(self.frame.depth_m[self.frame.depth_m > 0.0])


@dataclass(frozen=True)
class RegionSearch:
    """The candidate regions of a frame, and what was left out."""

    regions: tuple[Region, ...]
    """The likeliest first."""
    span_m: float
    """Of all returns of the frame, as the diameter of a ball about them."""
    n_planes: int = 0
    """How many planes larger than the target's faces were taken out."""
    is_small: bool = False
    """Whether all returns span no more than the target does: little else can be in the frame."""


def candidate_regions(frame: Frame, target: Target, sigma_m: float) -> RegionSearch:
    """The parts of a frame that may be a target, by their size.

    Args:
        frame: any frame.
        target: what is looked for.
        sigma_m: noise along the ray, as far as known; what smooth surfaces show counts if larger.
    """
    seen = frame.depth_m > 0.0
    n = int(np.count_nonzero(seen))
    if n == 0:
        return RegionSearch((), 0.0)
    diameter_m = target.diameter_m
    span = extent(_points(frame, seen))
    is_small = span <= _WHOLE_FRACTION * diameter_m + 4.0 * sigma_m
    whole = Region(frame, span, n, sigma_m)
    # What comes in from the border of the image beside something that it does not cut may be an arm
    # before the target as well as a part of it.
    if is_small and surroundings_of(frame.depth_m, frame.camera, diameter_m, sigma_m) is None:
        return RegionSearch((replace(whole, is_whole=True),), span, is_small=True)
    smooth = smooth_frame(frame, sigma_m, diameter_m)
    on_plane, n_planes = extended_planes(smooth, target.flat_extent_m, diameter_m)
    labels = smooth.components((smooth.depth_m > 0.0) & ~on_plane)
    parts = _candidates(smooth, labels, diameter_m)
    seen_parts = [_Part.of(smooth, pixels, is_window) for pixels, is_window in parts]
    seen_parts.sort(key=lambda part: -_plausibility(part, diameter_m, frame.camera))
    regions = [whole] if is_small else []
    regions += [_region(frame, smooth, part) for part in seen_parts[:_MAX_REGIONS]]
    return RegionSearch(tuple(regions), span, n_planes, is_small)


def _points(frame: Frame, mask: BoolArray) -> FloatArray:
    return np.asarray(pixel_rays(frame.camera)[mask] * frame.depth_m[mask][:, None])


def _candidates(
    smooth: SmoothFrame, labels: IntArray, diameter_m: float
) -> list[tuple[IntArray, bool]]:
    """Pixels (n,), counted row after row, of what may be the target, and whether each is a
    window."""
    found: list[tuple[IntArray, bool]] = []
    fragments: list[IntArray] = []
    for part in parts_of(labels, _MIN_RETURNS):
        pixels = np.ravel_multi_index(part, labels.shape)
        size = extent(smooth.points[part])
        if size > _MAX_EXTENT_FRACTION * diameter_m:
            pieces = _pieces(smooth, pixels)
            whole = [p for p in pieces if _fits(extent(smooth.points_of(p)), diameter_m)]
            found += [(piece, False) for piece in whole]
            fragments += whole
            found += [(window, True) for window in _windows(smooth, pixels, diameter_m)]
        else:
            fragments.append(pixels)
            if _fits(size, diameter_m):
                found.append((pixels, False))
    found += [(pixels, False) for pixels in _joined(smooth, fragments, diameter_m)]
    return found


def _fits(size_m: float, diameter_m: float) -> bool:
    return _MIN_EXTENT_FRACTION <= size_m / diameter_m <= _MAX_EXTENT_FRACTION


def _pieces(smooth: SmoothFrame, pixels: IntArray) -> list[IntArray]:
    """The parts of an object between which it is creased inward, or steps a little."""
    mask = mask_of(pixels, smooth.depth_m.shape)
    labels = smooth.components(mask & ~smooth.concave)
    kept = part_sizes(labels) >= _MIN_RETURNS
    if np.count_nonzero(kept) < 2:
        return []
    # What lies in a crease belongs to the nearest part.
    box = bounding_box(mask)
    own = labels[box]
    _, nearest = ndimage.distance_transform_edt(~kept[own], return_indices=True)
    labels[box] = np.where(mask[box], own[tuple(nearest)], 0)
    return [np.ravel_multi_index(part, mask.shape) for part in parts_of(labels, 1)]


def _windows(smooth: SmoothFrame, pixels: IntArray, diameter_m: float) -> list[IntArray]:
    """Balls of the target's size about returns of an object that is larger."""
    cloud = smooth.points_of(pixels)
    radius = _WINDOW_RADIUS_FRACTION * diameter_m
    windows: list[IntArray] = []
    # What is nearest to the sensor stands before the rest.
    left = np.argsort(cloud[:, 2])
    while len(windows) < _MAX_WINDOWS and len(left):
        # The point lies on the near side of what is looked for: its ball is about the mean.
        about = squared_distances(cloud, cloud[left[0]]) < radius**2
        within = squared_distances(cloud, cloud[about].mean(axis=0)) < radius**2
        left = left[~(within | about)[left]]
        if np.count_nonzero(within) >= _MIN_RETURNS:
            windows.append(pixels[within])
    return windows


def _joined(
    smooth: SmoothFrame, fragments: Sequence[IntArray], diameter_m: float
) -> list[IntArray]:
    """Fragments that lie within one diameter of each other, as one: the target may be cut."""
    order = sorted(fragments, key=len, reverse=True)
    clouds = [smooth.points_of(pixels) for pixels in order]
    centres = np.array([cloud.mean(axis=0) for cloud in clouds])
    found: list[IntArray] = []
    for k, first in enumerate(order[:_MAX_REGIONS]):
        chosen, cloud = [first], clouds[k]
        apart = np.linalg.norm(centres - centres[k], axis=1)
        for j in np.argsort(apart)[1:].tolist():
            if apart[j] > diameter_m:
                break
            both = np.concatenate([cloud, clouds[j]])
            if extent(both) <= _JOINED_EXTENT_FRACTION * diameter_m:
                chosen, cloud = [*chosen, order[j]], both
        if len(cloud) < _MIN_ADDED * len(first) or not _fits(extent(cloud), diameter_m):
            continue
        union = np.sort(np.concatenate(chosen))
        if not any(np.array_equal(union, other) for other in found):
            found.append(union)
    return found


@dataclass(frozen=True)
class _Part:
    """What a region is made of."""

    pixels: IntArray
    """(n,) of its returns, counted row after row."""
    depths: FloatArray
    """(n,)"""
    extent_m: float
    is_window: bool

    @staticmethod
    def of(smooth: SmoothFrame, pixels: IntArray, is_window: bool) -> "_Part":
        pixels = pixels[smooth.trusted.ravel()[pixels]]
        points = smooth.points_of(pixels)
        return _Part(pixels, points[:, 2], extent(points), is_window)


def _region(frame: Frame, smooth: SmoothFrame, part: _Part) -> Region:
    """A part of a frame as a frame of its own."""
    # A few returns of what is behind may cling to its rim.
    far = float(np.quantile(part.depths, _FAR_QUANTILE))
    mask = mask_of(part.pixels, frame.depth_m.shape)
    beside = (frame.depth_m > 0.0) & (frame.depth_m < far) & ~mask
    unseen = beside if frame.unseen is None else beside | frame.unseen
    depth_m = np.where(mask, frame.depth_m, np.float32(0.0))
    alone = replace(frame, depth_m=depth_m, unseen=unseen)
    # Edges within a small part make most of it look rough; noise is everywhere.
    sigma_m = float(np.quantile(smooth.sigma_m.ravel()[part.pixels], _SMOOTH_QUANTILE))
    return Region(alone, part.extent_m, len(part.depths), sigma_m, is_window=part.is_window)


def _plausibility(part: _Part, diameter_m: float, camera: PinholeCamera) -> float:
    """Larger for what covers about the solid angle that the target would, at its own distance."""
    ratio = part.extent_m / diameter_m
    size = np.exp(-((np.log(max(ratio, 1e-3) / 0.85) / 0.5) ** 2))
    across_px = camera.fx * diameter_m / float(np.median(part.depths))
    cover = len(part.depths) / max(across_px**2, 1.0)
    return float(size * min(cover, 0.5) * (0.5 if part.is_window else 1.0))
