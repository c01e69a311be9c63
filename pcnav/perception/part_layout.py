"""A part of a frame on the grid of the sampled views of a target, at turns in the image plane."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy import ndimage

from pcnav.core.arrays import BoolArray, DepthImage, FloatArray
from pcnav.core.camera import pixel_rays, project
from pcnav.core.spatial import exp_rotation
from pcnav.perception.regions import Region
from pcnav.perception.sampled_views import CELLS, looking_along, square_grid
from pcnav.recordings.sequence import Frame

_PADDING = 5
"""Cells about the grid, to shift it by."""
_TURNS = 30
_MAX_CLOUD = 3_000


@dataclass(frozen=True)
class PartCloud:
    """The returns of a part of a frame, seen along their mean ray."""

    points_cam: FloatArray
    """(n, 3) m."""
    mean_cam: FloatArray
    """(3,) of them."""
    R_ray_cam: FloatArray
    """(3, 3) z along the ray to the mean."""
    frame: Frame
    """The whole."""
    seen_past: BoolArray
    """(height, width) pixels of it at which nothing of the part is, nor may be."""

    @staticmethod
    def of(region: Region, whole: Frame) -> "PartCloud":
        """That of a region of a frame."""
        seen = region.frame.depth_m > 0.0
        depth = region.frame.depth_m[seen][:, None].astype(np.float64)
        points = pixel_rays(region.frame.camera)[seen] * depth
        points = points[:: -(-len(points) // _MAX_CLOUD)]
        # Between the returns of a part nothing is seen through, nor just beside them.
        hidden = ndimage.binary_dilation(seen, np.ones((3, 3), dtype=np.bool_))
        if region.frame.unseen is not None:
            hidden |= region.frame.unseen
        mean = points.mean(axis=0)
        return PartCloud(points, mean, looking_along(mean / np.linalg.norm(mean)), whole, ~hidden)

    def layout(self, cell_m: float) -> "PaddedLayout":
        """The part at all turns, on a grid that is wide enough to be shifted."""
        size = CELLS + 2 * _PADDING
        local = (self.points_cam - self.mean_cam) @ self.R_ray_cam.T
        # The mean over what is covered, not over returns, which crowd on what faces the sensor.
        occupied = np.unique(np.floor(local[:, :2] / cell_m).astype(int), axis=0)
        middle = (occupied + 0.5).mean(axis=0) * cell_m
        R = _turns()
        n, c = len(R), size**2
        about = np.einsum("tij,nj->tni", R[:, :2, :2], local[:, :2] - middle)
        index = np.floor(about / cell_m + 0.5 * size).astype(np.intp)
        inside = ((index >= 0) & (index < size)).all(axis=2)
        flat = index[..., 1] * size + index[..., 0] + c * np.arange(n)[:, None]
        z = np.broadcast_to(local[:, 2], inside.shape)
        count = np.bincount(flat[inside], minlength=n * c)
        total = np.bincount(flat[inside], z[inside], minlength=n * c)
        centre = R[:, :2, :2] @ middle
        square = (n, size, size)
        covered = (count > 0).reshape(square)
        cells = square_grid(size, cell_m) + centre[:, None]
        free = self._is_seen_past(R, cells).reshape(square) & ~covered
        depth = (total / np.maximum(count, 1)).reshape(square)
        return PaddedLayout(
            R_turned_ray=R,
            covered=covered.astype(np.float32),
            depth=depth.astype(np.float32),
            free=free.astype(np.float32),
            centre=centre,
        )

    def _is_seen_past(self, R: FloatArray, cells: FloatArray) -> BoolArray:
        """(t, c) whether the frame sees past the part at cells (t, c, 2) of each turn: space, or
        something behind it."""
        axes = R[:, :2, :2] @ self.R_ray_cam[:2]
        # One coordinate after the other: sums over short axes are slow.
        x, y, z = (
            cells[..., 0] * axes[:, :1, k] + cells[..., 1] * axes[:, 1:, k] + self.mean_cam[k]
            for k in range(3)
        )
        camera = self.frame.camera
        in_front = z > 1e-6 * self.mean_cam[2]
        z[~in_front] = np.inf
        pixel = np.rint(project(camera, np.stack([x, y, z], axis=-1)))
        u, v = pixel[..., 0], pixel[..., 1]
        inside = in_front & (u >= 0) & (u < camera.width) & (v >= 0) & (v < camera.height)
        past = np.zeros(inside.shape, dtype=np.bool_)
        past[inside] = self.seen_past[v[inside].astype(np.intp), u[inside].astype(np.intp)]
        return past


@lru_cache(maxsize=1)
def _turns() -> FloatArray:
    """(t, 3, 3) turns about the line of sight."""
    angles = 2.0 * np.pi * np.arange(_TURNS) / _TURNS
    return np.stack([exp_rotation(np.array([0.0, 0.0, angle])) for angle in angles])


@dataclass(frozen=True)
class PaddedLayout:
    """A part of a frame on a grid of s x s cells (rows y), at t turns."""

    R_turned_ray: FloatArray
    """(t, 3, 3)"""
    covered: DepthImage
    """(t, s, s)"""
    depth: DepthImage
    """(t, s, s) mean in each cell; 0 where not covered."""
    free: DepthImage
    """(t, s, s) 1 where the frame sees past the part."""
    centre: FloatArray
    """(t, 2) of the grid, turned ray axes, m."""

    def at(self, shift: tuple[int, int], turn_step: int, cell_m: float) -> "Layout":
        """Its inner part about a middle shifted by whole cells (x, y), at every so many turns."""
        x, y = _PADDING + shift[0], _PADDING + shift[1]
        part = (slice(None, None, turn_step), slice(y, y + CELLS), slice(x, x + CELLS))
        covered, depth, free = (
            grid[part].reshape(-1, CELLS**2) for grid in (self.covered, self.depth, self.free)
        )
        centre = self.centre[::turn_step] + np.array(shift) * cell_m
        return Layout(self.R_turned_ray[::turn_step], covered, depth, free, centre)


@dataclass(frozen=True)
class Layout:
    """A part of a frame on the grid of c cells, at t turns."""

    R_turned_ray: FloatArray
    """(t, 3, 3)"""
    covered: DepthImage
    """(t, c)"""
    depth: DepthImage
    """(t, c) mean in each cell; 0 where not covered."""
    free: DepthImage
    """(t, c) 1 where the frame sees past the part."""
    centre: FloatArray
    """(t, 2) of the grid, turned ray axes, m."""
