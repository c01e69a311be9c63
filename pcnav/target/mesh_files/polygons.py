"""Flat polygons of a mesh cut into triangles, also where they are not convex."""

import numpy as np

from pcnav.core.arrays import FloatArray, IntArray

MAX_CORNERS = 5_000
"""Of a polygon that is not convex: the time it takes grows as the square."""


def triangulated(vertices: FloatArray, polygons: list[IntArray]) -> IntArray:
    """(n, 3) triangles that cover polygons, as they are wound.

    ``vertices`` (n, 3); ``polygons`` holds an array (m, k) of corners for each number of corners k.
    A polygon may be bent a little, and may reach a hole of its own by a cut walked twice. Raises
    `ValueError` for one of over 5,000 corners that a fan of triangles does not cover.
    """
    found = [np.empty((0, 3), dtype=np.intp)]
    for corners in polygons:
        count = corners.shape[1]
        fan = np.stack(
            [np.repeat(corners[:, :1], count - 2, axis=1), corners[:, 1:-1], corners[:, 2:]], axis=2
        )
        covered = np.ones(len(corners), dtype=np.bool_)
        if count > 3:
            covered = _covered_by_fan(vertices, corners, fan)
        found.append(fan[covered].reshape(-1, 3))
        found += [polygon[_ears(_flattened(vertices[polygon]))] for polygon in corners[~covered]]
    return np.concatenate(found)


def _normals(corners: FloatArray) -> FloatArray:
    """(n, 3) normals of polygons (n, k, 3) by Newell's method, twice their area long."""
    about = corners - corners[:, :1]
    return np.asarray(np.cross(about, np.roll(about, -1, axis=1)).sum(axis=1))


def _covered_by_fan(vertices: FloatArray, corners: IntArray, fan: IntArray) -> np.ndarray:
    """(n,) whether the fan about the first corner covers each polygon: none of it is turned."""
    a, b, c = np.moveaxis(vertices[fan], 2, 0)
    areas = np.cross(b - a, c - a)
    normals = _normals(vertices[corners])
    # A triangle without area, about corners in a line, does no harm.
    along = np.einsum("nkc,nc->nk", areas, normals)
    return np.asarray(np.all(along >= -1e-9 * np.sum(normals**2, axis=1)[:, None], axis=1))


def _flattened(corners: FloatArray) -> FloatArray:
    """(k, 2) corners (k, 3) of a polygon in its plane, anticlockwise."""
    normal = _normals(corners[None])[0]
    largest = int(np.argmax(np.abs(normal)))
    u, v = (largest + 1) % 3, (largest + 2) % 3
    flat = corners[:, [u, v]] if normal[largest] >= 0.0 else corners[:, [v, u]]
    return np.asarray(flat, dtype=np.float64)


def _ears(corners: FloatArray) -> IntArray:
    """(k - 2, 3) triangles of a simple polygon (k, 2), anticlockwise, by clipping its ears."""
    if len(corners) > MAX_CORNERS:
        raise ValueError(f"a polygon that is not convex has {len(corners)} corners")
    left = list(range(len(corners)))
    found, k, tried = [], 0, 0
    while len(left) > 3:
        k %= len(left)
        ear = (left[k - 1], left[k], left[(k + 1) % len(left)])
        # After a whole round without an ear the polygon crosses itself: any corner will do.
        if tried > len(left) or _is_ear(corners, ear, left):
            found.append(ear)
            del left[k]
            k, tried = k - 1, 0
        else:
            k, tried = k + 1, tried + 1
    return np.array([*found, tuple(left)], dtype=np.intp)


def _is_ear(corners: FloatArray, ear: tuple[int, int, int], left: list[int]) -> bool:
    """Whether a triangle of neighbouring corners is turned outward and holds no other corner."""
    a, b, c = corners[list(ear)]
    if _cross(b - a, c - b) <= 0.0:
        return False
    others = corners[left]
    # Corners of a cut stand in the polygon twice; those at the ear's own do not block it.
    own = np.any(np.all(others[:, None] == np.stack([a, b, c]), axis=2), axis=1)
    others = others[~own]
    inside = (
        (_cross(b - a, others - a) >= 0.0)
        & (_cross(c - b, others - b) >= 0.0)
        & (_cross(a - c, others - c) >= 0.0)
    )
    return not bool(inside.any())


def _cross(a: FloatArray, b: FloatArray) -> FloatArray:
    return np.asarray(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])
