"""What of a frame can be a target of known size, whatever its pose; the rest is its surroundings.

Returns are joined to parts wherever neighbours differ by less in depth than a surface that is not
seen at grazing incidence makes them. A part that is larger than the target, or that the border of
the image cuts, is a wall, a table, an arm: a target may stand before it or touch it, but what is
seen of it says nothing against a pose. Lone returns whose neighbours lie elsewhere are false ones.
"""

from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
import numpy.typing as npt

from pcnav.core.arrays import BoolArray, DepthImage, FloatArray, IntArray, neighbours
from pcnav.core.camera import PinholeCamera, pixel_rays
from pcnav.perception.image_parts import connected_parts, part_sizes

_NOISE_SIGMA = 6.0
"""Neighbours on one surface differ by less than so many standard deviations of the noise ..."""
_MAX_SLOPE = 4.0
"""... and by what a surface inclined so steeply (76 degrees) spans from pixel to pixel."""
_SIZE_SLACK = 0.05
"""A part is larger than the target when it exceeds its diameter by this share, and the noise."""
_TAIL_SIGMA = 8.0
"""The noise of the nearest and farthest of many returns, together."""
_MIN_PART_PIXELS = 4
"""Fewer joined returns are false ones, or too few to tell."""
_CLAIMED = 0.1
"""A part is taken for the target's by a view that explains this share of it."""
_MAX_PIXELS = 100_000
"""Larger images are joined on every second (third, ...) pixel."""

Pixel = TypeVar("Pixel", bound=np.generic)


@dataclass(frozen=True)
class Surroundings:
    """The parts of a frame that holds more than its target."""

    labels: IntArray
    """(height, width) part of each return, from 1 on; 0 for no return and for lone ones."""
    is_small: BoolArray
    """(n + 1,) whether each part is no larger than the target; the first, of no part, is not."""
    is_cut: BoolArray
    """(n + 1,) whether the border of the image cuts it."""
    sizes: IntArray
    """(n + 1,) pixels of each."""
    diameter_m: float
    """Of the target."""

    def strided(self, stride: int) -> "Surroundings":
        """The same on every so many pixels: what is one part or several, large or cut, is told
        better on all of them."""
        if stride == 1:
            return self
        labels = self.labels[::stride, ::stride]
        sizes = np.bincount(labels.ravel(), minlength=len(self.sizes))
        return replace(self, labels=labels, sizes=sizes)

    @property
    def candidates(self) -> BoolArray:
        """(height, width) returns that may be the target's by the size of their part."""
        return np.asarray((self.is_small & ~self.is_cut)[self.labels])

    def candidates_where(self, agrees: BoolArray, part: tuple[slice, slice]) -> BoolArray:
        """(height, width) the same beside a view that agrees with some pixels of a part of the
        image: a small part that the border cuts is the target's where the view takes it so."""
        counts = np.bincount(self.labels[part][agrees], minlength=len(self.sizes))
        claimed = counts > _CLAIMED * self.sizes
        return np.asarray((self.is_small & (~self.is_cut | claimed))[self.labels])


def surroundings_of(
    depth_m: DepthImage, camera: PinholeCamera, diameter_m: float, sigma_m: float
) -> Surroundings | None:
    """The parts of a frame; None where all its returns may be those of one target.

    They are no larger than it together then, and nothing that the border cuts lies beside something
    that it does not cut.

    Args:
        depth_m: (height, width), 0 where nothing returned.
        camera: that took it.
        diameter_m: of the target.
        sigma_m: range noise.
    """
    limit_m = (1.0 + _SIZE_SLACK) * diameter_m + _TAIL_SIGMA * sigma_m
    returned = depth_m > 0.0
    may_be_alone = _extent(depth_m, returned, camera) <= limit_m
    if may_be_alone and not any(edge.any() for edge in _border(returned)):
        return None
    stride = int(np.ceil(np.sqrt(depth_m.size / _MAX_PIXELS)))
    part_m, seen = depth_m[::stride, ::stride], returned[::stride, ::stride]
    labels, n = _joined(part_m, seen, camera.strided(stride), sigma_m)
    is_small, is_cut = np.zeros(n + 1, dtype=np.bool_), np.zeros(n + 1, dtype=np.bool_)
    if n:
        is_small[1:] = _extents(part_m, labels, n, camera.strided(stride)) <= limit_m
        is_cut[np.concatenate(_border(labels))] = True
        is_cut[0] = False
    if may_be_alone and (is_cut[1:].all() or not is_cut.any()):
        return None
    if stride > 1:
        labels = _spread(labels, part_m, depth_m, camera, sigma_m, stride)
    sizes = np.bincount(labels.ravel(), minlength=n + 1)
    return Surroundings(labels, is_small, is_cut, sizes, diameter_m)


def _border(image: BoolArray | IntArray) -> tuple[BoolArray | IntArray, ...]:
    return image[0], image[-1], image[:, 0], image[:, -1]


