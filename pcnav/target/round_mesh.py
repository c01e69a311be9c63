"""A body that is round, of a mesh that draws it with few sides.

The vertices of such a mesh lie on the surface, its facets inside: by 2 % of the radius in the
middle of one of sixteen sides, which is many times what a pose is known to. Which way the facets
are turned nobody knows either. Edges across the curve are halved, and their middles moved out onto
the surface, until the facets are finer than a few degrees.
"""

import numpy as np
import trimesh

from pcnav.core.arrays import BoolArray, FloatArray, IntArray
from pcnav.target.roundness import Roundness

_FINE_RAD = np.radians(3.0)
"""A side that turns by no more lies within 0.04 % of the radius of the surface."""
_MAX_FACES = 100_000
_END_COSINE = 0.99
"""Faces so near to perpendicular to the axis are ends: what divides them is no curve."""
_ON_AXIS = 1e-6
"""Of the largest radius: nearer, a vertex is turned by nothing."""


def rounded(mesh: trimesh.Trimesh, roundness: Roundness) -> trimesh.Trimesh:
    """The mesh with finer facets; itself where they are fine, or there are too many."""
    vertices = np.asarray(mesh.vertices) - roundness.point_model
    faces, changed = np.asarray(mesh.faces, dtype=np.intp), False
    while len(faces) < _MAX_FACES:
        edges, of_face = _edges(faces)
        middle = _Middles.of(vertices, edges, roundness)
        split = middle.is_coarse & _curves(vertices, faces, of_face, len(edges), roundness)
        if not split.any():
            break
        number = np.full(len(edges), -1)
        number[split] = len(vertices) + np.arange(np.count_nonzero(split))
        vertices = np.vstack([vertices, middle.points[split]])
        faces, changed = _divided(faces, number[of_face]), True
    if not changed:
        return mesh
    return trimesh.Trimesh(vertices + roundness.point_model, faces, process=False)


class _Middles:
    """Of edges, on the round surface through their ends."""

    def __init__(self, points: FloatArray, is_coarse: BoolArray) -> None:
        self.points, self.is_coarse = points, is_coarse

    @staticmethod
    def of(vertices: FloatArray, edges: IntArray, roundness: Roundness) -> "_Middles":
        """Halfway along the axis, in radius and in angle; of a ball in radius and in angle."""
        ends = vertices[edges]
        along = np.zeros_like(ends)
        if not roundness.is_ball:
            (axis,) = roundness.axes_model
            along = (ends @ axis)[..., None] * axis
        across = ends - along
        radius = np.linalg.norm(across, axis=-1)
        off_axis = radius.min(axis=1) > _ON_AXIS * radius.max(initial=0.0)
        unit = across / np.maximum(radius, 1e-300)[..., None]
        outwards = unit.sum(axis=1)
        length = np.linalg.norm(outwards, axis=1)
        # Unit vectors an angle apart add up to twice the cosine of its half. Opposite ones have no
        # middle.
        turned = 2.0 * np.arccos(np.clip(0.5 * length, 0.0, 1.0))
        outwards = outwards / np.maximum(length, 1e-300)[:, None]
        points = along.mean(axis=1) + radius.mean(axis=1)[:, None] * outwards
        return _Middles(points, off_axis & (turned > _FINE_RAD) & (length > 1e-3))


def _edges(faces: IntArray) -> tuple[IntArray, IntArray]:
    """Edges (e, 2), and those of each face (n, 3): from its first corner to the second, and on."""
    ends = np.sort(np.stack([faces, np.roll(faces, -1, axis=1)], axis=-1).reshape(-1, 2), axis=1)
    edges, index = np.unique(ends, axis=0, return_inverse=True)
    return edges, index.reshape(-1, 3)


def _curves(
    vertices: FloatArray, faces: IntArray, of_face: IntArray, count: int, roundness: Roundness
) -> BoolArray:
    """(count,) edges that bound a face of the curved surface."""
    if roundness.is_ball:
        return np.ones(count, dtype=np.bool_)
    a, b, c = np.moveaxis(vertices[faces], 1, 0)
    normal = np.cross(b - a, c - a)
    size = np.maximum(np.linalg.norm(normal, axis=1), 1e-300)
    is_end = np.abs(normal @ roundness.axes_model[0]) > _END_COSINE * size
    curved = np.zeros(count, dtype=np.bool_)
    curved[of_face[~is_end]] = True
    return curved


def _divided(faces: IntArray, middle: IntArray) -> IntArray:
    """Faces (n, 3) cut where their edges have a middle, (n, 3) vertices or -1."""
    out = [faces[(middle < 0).all(axis=1)]]
    for turn in range(3):
        # Each case once: with the edge, or the pair of edges, that it is about in front.
        a, b, c = np.roll(faces, -turn, axis=1).T
        ab, bc, ca = np.roll(middle, -turn, axis=1).T
        one = (ab >= 0) & (bc < 0) & (ca < 0)
        out += [np.column_stack(each)[one] for each in ((a, ab, c), (ab, b, c))]
        two = (ab >= 0) & (bc >= 0) & (ca < 0)
        out += [np.column_stack(each)[two] for each in ((ab, b, bc), (a, ab, c), (ab, bc, c))]
    (a, b, c), (ab, bc, ca) = faces.T, middle.T
    all_of_them = (middle >= 0).all(axis=1)
    corners = ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))
    out += [np.column_stack(each)[all_of_them] for each in corners]
    return np.vstack(out)
