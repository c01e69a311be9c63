"""Triangle meshes: their size, visible edges, what is seen of them."""

import numpy as np
import trimesh

from pcnav.core.arrays import BoolArray, FloatArray

SHARP_EDGE_RAD = np.radians(20.0)
"""Faces that meet at less than this belong to one gently bending surface."""

_RAYS_PER_POINT = 32
_ROUNDS = (1, 3, 12)
"""Directions looked along one round after the other, and then the rest: most points are seen at
once."""
_RAYS_PER_BATCH = 600_000
"""Bounds the memory of one batch of rays to about 50 MB."""


def mesh_diameter(mesh: trimesh.Trimesh) -> float:
    """Diagonal of the mesh's bounding box, m."""
    return float(np.linalg.norm(mesh.bounds[1] - mesh.bounds[0]))


def wireframe_edges(mesh: trimesh.Trimesh) -> FloatArray:
    """The edges that a line drawing shows: (n, 2, 3) end points, model frame, m.

    An edge is drawn where its faces meet at more than 20 degrees, where the surface ends, and
    where more than two faces meet.
    """
    sharp = mesh.face_adjacency_edges[mesh.face_adjacency_angles > SHARP_EDGE_RAD]
    edges, count = np.unique(mesh.edges_sorted, axis=0, return_counts=True)
    return np.asarray(mesh.vertices[np.vstack([sharp, edges[count != 2]])], dtype=np.float64)


def seen_from_outside(
    mesh: trimesh.Trimesh,
    points: FloatArray,
    normals: FloatArray,
    clearance_m: float,
    ahead: bool = False,
) -> BoolArray:
    """Whether points (n, 3) just off the surface see empty space; (n,) of bool.

    Each point is lifted by the clearance along its normal (n, 3) and looks along 32 directions
    of the half space in front of it, straight ahead first; one that leaves the mesh is enough. With
    ``ahead`` the first one decides.
    """
    seen = np.zeros(len(points), dtype=np.bool_)
    local = half_space_directions(_RAYS_PER_POINT)[::-1]
    lifted = points + clearance_m * normals
    for few in np.split(local, np.cumsum(_ROUNDS))[: 1 if ahead else None]:
        unseen = np.flatnonzero(~seen)
        for batch in np.array_split(unseen, len(unseen) * len(few) // _RAYS_PER_BATCH + 1):
            directions = np.einsum("nij,kj->nki", plane_axes(normals[batch]), few)
            origins = np.repeat(lifted[batch], len(few), axis=0)
            hit = mesh.ray.intersects_any(origins, directions.reshape(-1, 3))
            seen[batch] = ~np.all(np.reshape(hit, (-1, len(few))), axis=1)
    return seen


def plane_axes(normals: FloatArray) -> FloatArray:
    """Right-handed axes (columns) whose z is the given unit normal; (..., 3) -> (..., 3, 3)."""
    # Crossing with the model axis farthest from the normal keeps the result well defined.
    farthest = np.eye(3)[np.argmin(np.abs(normals), axis=-1)]
    x = np.cross(farthest, normals)
    x /= np.linalg.norm(x, axis=-1, keepdims=True)
    return np.stack([x, np.cross(normals, x), normals], axis=-1)


def half_space_directions(count: int) -> FloatArray:
    """(count, 3) unit vectors spread evenly over z > 0 (Fibonacci spiral)."""
    index = np.arange(count)
    # Rays closer to the surface than cos = 0.05 would graze it.
    z = 0.05 + 0.95 * (index + 0.5) / count
    azimuth = np.pi * (3.0 - np.sqrt(5.0)) * index
    radius = np.sqrt(1.0 - z * z)
    return np.stack([radius * np.cos(azimuth), radius * np.sin(azimuth), z], axis=1)
