"""Organised clouds as depth images: rows and columns of points that one pinhole has seen."""

import numpy as np

from pcnav.core.arrays import FloatArray
from pcnav.recordings.depth_image import StoredDepth

_MIN_POINTS = 100
_MAX_MISFIT_PX = 0.1
"""Root mean square by which the points may miss the pixels that they stand at."""


def depth_of_points(points: FloatArray) -> StoredDepth:
    """(height, width) z-depth of points (height, width, 3); holes are 0."""
    z = points[..., 2]
    return np.where(np.isfinite(points).all(axis=-1) & (z > 0.0), z, 0.0).astype(np.float32)


def pinhole_of(points: FloatArray) -> tuple[float, float, float, float]:
    """fx, fy, cx, cy of the camera that saw points (height, width, 3) at integer pixels.

    The least-squares fit of ``u = fx x/z + cx`` and ``v = fy y/z + cy``. Raises `ValueError` where
    no pinhole explains them, as for a spinning LiDAR.
    """
    seen = depth_of_points(points) > 0.0
    if int(seen.sum()) < _MIN_POINTS:
        raise ValueError(f"expected at least {_MIN_POINTS} points with z above 0")
    v, u = np.nonzero(seen)
    p = points[seen]
    fx, cx, off_u = _line(p[:, 0] / p[:, 2], u.astype(np.float64))
    fy, cy, off_v = _line(p[:, 1] / p[:, 2], v.astype(np.float64))
    if not (fx > 0.0 and fy > 0.0 and max(off_u, off_v) <= _MAX_MISFIT_PX):
        raise ValueError("expected points in the rows and columns of one pinhole camera")
    return fx, fy, cx, cy


def _line(x: FloatArray, pixel: FloatArray) -> tuple[float, float, float]:
    """Slope, offset and misfit of ``pixel = slope x + offset``."""
    A = np.column_stack([x, np.ones_like(x)])
    found, *_ = np.linalg.lstsq(A, pixel, rcond=None)
    off = float(np.sqrt(np.mean((A @ found - pixel) ** 2)))
    return float(found[0]), float(found[1]), off
