"""Which pixels of a distorting camera may see a mesh.

Through a lens straight lines are imaged as curves, and the convex outline of imaged vertices may
lose part of what lies between them. On the plane z = 1, where the pixels' rays are known, lines
stay straight: there the outline is exact.
"""

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from pcnav.core.arrays import BoolArray, FloatArray
from pcnav.core.camera import PinholeCamera, pixel_rays, pixels_without_ray

_ROUNDING = 1e-9


def seeing_pixels(
    camera: PinholeCamera, vertices_cam: FloatArray
) -> tuple[slice, slice, BoolArray]:
    """Rows and columns that hold all pixels which may see a mesh, and a pixel more; and of those,
    (rows, columns), the pixels that may.

    ``vertices_cam`` (n, 3), m, are those of the mesh, camera frame. With some of them behind the
    camera any pixel may see it.
    """
    shape = (camera.height, camera.width)
    if vertices_cam[:, 2].max() <= 0.0:
        return slice(0, 0), slice(0, 0), np.zeros((0, 0), dtype=np.bool_)
    seeing = np.ones(shape, dtype=np.bool_)
    if vertices_cam[:, 2].min() > 0.0:
        seeing = _inside_outline(pixel_rays(camera), vertices_cam[:, :2] / vertices_cam[:, 2:])
    blind = pixels_without_ray(camera)
    if blind is not None:
        seeing &= ~blind
    rows, columns = _about(seeing, 1), _about(seeing, 0)
    return rows, columns, seeing[rows, columns]


def _inside_outline(rays: FloatArray, points: FloatArray) -> BoolArray:
    """(height, width) of rays (height, width, 3), z = 1: inside the convex outline of (n, 2)."""
    low, high = points.min(axis=0) - _ROUNDING, points.max(axis=0) + _ROUNDING
    x, y = rays[..., 0], rays[..., 1]
    inside = (x >= low[0]) & (x <= high[0]) & (y >= low[1]) & (y <= high[1])
    try:
        faces = ConvexHull(points).equations
    except QhullError:
        # Seen edge-on, a flat mesh has an outline without area.
        return np.asarray(inside)
    boxed = np.stack([x[inside], y[inside]])
    within = np.ones(boxed.shape[1], dtype=np.bool_)
    for a, b, offset in faces:
        within &= a * boxed[0] + b * boxed[1] + offset <= _ROUNDING
    inside[inside] = within
    return np.asarray(inside)


def _about(seeing: BoolArray, along: int) -> slice:
    """From the first row (or column) that has a pixel along it to the last, and one more on each
    side where there is one."""
    found = np.flatnonzero(seeing.any(axis=along))
    if not len(found):
        return slice(0, 0)
    return slice(max(int(found[0]) - 1, 0), min(int(found[-1]) + 2, seeing.shape[1 - along]))
