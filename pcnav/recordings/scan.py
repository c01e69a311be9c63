"""Scans: returns along rays of their own, each at a time of its own, laid over a grid of pixels."""

from dataclasses import dataclass

import numpy as np

from pcnav.core.arrays import FloatArray
from pcnav.core.beams import Beams, beams_on
from pcnav.core.camera import PinholeCamera
from pcnav.recordings.organised import pinhole_of

_BEAMS_A_PIXEL = 1.5
"""Of a pattern without rows and columns: four fifths of the pixels then have some."""
_MIN_PITCH, _MAX_SIDE = 1e-4, 4096
_MARGIN = 0.5
_BEAMS_A_CELL = 10.0
"""Of a coarse grid on which it is seen what part of the field beams cover."""


@dataclass(frozen=True)
class Scan:
    """The beams of one scan, n of them."""

    rays: FloatArray
    """(n, 3) camera frame, scaled to z = 1."""
    range_m: FloatArray
    """(n,) along them; 0 = no return."""
    time_s: FloatArray
    """(n,) from the time of the scan on."""

    def on(self, camera: PinholeCamera) -> Beams:
        """Laid over the pixels of a camera."""
        return beams_on(camera, self.rays, self.range_m, self.time_s)

    @staticmethod
    def of(beams: Beams) -> "Scan":
        """Of what was laid over a grid."""
        range_m = beams.depth_m * np.linalg.norm(beams.rays, axis=1)
        return Scan(beams.rays, range_m, beams.time_s)


def grid_of(rays: FloatArray) -> PinholeCamera:
    """The camera over whose pixels the beams of a sensor are laid.

    Of beams in rows and columns that one pinhole could have seen, (rows, columns, 3) with z = 1, it
    is that pinhole; of others in rows and columns one with such pixels on the average; of beams in
    no order, (1, n, 3), one with square pixels that each have one or two of them.
    """
    height, width = rays.shape[:2]
    if min(height, width) >= 2:
        try:
            return PinholeCamera(width, height, *pinhole_of(rays))
        except ValueError:
            pass
    flat = rays[..., :2].reshape(-1, 2)
    low, high = flat.min(axis=0), flat.max(axis=0)
    span = np.maximum(high - low, _MIN_PITCH)
    if min(height, width) >= 2:
        pitch = np.array([_step(rays[..., 0], 1), _step(rays[..., 1], 0)])
    else:
        pitch = np.full(2, np.sqrt(_BEAMS_A_PIXEL * _area(flat, span) / len(flat)))
    pitch = np.maximum(pitch, np.maximum(span / _MAX_SIDE, _MIN_PITCH))
    size = np.ceil(span / pitch + 2.0 * _MARGIN).astype(int)
    first = 0.5 * (low + high) - 0.5 * (size - 1) * pitch
    fx, fy = (1.0 / pitch).tolist()
    cx, cy = (-first / pitch).tolist()
    return PinholeCamera(int(size[0]), int(size[1]), fx, fy, cx, cy)


def grid_over(flat: FloatArray, pitch: float, max_slope: float, max_side: int) -> PinholeCamera:
    """Square pixels over beams (n, 2) in the plane z = 1, and as far beyond them again to every
    side, but not beyond a slope."""
    low, high = flat.min(axis=0), flat.max(axis=0)
    span = high - low
    low, high = np.maximum(low - span, -max_slope), np.minimum(high + span, max_slope)
    pitch = max(pitch, float((high - low).max()) / max_side)
    size = np.maximum(np.ceil((high - low) / pitch), 2).astype(int)
    cx, cy = (-low / pitch).tolist()
    return PinholeCamera(int(size[0]), int(size[1]), 1.0 / pitch, 1.0 / pitch, cx, cy)


def _step(values: FloatArray, axis: int) -> float:
    """Typical step from beam to beam along an axis."""
    return float(np.median(np.abs(np.diff(values, axis=axis))))


def _area(flat: FloatArray, span: FloatArray) -> float:
    """Of the plane z = 1 that beams (n, 2) cover, by the share of cells with some in them."""
    n = max(int(np.sqrt(len(flat) / _BEAMS_A_CELL)), 1)
    cell = np.minimum(((flat - flat.min(axis=0)) / span * n).astype(int), n - 1)
    filled = len(np.unique(cell[:, 0] * n + cell[:, 1]))
    return float(filled / n**2 * span[0] * span[1])
