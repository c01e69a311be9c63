"""The returns of one depth frame as flat arrays, cut to the window that the target fills."""

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from pcnav.core.arrays import BoolArray, FloatArray, IntArray
from pcnav.core.camera import pixel_rays, range_per_depth, solid_angle
from pcnav.recordings.sequence import Frame

_MAX_SMOOTHING_PX = 4
"""Half the width of the largest square averaged over."""
_MIN_SHARE = 0.6
_MARGIN_PX = 2
"""Pixels kept around the returns, so that every return has its neighbours inside the window."""


@dataclass(frozen=True)
class Window:
    """All pixels of the smallest image window that holds every return (n = height * width)."""

    top: int
    left: int
    height: int
    width: int
    touches_border: tuple[bool, bool, bool, bool]
    """Whether top, bottom, left, right of the window are the image's own border."""
    rays: FloatArray
    """(n, 3) unit rays, camera frame."""
    solid_angle: FloatArray
    """(n,) sr."""
    range_m: FloatArray
    """(n,) range along the ray; 0 where no return came back."""

    @property
    def shape(self) -> tuple[int, int]:
        """(height, width)."""
        return (self.height, self.width)

    @property
    def part(self) -> tuple[slice, slice]:
        """Rows and columns of the image that the window covers."""
        return (
            slice(self.top, self.top + self.height),
            slice(self.left, self.left + self.width),
        )

    @property
    def has_return(self) -> BoolArray:
        """(n,) pixels with a return."""
        return self.range_m > 0.0

    def pixel(self, flat_index: IntArray) -> IntArray:
        """(..., 2) image coordinates (u, v) of flat window indices."""
        v, u = np.divmod(flat_index, self.width)
        return np.stack([u + self.left, v + self.top], axis=-1)


def smoothing_size(window: Window, sigma_m: float) -> int:
    """Width, pixels (odd), of the square to average over so that noise falls to half a footprint.

    Below that the spacing of the points, not their noise, is what blurs a plane's edges.
    """
    seen = window.has_return
    footprint_m = float(np.mean(window.range_m[seen] * np.sqrt(window.solid_angle[seen])))
    half = max(0.0, sigma_m / (0.5 * footprint_m) - 1.0) / 2.0
    return 1 + 2 * min(int(np.ceil(half)), _MAX_SMOOTHING_PX)


def smoothed_points(window: Window, size: int) -> FloatArray:
    """(n, 3) points of the returns averaged over squares of ``size`` pixels, camera frame, m.

    On a plane 1/z is linear in the ray's coordinates (at z = 1), so the means of both, over
    whichever pixels of the square have a return, lie exactly on the plane. Returns with less than
    60 % of their square are left out.
    """
    seen = window.has_return
    rays = window.rays[:, :2] / window.rays[:, 2:]
    inverse_depth = np.zeros(len(seen))
    inverse_depth[seen] = 1.0 / (window.range_m[seen] * window.rays[seen, 2])
    layers = np.stack([seen, rays[:, 0] * seen, rays[:, 1] * seen, inverse_depth])
    layers = layers.reshape(4, *window.shape)
    means = ndimage.uniform_filter(layers, size=(1, size, size), mode="constant").reshape(4, -1)
    kept = means[:, seen & (means[0] > _MIN_SHARE)]
    return np.asarray(np.column_stack([kept[1], kept[2], kept[0]]) / kept[3][:, None])


def returns_of(frame: Frame) -> FloatArray:
    """(n, 3) points of a frame's returns, camera frame, m; of a scan all of them, as they were."""
    if frame.beams is not None:
        beams = frame.beams.within(frame.depth_m)
        seen = beams.depth_m > 0.0
        return np.asarray(beams.rays[seen] * beams.depth_m[seen, None])
    window = window_of_returns(frame)
    if window is None:
        return np.empty((0, 3))
    seen = window.has_return
    return np.asarray(window.rays[seen] * window.range_m[seen, None])


def window_of_returns(frame: Frame) -> Window | None:
    """The window of a frame's returns, or None when nothing came back."""
    seen = frame.depth_m > 0.0
    rows = np.flatnonzero(seen.any(axis=1))
    if rows.size == 0:
        return None
    columns = np.flatnonzero(seen.any(axis=0))
    height, width = frame.depth_m.shape
    top, bottom = max(rows[0] - _MARGIN_PX, 0), min(rows[-1] + _MARGIN_PX + 1, height)
    left, right = max(columns[0] - _MARGIN_PX, 0), min(columns[-1] + _MARGIN_PX + 1, width)
    part = (slice(top, bottom), slice(left, right))
    per_depth = range_per_depth(frame.camera)[part]
    return Window(
        top=int(top),
        left=int(left),
        height=int(bottom - top),
        width=int(right - left),
        touches_border=(top == 0, bottom == height, left == 0, right == width),
        rays=(pixel_rays(frame.camera)[part] / per_depth[..., None]).reshape(-1, 3),
        solid_angle=solid_angle(frame.camera)[part].ravel(),
        range_m=(frame.depth_m[part] * per_depth).ravel(),
    )
