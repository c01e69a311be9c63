"""One clean mesh of whatever triangles a file holds."""

import numpy as np
import trimesh
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from pcnav.core.arrays import BoolArray, FloatArray, IntArray

_PER_METRE = 1e8
"""Vertices are one where they agree to so many parts of a metre."""
_RAY = np.array([0.5773, 0.2113, 0.7887])
"""A direction that runs along no edge of a mesh but by chance."""


def cleaned(vertices: FloatArray, faces: IntArray) -> trimesh.Trimesh:
    """A mesh of triangles (m, 3) between vertices (n, 3), m, in the order they come.

    Vertices at one place are one; triangles without area or that came before are left out; those
    of a surface are wound alike, anticlockwise as seen from outside where it has an outside. None
    may be left.
    """
    mesh = trimesh.Trimesh(*_merged(vertices, faces), process=False)
    mesh.update_faces(mesh.nondegenerate_faces())
    mesh = trimesh.Trimesh(
        mesh.vertices, mesh.faces[_kinds(np.sort(mesh.faces, axis=1))[0]], process=False
    )
    mesh.remove_unreferenced_vertices()
    if len(mesh.faces) == 0:
        return mesh
    turned = _turned(mesh)
    if turned.any():
        wound = np.where(turned[:, None], mesh.faces[:, ::-1], mesh.faces)
        mesh = trimesh.Trimesh(mesh.vertices, wound, process=False)
    return mesh


def _merged(vertices: FloatArray, faces: IntArray) -> tuple[FloatArray, IntArray]:
    """Vertices and triangles with one vertex at each place, in order of appearance."""
    used = np.zeros(len(vertices), dtype=np.bool_)
    used[faces] = True
    points = vertices[used]
    first, kind = _kinds(np.round(points * _PER_METRE).astype(np.int64))
    number = np.zeros(len(vertices), dtype=np.intp)
    number[used] = kind
    return points[first], number[faces]


def _kinds(rows: IntArray) -> tuple[IntArray, IntArray]:
    """Of rows (n, k) of integers the first of each kind, in order, and the kind (n,) of each."""
    order = np.lexsort(rows.T)
    new = np.any(np.diff(rows[order], axis=0, prepend=rows[order[:1]] - 1) != 0, axis=1)
    # A stable sort leaves rows of a kind in their order.
    first = order[new]
    rank = np.argsort(np.argsort(first))
    kind = np.empty(len(rows), dtype=np.intp)
    kind[order] = rank[np.cumsum(new) - 1]
    return np.sort(first), kind


def _turned(mesh: trimesh.Trimesh) -> BoolArray:
    """(n,) triangles that are wound against the others of their surface, or inward with them."""
    pairs, alike = _neighbours(np.asarray(mesh.faces))
    body, turned = _against_first(len(mesh.faces), pairs, alike)
    # The volume under each surface, from the middle of its bounds: of a closed one from anywhere.
    middle = _middles(mesh, body)[body]
    a, b, c = np.moveaxis(np.asarray(mesh.triangles) - middle[:, None], 1, 0)
    volume = np.einsum("ij,ij->i", a, np.cross(b, c)) / 6.0
    enclosed = np.bincount(body, np.where(turned, -volume, volume))
    # A sheet encloses nothing but rounding.
    scale = np.bincount(body, np.abs(volume))
    inward = enclosed < -1e-9 * np.maximum(scale, np.finfo(float).tiny)
    if inward.any():
        inward &= ~_cavities(mesh, body, inward)
    return np.asarray(turned ^ inward[body])


def _neighbours(faces: IntArray) -> tuple[IntArray, BoolArray]:
    """Pairs (n, 2) of triangles that alone share an edge, and whether they are wound alike."""
    edges = faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    forward = edges[:, 0] < edges[:, 1]
    key = np.sort(edges, axis=1).astype(np.int64) @ np.array([faces.max() + 1, 1])
    order = np.argsort(key, kind="stable")
    key, starts = key[order], np.flatnonzero(np.diff(key[order], prepend=-1))
    twice = starts[np.diff(starts, append=len(key)) == 2]
    first, second = order[twice], order[twice + 1]
    return np.column_stack([first // 3, second // 3]), forward[first] != forward[second]


def _against_first(count: int, pairs: IntArray, alike: BoolArray) -> tuple[IntArray, BoolArray]:
    """(n,) the surface each triangle belongs to, and whether it is wound against its first one.

    Every triangle stands twice in a graph, as it is and turned over. Neighbours hang together where
    they are wound alike, so each surface has two halves: all of it one way and all of it the other;
    a surface that has no two sides has one.
    """
    i, j = pairs.T
    across = np.where(alike, 0, count)
    rows = np.concatenate([i, i + count])
    columns = np.concatenate([j + across, j + (count - across)])
    graph = coo_array((np.ones(len(rows)), (rows, columns)), shape=(2 * count, 2 * count))
    half = connected_components(graph, directed=False)[1]
    single = coo_array((np.ones(len(i)), (i, j)), shape=(count, count))
    body = np.asarray(connected_components(single, directed=False)[1], dtype=np.intp)
    first = half[np.unique(body, return_index=True)[1]][body]
    return body, np.asarray(half[:count] != first)


def _middles(mesh: trimesh.Trimesh, body: IntArray) -> FloatArray:
    """(n, 3) middle of the triangles of each surface."""
    centres = mesh.triangles_center
    sums = np.stack([np.bincount(body, centres[:, k]) for k in range(3)], axis=1)
    return np.asarray(sums / np.bincount(body)[:, None])


def _cavities(mesh: trimesh.Trimesh, body: IntArray, asked: BoolArray) -> BoolArray:
    """(n,) which of the surfaces asked for lie inside others: they bound a hollow of theirs."""
    bodies = np.flatnonzero(asked)
    start = mesh.triangles_center[np.unique(body, return_index=True)[1]][bodies]
    directions = np.tile(_RAY / np.linalg.norm(_RAY), (len(bodies), 1))
    hit, ray = mesh.ray.intersects_id(start, directions, multiple_hits=True)
    other = body[hit] != bodies[ray]
    crossed = np.bincount(ray[other], minlength=len(bodies))
    found = np.zeros(len(asked), dtype=np.bool_)
    found[bodies] = crossed % 2 == 1
    return found