class SurroundingsFinder:
    """Finds the surroundings of a target; those of the last frame are kept."""

    def __init__(self, diameter_m: float) -> None:
        self._diameter_m = diameter_m
        self._last: tuple[DepthImage, dict[int, Surroundings | None]] | None = None

    def of(
        self, depth_m: DepthImage, camera: PinholeCamera, sigma_m: float, stride: int = 1
    ) -> Surroundings | None:
        """See `surroundings_of`; of all pixels, then on every so many of them.

        Asked several times for one and the same array, it looks once.
        """
        if self._last is None or self._last[0] is not depth_m:
            whole = surroundings_of(depth_m, camera, self._diameter_m, sigma_m)
            self._last = depth_m, {1: whole}
        found = self._last[1]
        if stride not in found:
            found[stride] = None if found[1] is None else found[1].strided(stride)
        return found[stride]


def _extent(depth_m: DepthImage, returned: BoolArray, camera: PinholeCamera) -> float:
    """Largest extent along an axis of the camera of all returns, m; 0 without any."""
    z = depth_m[returned]
    if not len(z):
        return 0.0
    rays = pixel_rays(camera)
    return max(float(np.ptp(rays[..., axis][returned] * z)) for axis in range(3))


def _joined(
    depth_m: DepthImage, returned: BoolArray, camera: PinholeCamera, sigma_m: float
) -> tuple[IntArray, int]:
    """(height, width) part of each pixel and the number of parts."""
    pixel_rad = 1.0 / min(camera.fx, camera.fy)
    near = (_NOISE_SIGMA * sigma_m + _MAX_SLOPE * pixel_rad * depth_m).astype(np.float32)
    lone = returned & (_alike(depth_m, returned, near) < 2)
    kept = returned & ~lone
    # A pixel without a return, or with a false one, parts nothing.
    bridges = [
        _linked(depth_m, kept, 2.0 * near, 2, axis) & ~kept[middle]
        for axis, middle in enumerate(((slice(1, -1), slice(None)), (slice(None), slice(1, -1))))
    ]
    right, down = (_linked(depth_m, kept, near, 1, axis) for axis in (1, 0))
    labels = connected_parts(kept, right, down, bridges)
    large = part_sizes(labels) >= _MIN_PART_PIXELS
    number = np.cumsum(large) * large
    return np.asarray(number[labels], dtype=np.intp), int(large.sum())


def _linked(
    depth_m: DepthImage, returned: BoolArray, near: DepthImage, step: int, axis: int
) -> BoolArray:
    """Whether each pixel and the one so many steps on along an axis show one surface."""
    here, there = neighbours(axis, step)
    apart = np.abs(depth_m[here] - depth_m[there])
    alike = apart < np.minimum(near[here], near[there])
    return np.asarray(alike & returned[here] & returned[there])


def _alike(depth_m: DepthImage, returned: BoolArray, near: DepthImage) -> IntArray:
    """(height, width) how many of the pixels up to two away along the axes lie at its depth."""
    count = np.zeros(depth_m.shape, dtype=np.intp)
    for axis in (0, 1):
        for step in (1, 2):
            here, there = neighbours(axis, step)
            linked = _linked(depth_m, returned, step * near, step, axis)
            count[here] += linked
            count[there] += linked
    return count


def _extents(depth_m: DepthImage, labels: IntArray, n: int, camera: PinholeCamera) -> FloatArray:
    """(n,) largest extent along an axis of the camera of each part, m."""
    seen = labels > 0
    of = labels[seen]
    order = np.argsort(of, kind="stable")
    starts = np.searchsorted(of[order], np.arange(1, n + 1))
    z, rays = depth_m[seen][order], pixel_rays(camera)
    largest = np.zeros(n)
    for axis in range(3):
        along = rays[..., axis][seen][order] * z
        span = np.maximum.reduceat(along, starts) - np.minimum.reduceat(along, starts)
        largest = np.maximum(largest, span)
    return largest


def _spread(
    labels: IntArray,
    coarse_m: DepthImage,
    depth_m: DepthImage,
    camera: PinholeCamera,
    sigma_m: float,
    stride: int,
) -> IntArray:
    """(height, width) labels of all pixels from those of every so many: of the one before, or the
    one after, at their depth."""
    near = _NOISE_SIGMA * sigma_m + _MAX_SLOPE * stride * depth_m / min(camera.fx, camera.fy)
    alike = (depth_m > 0.0) & (np.abs(_enlarged(coarse_m, stride, depth_m.shape) - depth_m) < near)
    found = np.where(alike, _enlarged(labels, stride, depth_m.shape), 0)
    # Few are not like the one before.
    v, u = np.nonzero((found == 0) & (depth_m > 0.0))
    seen, near = depth_m[v, u], near[v, u]
    for down, right in ((1, 0), (0, 1), (1, 1)):
        i = np.minimum(v // stride + down, labels.shape[0] - 1)
        j = np.minimum(u // stride + right, labels.shape[1] - 1)
        fits = (found[v, u] == 0) & (np.abs(coarse_m[i, j] - seen) < near)
        found[v[fits], u[fits]] = labels[i[fits], j[fits]]
    return np.asarray(found)


def _enlarged(image: npt.NDArray[Pixel], stride: int, shape: tuple[int, ...]) -> npt.NDArray[Pixel]:
    """(height, width) the pixel before each of an image, from every so many."""
    rows = np.repeat(image, stride, axis=0)[: shape[0]]
    return np.asarray(np.repeat(rows, stride, axis=1)[:, : shape[1]])
