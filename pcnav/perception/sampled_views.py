"""Views of a target from directions all over the sphere, on a coarse metric grid.

Each says which cells the target covers, seen without perspective, and how deep they lie: its looks
at any distance, whatever its mesh.
"""

from dataclasses import dataclass

import numpy as np
import trimesh
from scipy.spatial import cKDTree

from pcnav.core.arrays import DepthImage, FloatArray, IntArray
from pcnav.perception.surface_alignment import Surface
from pcnav.target.mesh import mesh_diameter

_SUBDIVISIONS = 3
"""Of an icosahedron: 642 directions, 8 degrees apart."""
_FIRST_DIRECTIONS = 162
"""Those of one subdivision less come first: 16 degrees apart."""
CELLS = 26
"""Cells along each side of the grid."""
_SPAN_FRACTION = 1.12
"""Side of the grid over the diameter."""
_SURFACE_POINTS = 6_000
_VIEWS_AT_ONCE = 60
_EDGE_ON = 1e-3


@dataclass(frozen=True)
class Templates:
    """Views of a target from n directions on a grid of c cells."""

    R_view_model: FloatArray
    """(n, 3, 3) z along the line of sight."""
    covered: DepthImage
    """(n, c) 1 where the view shows a surface."""
    depth: DepthImage
    """(n, c) of it along the line of sight, m; 0 where there is none."""
    centre: FloatArray
    """(n, 3) view axes: what the grid and its depth are centred on, model origin at zero."""

    def first(self) -> "Templates":
        """Those of the directions that are wide apart."""
        some = slice(_FIRST_DIRECTIONS)
        return Templates(
            self.R_view_model[some], self.covered[some], self.depth[some], self.centre[some]
        )


@dataclass(frozen=True)
class SampledViews:
    """All that is sampled of a target, once."""

    diameter_m: float
    templates: Templates
    surface: Surface

    @property
    def cell_m(self) -> float:
        """Side of a cell of the grid."""
        return _SPAN_FRACTION * self.diameter_m / CELLS


def sample_views(mesh: trimesh.Trimesh) -> SampledViews:
    """The views of a mesh: under a second, whatever its number of faces."""
    diameter = mesh_diameter(mesh)
    middle = np.asarray(mesh.bounds).mean(axis=0)
    directions = np.asarray(trimesh.creation.icosphere(_SUBDIVISIONS).vertices)
    R = looking_along(directions)
    cell = _SPAN_FRACTION * diameter / CELLS
    grid = square_grid(CELLS, cell)
    starts = grid @ R[:, :2] + (middle - diameter * R[:, 2])[:, None]
    depth, normal = _first_hits(mesh, starts, R[:, 2])
    hit = np.isfinite(depth)
    n, c = hit.shape
    covered, shown = np.zeros((n, c), np.float32), np.zeros((n, c), np.float32)
    centre = np.zeros((n, 3))
    square = (CELLS, CELLS)
    for k in np.flatnonzero(hit.any(axis=1)).tolist():
        # Centred on what is covered, to whole cells, as a part of a frame is.
        whole = np.rint(grid[hit[k]].mean(axis=0) / cell).astype(int)
        mean = float(depth[k, hit[k]].mean())
        covered[k] = _moved(hit[k].reshape(square).astype(float), -whole).ravel()
        relative = np.where(hit[k], depth[k] - mean, 0.0)
        shown[k] = _moved(relative.reshape(square), -whole).ravel()
        centre[k] = R[k] @ middle + [*(whole * cell), mean - diameter]
    view, at = np.nonzero(hit)
    order = np.random.default_rng(0).permutation(len(view))[:_SURFACE_POINTS]
    view, at = view[order], at[order]
    cloud = starts[view, at] + depth[view, at][:, None] * R[view, 2]
    surface = Surface(cloud, normal[view, at], cKDTree(cloud))
    return SampledViews(diameter, Templates(R, covered, shown, centre), surface)


def _first_hits(
    mesh: trimesh.Trimesh, starts: FloatArray, directions: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """(n, c) distance along rays from starts (n, c, 3) in n directions (n, 3), infinite where they
    miss, and (n, c, 3) normal of the face that is hit, against the ray."""
    face_normals, faces = np.asarray(mesh.face_normals), np.asarray(mesh.faces)
    corners = np.asarray(mesh.vertices)[faces[:, 0]]
    distance = np.full(starts.shape[:2], np.inf)
    normal = np.zeros(starts.shape)
    for first in range(0, len(starts), _VIEWS_AT_ONCE):
        some = slice(first, first + _VIEWS_AT_ONCE)
        rays = np.repeat(directions[some], starts.shape[1], axis=0)
        origins = starts[some].reshape(-1, 3)
        face = np.asarray(mesh.ray.intersects_first(origins, rays), dtype=np.intp)
        hit = face >= 0
        met, ray = face[hit], rays[hit]
        across = face_normals[met]
        along = np.einsum("ij,ij->i", across, ray)
        to_corner = corners[met] - origins[hit]
        # A face seen edge-on is as deep as its corner.
        edge_on = np.abs(along) < _EDGE_ON
        gap = np.einsum("ij,ij->i", to_corner, across) / np.where(edge_on, 1.0, along)
        part = np.full(len(face), np.inf)
        part[hit] = np.where(edge_on, np.einsum("ij,ij->i", to_corner, ray), gap)
        distance[some] = part.reshape(distance[some].shape)
        facing = np.zeros((len(face), 3))
        facing[hit] = across * -np.where(along < 0.0, -1.0, 1.0)[:, None]
        normal[some] = facing.reshape(normal[some].shape)
    return distance, normal


def _moved(grid: FloatArray, cells: IntArray) -> FloatArray:
    """A square grid (rows y, columns x) moved by whole cells (x, y); what leaves it is lost."""
    moved = np.zeros_like(grid)
    size = len(grid)
    dx, dy = int(cells[0]), int(cells[1])
    rows = slice(max(dy, 0), size + min(dy, 0)), slice(max(-dy, 0), size + min(-dy, 0))
    columns = slice(max(dx, 0), size + min(dx, 0)), slice(max(-dx, 0), size + min(-dx, 0))
    moved[rows[0], columns[0]] = grid[rows[1], columns[1]]
    return moved


def looking_along(direction: FloatArray) -> FloatArray:
    """(..., 3, 3) rotations whose third rows are unit directions (..., 3)."""
    other = np.eye(3)[np.argmin(np.abs(direction), axis=-1)]
    x = np.cross(other, direction)
    x /= np.linalg.norm(x, axis=-1, keepdims=True)
    return np.stack([x, np.cross(direction, x), direction], axis=-2)


def square_grid(size: int, cell_m: float) -> FloatArray:
    """(size^2, 2) middles of the cells of a square grid about zero, m, row after row."""
    axis = (np.arange(size) + 0.5 - 0.5 * size) * cell_m
    x, y = np.meshgrid(axis, axis)
    return np.column_stack([x.ravel(), y.ravel()])
