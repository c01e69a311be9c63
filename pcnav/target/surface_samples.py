"""The surface of a mesh as points: those seen from outside, and what lies nearest to any place."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import trimesh
from scipy.spatial import cKDTree

from pcnav.core.arrays import BoolArray, FloatArray, IntArray
from pcnav.target.mesh import mesh_diameter, seen_from_outside, wireframe_edges

_AREA_SAMPLES = 20_000
_PROBES = 3_000
_CLEARANCE_FRACTION = 1e-4
"""How far off a face the eye starts when asking whether it is seen, over the diameter."""
_EDGE_STEP_FRACTION = 0.01
_MAX_EDGE_SAMPLES = 60_000
"""Narrow faces have little area and get samples along their edges, no further apart than so much
of the diameter, as long as there are not more of them than this."""
_NEIGHBOURS = 6
_CELLS_ACROSS = 64
"""Of the grid of nearest samples, along the diameter."""
_GRID_SAMPLES = 8_000
_MARGIN_FRACTION = 0.1


@dataclass(frozen=True)
class Probes:
    """Points of the surface that are seen from outside, each for the same part of its area."""

    points: FloatArray
    """(n, 3) model frame, m."""
    area_m2: float
    """That all of them stand for."""
    corners: FloatArray
    """(m, 3) points hard by corners of faces that are seen from outside: as far out as it gets."""

    @cached_property
    def centre(self) -> FloatArray:
        """(3,) centroid of the area seen."""
        return np.asarray(self.points.mean(axis=0))

    @cached_property
    def second_moments(self) -> FloatArray:
        """(3, 3) mean of p p^T over the area seen, p from its centroid, m^2."""
        apart = self.points - self.centre
        return np.asarray(apart.T @ apart / len(apart))

    @cached_property
    def axes(self) -> FloatArray:
        """(3, 3) its principal axes, columns."""
        return np.asarray(np.linalg.eigh(self.second_moments)[1])

    def some(self, count: int) -> FloatArray:
        """(n, 3) every so many of the points, about `count`."""
        return self.points[:: max(1, len(self.points) // count)]


def edge_points(mesh: trimesh.Trimesh, count: int) -> FloatArray:
    """About so many points (n, 3) along the sharp and the open edges of a mesh; none on a mesh
    that is smooth and closed."""
    ends = wireframe_edges(mesh)
    length = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    if not length.sum() > 0.0:
        return np.empty((0, 3))
    along = (np.arange(count) + 0.5) / count * length.sum()
    which = np.searchsorted(np.cumsum(length), along).clip(0, len(length) - 1)
    share = (along - np.cumsum(length)[which] + length[which]) / length[which]
    return np.asarray(ends[which, 0] + share[:, None] * (ends[which, 1] - ends[which, 0]))


def visible_probes(mesh: trimesh.Trimesh, count: int = _PROBES) -> Probes:
    """About so many points spread over what is seen of a mesh from outside, evenly by area.

    The area of a face hidden from one side or covered by another body counts only as far as it is
    seen; a mesh of which nothing is seen, a flat speck, counts whole.
    """
    points, owner = _spread(mesh, count, seed=1)
    corners, of_corner = _near_corners(mesh, count)
    seen = _is_seen(mesh, points, owner)
    if not seen.any():
        seen[:] = True
    each = float(mesh.area) / len(points)
    outer = corners[_is_seen(mesh, corners, of_corner)]
    return Probes(points[seen], each * int(seen.sum()), outer)


def _is_seen(mesh: trimesh.Trimesh, points: FloatArray, faces: IntArray) -> BoolArray:
    """(n,) whether points (n, 3) on faces (n,) are seen from outside, from either side."""
    normals = np.asarray(mesh.face_normals)[faces]
    clearance = _CLEARANCE_FRACTION * mesh_diameter(mesh)
    front, behind = (
        seen_from_outside(mesh, points, side, clearance) for side in (normals, -normals)
    )
    return front | behind


def _near_corners(mesh: trimesh.Trimesh, count: int) -> tuple[FloatArray, IntArray]:
    """At most so many points (n, 3) of faces next to their corners, and the face (n,) of each.

    On its face such a point has a definite normal, and is still as far out as the face gets.
    """
    chosen = np.arange(3 * len(mesh.faces))
    if len(chosen) > count:
        chosen = np.random.default_rng(2).choice(len(chosen), count, replace=False)
    face, corner = chosen // 3, chosen % 3
    triangles = np.asarray(mesh.triangles)[face]
    middles = triangles.mean(axis=1)
    points = middles + 0.98 * (triangles[np.arange(len(chosen)), corner] - middles)
    return np.asarray(points), face


def _spread(mesh: trimesh.Trimesh, count: int, seed: int) -> tuple[FloatArray, IntArray]:
    """Points (count, 3) that each stand for the same area, and the face (count,) of each.

    Faces follow one another by area, so that whatever has the area of a point gets one.
    """
    rng = np.random.default_rng(seed)
    until = np.cumsum(np.asarray(mesh.area_faces))
    along = (np.arange(count) + rng.random(count)) / count * until[-1]
    face = np.searchsorted(until, along).clip(0, len(until) - 1)
    a, b = rng.random((2, count, 1))
    folded = a + b > 1.0
    a, b = np.where(folded, 1.0 - a, a), np.where(folded, 1.0 - b, b)
    corners = np.asarray(mesh.triangles)[face]
    points = (
        corners[:, 0] + a * (corners[:, 1] - corners[:, 0]) + b * (corners[:, 2] - corners[:, 0])
    )
    return np.asarray(points), np.asarray(face, dtype=np.intp)


class SurfaceSamples:
    """Samples of a whole mesh, and by them how far any place is from its surface."""

    def __init__(self, mesh: trimesh.Trimesh) -> None:
        self.diameter_m, self._area_m2 = mesh_diameter(mesh), float(mesh.area)
        self._triangles = np.asarray(mesh.triangles)
        self._normals = np.asarray(mesh.face_normals)
        self._low = np.asarray(mesh.bounds[0])
        self._size = np.asarray(mesh.bounds[1]) - self._low
        points, faces = _spread(mesh, _AREA_SAMPLES, seed=0)
        along, owners = _along_edges(self._triangles, _EDGE_STEP_FRACTION * self.diameter_m)
        self.points = np.vstack([points, along])
        self._face = np.concatenate([faces, owners])
        self._tree = cKDTree(self.points)

    @cached_property
    def spacing_m(self) -> float:
        """How far from a place the sample may be that a coarse grid takes for the nearest."""
        return self.diameter_m / _CELLS_ACROSS + float(np.sqrt(self._area_m2 / _GRID_SAMPLES))

    def closest(
        self, points: FloatArray, neighbours: int = _NEIGHBOURS
    ) -> tuple[FloatArray, FloatArray]:
        """(n, 3) the nearest places of the surface to points (n, 3), among the faces of their
        nearest samples, and (n, 3) unit vectors along which the distance to them grows."""
        _, nearest = self._tree.query(points, k=min(neighbours, len(self.points)))
        faces = self._face[nearest.reshape(len(points), -1)]
        repeated = np.repeat(points, faces.shape[1], axis=0)
        found = trimesh.triangles.closest_point(self._triangles[faces.ravel()], repeated)
        apart = np.linalg.norm(found - repeated, axis=1).reshape(faces.shape)
        best = apart.argmin(axis=1), np.arange(len(points))
        place = found.reshape(*faces.shape, 3)[best[1], best[0]]
        distance = apart[best[1], best[0]]
        away = distance > 1e-9 * self.diameter_m
        along = self._normals[faces[best[1], best[0]]].copy()
        along[away] = (points[away] - place[away]) / distance[away, None]
        return place, along

    def distance(self, points: FloatArray) -> FloatArray:
        """(n,) of points (n, 3) from the surface, m."""
        return np.asarray(np.linalg.norm(self.closest(points)[0] - points, axis=1))

    def is_off(self, points: FloatArray, tolerance_m: float) -> BoolArray:
        """(n,) whether points (n, 3) are further from the surface than a tolerance."""
        # Samples lie on the surface: a point within the tolerance of one is settled.
        apart, _ = self._tree.query(points, distance_upper_bound=tolerance_m)
        off = np.asarray(~np.isfinite(apart))
        if off.any():
            off[off] = self.distance(points[off]) > tolerance_m
        return off

    def nearest(self, points: FloatArray) -> FloatArray:
        """(..., 3) the samples nearest to points (..., 3)."""
        return np.asarray(self.points[self._tree.query(points)[1]])

    def nearest_roughly(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(..., 3) the samples nearest to points (..., 3), as the cells of a coarse grid know them,
        and (..., 3) the unit normals of their faces."""
        low, cell_m, shape, nearest = self._grid
        index = ((points - low) / cell_m).astype(np.intp)
        for k, limit in enumerate(shape):
            np.clip(index[..., k], 0, limit - 1, out=index[..., k])
        flat = (index[..., 0] * shape[1] + index[..., 1]) * shape[2] + index[..., 2]
        found = nearest[flat]
        return self.points[found], self._normals[self._face[found]]

    @cached_property
    def _grid(self) -> tuple[FloatArray, float, tuple[int, ...], IntArray]:
        """Corner and step of a grid about the mesh, its shape, the nearest sample by cell."""
        margin, cell_m = _MARGIN_FRACTION * self.diameter_m, self.diameter_m / _CELLS_ACROSS
        low = self._low - margin
        shape = tuple(int(n) for n in np.ceil((self._size + 2.0 * margin) / cell_m))
        axes = [low[k] + (np.arange(n) + 0.5) * cell_m for k, n in enumerate(shape)]
        cells = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
        # Samples closer together than the cells tell them nothing more.
        some = np.arange(0, len(self.points), max(1, len(self.points) // _GRID_SAMPLES))
        _, nearest = cKDTree(self.points[some]).query(cells, eps=0.1)
        return low, cell_m, shape, some[nearest]


def _along_edges(triangles: FloatArray, step_m: float) -> tuple[FloatArray, IntArray]:
    """Points (n, 3) just inside the edges of faces, and the face (n,) of each.

    A step apart; of more edges than can be sampled so, the middles of the faces.
    """
    # Just inside, so that a sample lies on one face and not on all that share an edge or corner.
    middles = triangles.mean(axis=1)
    inside = middles[:, None] + 0.98 * (triangles - middles[:, None])
    start, end = inside, np.roll(inside, -1, axis=1)
    length = np.linalg.norm(end - start, axis=2)
    count = np.maximum(np.ceil(length / step_m).astype(np.intp), 1)
    small = length.max(axis=1) < step_m
    # A face within one step is known by its middle.
    points, owners = [middles[small]], [np.flatnonzero(small)]
    rows, sides = np.nonzero(~small[:, None] & (count > 0))
    total = int(count[rows, sides].sum())
    if total > _MAX_EDGE_SAMPLES:
        coarser = -(-total // _MAX_EDGE_SAMPLES)
        count = np.maximum(count // coarser, 1)
    repeats = count[rows, sides]
    which = np.repeat(np.arange(len(rows)), repeats)
    first = np.repeat(np.cumsum(repeats) - repeats, repeats)
    share = ((np.arange(len(which)) - first) / repeats[which])[:, None]
    a, b = start[rows, sides][which], end[rows, sides][which]
    points.append(a + share * (b - a))
    owners.append(rows[which])
    return np.vstack(points), np.concatenate(owners)
