"""A large mesh without the faces that are never seen from outside."""

import numpy as np
import trimesh
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from pcnav.core.arrays import BoolArray, FloatArray, IntArray
from pcnav.target.mesh import mesh_diameter, seen_from_outside

_LARGE = 20_000
"""Faces from which on inner ones are worth the search."""
_CLEARANCE_FRACTION = 1e-5
_BROAD_FRACTION = 0.02
"""A face with a longer side than this share of the diameter is looked at in many places."""
_PLACES = np.array(
    [
        *([1 / 3, 1 / 3, 1 / 3], [0.96, 0.02, 0.02], [0.02, 0.96, 0.02], [0.02, 0.02, 0.96]),
        *([0.48, 0.48, 0.04], [0.48, 0.04, 0.48], [0.04, 0.48, 0.48]),
        *([2 / 3, 1 / 6, 1 / 6], [1 / 6, 2 / 3, 1 / 6], [1 / 6, 1 / 6, 2 / 3]),
    ]
)
"""(10, 3) barycentric coordinates: the middle, hard by corners and edges, and between."""
_PROBED = 64
"""Faces looked at of each set of unseen neighbours."""


def visible_shell(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """The mesh as it is where it is small; of a large one what may be seen from outside.

    A face stays where any place looked at on either side of it has a free view. Neighbours of which
    none was seen straight ahead stay or go together, by a look in all directions from some of them.
    """
    if len(mesh.faces) <= _LARGE:
        return mesh
    normals, corners = np.array(mesh.face_normals), np.array(mesh.triangles)
    clearance_m = _CLEARANCE_FRACTION * mesh_diameter(mesh)
    seen = _seen(mesh, corners, normals, _PLACES[:1], clearance_m, ahead=True)
    sides = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    broad = np.flatnonzero(~seen & (sides > _BROAD_FRACTION * mesh_diameter(mesh)))
    seen[broad] = _seen(mesh, corners[broad], normals[broad], _PLACES, clearance_m)
    hidden = np.flatnonzero(~seen & (sides <= _BROAD_FRACTION * mesh_diameter(mesh)))
    patch = _patches(mesh, hidden)
    probed = _some_of_each(patch)
    found = _seen(mesh, corners[hidden[probed]], normals[hidden[probed]], _PLACES[:4], clearance_m)
    stays = np.bincount(patch[probed], found, minlength=patch.max(initial=-1) + 1) > 0.0
    seen[hidden] = stays[patch]
    if seen.all() or not seen.any():
        return mesh
    shell = trimesh.Trimesh(mesh.vertices, mesh.faces[seen], process=False)
    shell.remove_unreferenced_vertices()
    return shell


def _seen(
    mesh: trimesh.Trimesh,
    corners: FloatArray,
    normals: FloatArray,
    places: FloatArray,
    clearance_m: float,
    ahead: bool = False,
) -> BoolArray:
    """(n,) faces (n, 3, 3) of which some place (k, 3) sees empty space, on either side.

    ``ahead`` looks along the normals only.
    """
    seen = np.zeros(len(corners), dtype=np.bool_)
    for place in places:
        for sign in (1.0, -1.0):
            left = np.flatnonzero(~seen)
            points = np.einsum("k,nkc->nc", place, corners[left])
            facing = sign * normals[left]
            seen[left] = seen_from_outside(mesh, points, facing, clearance_m, ahead=ahead)
    return seen


def _patches(mesh: trimesh.Trimesh, faces: IntArray) -> IntArray:
    """(n,) label of the set of neighbours that each of some faces (n,) belongs to."""
    number = np.full(len(mesh.faces), -1, dtype=np.intp)
    number[faces] = np.arange(len(faces))
    pairs = number[mesh.face_adjacency]
    pairs = pairs[(pairs >= 0).all(axis=1)]
    shape = (len(faces), len(faces))
    graph = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=shape)
    return np.asarray(connected_components(graph, directed=False)[1], dtype=np.intp)


def _some_of_each(label: IntArray) -> IntArray:
    """Indices of at most 64 of each label, drawn evenly."""
    order = np.random.default_rng(0).permutation(len(label))
    order = order[np.argsort(label[order], kind="stable")]
    count = np.bincount(label)
    rank = np.arange(len(label)) - np.repeat(np.cumsum(count) - count, count)
    return np.sort(order[rank < _PROBED])
