"""How far the flat parts of a mesh extend."""

import numpy as np
import trimesh
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from pcnav.core.arrays import BoolArray, FloatArray
from pcnav.target.mesh import mesh_diameter

_SAMPLES = 2_000
_PLANES = 100
_COSINE = float(np.cos(np.radians(20.0)))
_SAME_FRACTION = 1e-6
_APART_FRACTION = 0.1
"""Parts of one plane further apart than this share of the diameter are two."""


def flat_extent(mesh: trimesh.Trimesh, tolerance_fraction: float = 0.04) -> float:
    """How far the largest flat part of a mesh extends, m.

    Flat is what lies within a share of the diameter of a plane that touches the mesh, so a curved
    surface has flat parts, too: as far as a noisy image of it looks flat. A plane that is fitted to
    an image lies between such surfaces: half of that share from them.
    """
    diameter = mesh_diameter(mesh)
    samples, faces = trimesh.sample.sample_surface(mesh, _SAMPLES, seed=0)
    # Corners make the extent of a flat face exact.
    points = np.vstack([samples, np.asarray(mesh.triangles)[faces[::4]].reshape(-1, 3)])
    owner = np.concatenate([faces, np.repeat(faces[::4], 3)])
    normals = np.asarray(mesh.face_normals)[owner]
    planes = []
    for k in range(0, _SAMPLES, _SAMPLES // _PLANES):
        near = np.abs((points - points[k]) @ normals[k]) < tolerance_fraction * diameter
        near &= np.abs(normals @ normals[k]) > _COSINE
        on_plane = np.flatnonzero(near)
        bound = float(np.linalg.norm(np.ptp(points[on_plane], axis=0)))
        planes.append((bound, k, on_plane))
    largest, done = 0.0, np.zeros(len(points), dtype=np.bool_)
    for bound, k, on_plane in sorted(planes, key=lambda plane: -plane[0]):
        if bound <= largest:
            break
        if done[k]:
            continue
        own = on_plane[_about(points[on_plane], points[k], _APART_FRACTION * diameter)]
        part = points[own]
        far = part[np.argmax(np.linalg.norm(part - part.mean(axis=0), axis=1))]
        largest = max(largest, float(np.linalg.norm(part - far, axis=1).max()))
        # The plane of any other point of the same face has the same part.
        same = np.abs((part - points[k]) @ normals[k]) < _SAME_FRACTION * diameter
        done[own[same & (np.abs(normals[own] @ normals[k]) > 1.0 - _SAME_FRACTION)]] = True
    return largest


def _about(points: FloatArray, centre: FloatArray, apart_m: float) -> BoolArray:
    """(n,) which of points (n, 3) a chain of short steps connects with a centre (3,)."""
    tree = cKDTree(points)
    pairs = tree.query_pairs(apart_m, output_type="ndarray")
    graph = coo_matrix((np.ones(len(pairs)), pairs.T), shape=(len(points), len(points)))
    _, label = connected_components(graph, directed=False)
    _, nearest = tree.query(centre)
    return np.asarray(label == label[nearest])
