"""How far the flat parts of a mesh extend."""

import numpy as np
import trimesh
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from pcnav.core.arrays import FloatArray
from pcnav.target.mesh import mesh_diameter

_SAMPLES = 3_000
_PLANES = 150
_COSINE = float(np.cos(np.radians(20.0)))
_APART_FRACTION = 0.08
"""Parts of one plane further apart than this share of the diameter are two."""


def flat_extent(mesh: trimesh.Trimesh, tolerance_fraction: float = 0.02) -> float:
    """How far the largest flat part of a mesh extends, m.

    Flat is what lies within a share of the diameter of a plane that touches the mesh, so a curved
    surface has flat parts, too: as far as a noisy image of it looks flat.
    """
    diameter = mesh_diameter(mesh)
    samples, faces = trimesh.sample.sample_surface(mesh, _SAMPLES, seed=0)
    # Corners make the extent of a flat face exact.
    points = np.vstack([samples, np.asarray(mesh.triangles)[faces[::4]].reshape(-1, 3)])
    owner = np.concatenate([faces, np.repeat(faces[::4], 3)])
    normals = np.asarray(mesh.face_normals)[owner]
    largest = 0.0
    for k in range(0, _SAMPLES, _SAMPLES // _PLANES):
        near = np.abs((points - points[k]) @ normals[k]) < tolerance_fraction * diameter
        near &= np.abs(normals @ normals[k]) > _COSINE
        part = _about(points[near], points[k], _APART_FRACTION * diameter)
        low, high = part.min(axis=0), part.max(axis=0)
        if np.linalg.norm(high - low) > largest:
            far = part[np.argmax(np.linalg.norm(part - part.mean(axis=0), axis=1))]
            largest = max(largest, float(np.linalg.norm(part - far, axis=1).max()))
    return largest


def _about(points: FloatArray, centre: FloatArray, apart_m: float) -> FloatArray:
    """The points (n, 3) that a chain of short steps connects with a centre (3,)."""
    tree = cKDTree(points)
    pairs = tree.sparse_distance_matrix(tree, apart_m, output_type="coo_matrix")
    _, label = connected_components(pairs, directed=False)
    _, nearest = tree.query(centre)
    return np.asarray(points[label == label[nearest]])
