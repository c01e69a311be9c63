"""The beams of a scan, laid over the pixels of a camera.

A scan looks along rays of its own, each at a time of its own. Laid over the grid of a pinhole that
stands in the sensor, it is an image as well: a pixel shows the beam nearest to its centre, and its
depth is that of the beam's return. Where no beam fell nothing is known.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy import ndimage

from pcnav.core.arrays import BoolArray, DepthImage, FloatArray, IntArray
from pcnav.core.camera import PinholeCamera, pixel_rays, project

_MAX_SLICES = 1024
"""That a scan's time is told in: in half a second a rim that moves at 1 m/s moves 0.25 mm in one of
them."""
_ON_GRID_PX = 0.02
"""Beams that meet the pixel centres so well see an outline where the pixels would."""
_IN_TURN = 0.15
"""Neighbours are seen one soon after the other within this share of a scan: of beams in no order
they are 0.3 of it apart."""


@dataclass(frozen=True, eq=False)
class Beams:
    """Those of one scan that meet the grid of a camera (n of them)."""

    rays: FloatArray
    """(n, 3) camera frame, scaled to z = 1."""
    depth_m: FloatArray
    """(n,) z-depth of their returns; 0 = none."""
    time_s: FloatArray
    """(n,) when they were seen, from the time of the frame on."""
    pixel: IntArray
    """(n,) in which pixel they fall, counted row after row."""
    shown: IntArray
    """(height, width) the beam that a pixel shows; -1 where none fell."""

    @cached_property
    def is_seen(self) -> BoolArray:
        """(height, width) pixels that a beam fell in."""
        return np.asarray(self.shown >= 0)

    @property
    def takes_time(self) -> bool:
        """Whether they were seen one after the other."""
        return len(self.slice_times_s) > 1

    @property
    def reach_s(self) -> float:
        """How far from the time of the frame they were seen."""
        return float(np.abs(self.time_s).max(initial=0.0))

    @cached_property
    def image(self) -> DepthImage:
        """(height, width) z-depth of the beams shown, m; 0 = no return, or none known."""
        depth = np.zeros(self.shown.shape, dtype=np.float32)
        depth[self.is_seen] = self.depth_m[self.shown[self.is_seen]]
        return depth

    def image_rays(self, camera: PinholeCamera) -> FloatArray:
        """(height, width, 3) of the beams shown, z = 1; through the centres of other pixels."""
        rays = pixel_rays(camera).copy()
        rays[self.is_seen] = self.rays[self.shown[self.is_seen]]
        return rays

    @cached_property
    def slice_times_s(self) -> FloatArray:
        """(m,) the times that are told apart."""
        times = np.unique(self.time_s)
        if len(times) == 0:
            return np.zeros(1)
        if len(times) <= _MAX_SLICES:
            return times
        return np.linspace(times[0], times[-1], _MAX_SLICES)

    @cached_property
    def slice(self) -> IntArray:
        """(n,) which of them a beam was seen at."""
        times = self.slice_times_s
        middles = 0.5 * (times[1:] + times[:-1])
        return np.searchsorted(middles, self.time_s).astype(np.intp)

    @cached_property
    def slice_image(self) -> IntArray:
        """(height, width) that of the beams shown; of other pixels as of the nearest one."""
        if not self.is_seen.any():
            return np.zeros(self.shown.shape, dtype=np.intp)
        shown = self.shown
        if not self.is_seen.all():
            v, u = ndimage.distance_transform_edt(
                ~self.is_seen, return_distances=False, return_indices=True
            )
            shown = shown[v, u]
        return self.slice[shown]

    def shows_outline(self, camera: PinholeCamera) -> bool:
        """Whether an outline is seen in it as in an image: the beams are the pixels' own rays, and
        neighbours were seen one soon after the other."""
        off = project(camera, self.rays) - np.column_stack(
            np.divmod(self.pixel, camera.width)[::-1]
        )
        if not len(off) or np.abs(off).max() > _ON_GRID_PX:
            return False
        span_s = float(np.ptp(self.time_s))
        both = self.is_seen[1:] & self.is_seen[:-1]
        time_s = self.slice_times_s[self.slice_image]
        return bool(
            span_s == 0.0 or np.median(np.abs(np.diff(time_s, axis=0))[both]) < _IN_TURN * span_s
        )

    def strided(self, stride: int) -> "Beams":
        """Those in every so many pixels, as a smaller camera in the same place would see them."""
        if stride == 1:
            return self
        width = self.shown.shape[1]
        v, u = np.divmod(self.pixel, width)
        kept = (v % stride == 0) & (u % stride == 0)
        number = np.full(len(self.pixel) + 1, -1)
        number[:-1][kept] = np.arange(np.count_nonzero(kept))
        shown = number[self.shown[::stride, ::stride]]
        pixel = (v[kept] // stride) * shown.shape[1] + u[kept] // stride
        return Beams(self.rays[kept], self.depth_m[kept], self.time_s[kept], pixel, shown)

    def within(self, depth_m: DepthImage) -> "Beams":
        """Without the returns in pixels whose own was taken out of an image (height, width)."""
        gone = (self.image > 0.0) & (depth_m <= 0.0)
        if not gone.any():
            return self
        return replace(self, depth_m=np.where(gone.ravel()[self.pixel], 0.0, self.depth_m))


def beams_on(
    camera: PinholeCamera, rays: FloatArray, range_m: FloatArray, time_s: FloatArray
) -> Beams:
    """Beams laid over a camera; those that miss it are left out.

    Args:
        camera: whose frame it is.
        rays: (n, 3) camera frame, scaled to z = 1.
        range_m: (n,) along them; 0 = no return.
        time_s: (n,) from the time of the frame on.
    """
    place = project(camera, rays)
    nearest = np.rint(place)
    kept = ((nearest >= 0) & (nearest < [camera.width, camera.height])).all(axis=1)
    rays, nearest, range_m, time_s = rays[kept], nearest[kept], range_m[kept], time_s[kept]
    off = np.sum((place[kept] - nearest) ** 2, axis=1)
    pixel = (nearest[:, 1] * camera.width + nearest[:, 0]).astype(np.intp)
    # Which beam a pixel shows depends on where they look, not on what they return.
    order = np.lexsort((off, pixel))
    first = np.flatnonzero(np.diff(pixel[order], prepend=-1))
    shown = np.full(camera.height * camera.width, -1, dtype=np.intp)
    shown[pixel[order][first]] = order[first]
    depth_m = range_m / np.linalg.norm(rays, axis=1)
    return Beams(rays, depth_m, time_s, pixel, shown.reshape(camera.height, camera.width))
