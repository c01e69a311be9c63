"""The edges of a mesh that can bound it in an image."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import trimesh

from pcnav.core.arrays import FloatArray, IntArray
from pcnav.target.mesh import mesh_diameter

_COPLANAR = 1e-6


@dataclass(frozen=True)
class MeshEdges:
    """Edges of a mesh that can bound it in an image."""

    vertices: FloatArray
    """(m, 3) model frame, m."""
    diameter_m: float
    """Of the mesh."""
    ends: IntArray
    """(n, 2) vertices."""
    wings: IntArray
    """(n, k) the third vertices of the triangles at each edge, padded by repetition."""

    def __len__(self) -> int:
        return len(self.ends)

    def at_least(self, length_m: float) -> IntArray:
        """(k,) which are no shorter than a length, in rising order."""
        order, lengths = self._by_length
        return np.sort(order[np.searchsorted(lengths, length_m) :])

    @cached_property
    def _by_length(self) -> tuple[IntArray, FloatArray]:
        lengths = np.linalg.norm(np.diff(self.vertices[self.ends], axis=1)[:, 0], axis=1)
        order = np.argsort(lengths, kind="stable")
        return order, lengths[order]


def mesh_edges(mesh: trimesh.Trimesh) -> MeshEdges:
    """All edges of a mesh but those inside its flat faces."""
    faces = np.array(mesh.faces, dtype=np.intp)
    pairs = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    opposite = faces[:, [2, 0, 1]].ravel()
    owner = np.repeat(np.arange(len(faces)), 3)
    # As one number each, pairs are sorted in a fraction of the time.
    keys, edge = np.unique(pairs @ [len(mesh.vertices), 1], return_inverse=True)
    ends = np.column_stack(np.divmod(keys, len(mesh.vertices)))
    order = np.argsort(edge.ravel(), kind="stable")
    counts = np.bincount(edge.ravel())
    starts = np.cumsum(counts) - counts
    rank = np.arange(len(order)) - np.repeat(starts, counts)
    first = order[starts]
    wings = np.repeat(opposite[first][:, None], counts.max(), axis=1)
    wings[edge.ravel()[order], rank] = opposite[order]
    normals = np.array(mesh.face_normals)
    second = order[starts + (counts > 1)]
    flat = np.einsum("ij,ij->i", normals[owner[first]], normals[owner[second]]) > 1.0 - _COPLANAR
    bounds = (counts != 2) | ~flat
    vertices = np.array(mesh.vertices, dtype=np.float64)
    return MeshEdges(vertices, mesh_diameter(mesh), ends[bounds], wings[bounds])
