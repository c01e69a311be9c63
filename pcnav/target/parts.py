"""The parts of a mesh: what hangs together in it, as an assembly's bodies do."""

from dataclasses import dataclass
from weakref import WeakKeyDictionary

import numpy as np
import trimesh
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from pcnav.core.arrays import FloatArray, IntArray
from pcnav.core.spatial import invert_transform, transform_points
from pcnav.target.mesh import mesh_diameter
from pcnav.target.satellite import Target

_MIN_AREA_SHARE = 0.01
"""Of the mesh's area; what is smaller belongs to the part that it is nearest to."""
_BODY_AREA_SHARE = 0.05
"""Of the mesh's area, for a body to be more than equipment on another one."""
_WHOLE_AREA_SHARE = 0.8
"""Of a body, for it to be nearly all of the mesh."""
_MERGE_FRACTION = 1e-6
"""Vertices closer than this share of the diameter are one."""
_ON_FACE_FRACTION = 1e-3
"""A point is on a face of the catalogue within this share of the diameter."""
_SEVERAL_BODIES: WeakKeyDictionary[trimesh.Trimesh, bool] = WeakKeyDictionary()
"""Of meshes in use, as far as it was asked for: each mesh is like itself alone."""


@dataclass(frozen=True)
class Part:
    """A body of the mesh."""

    name: str
    """Common to the catalogue's faces on it, else its number by falling area."""
    area_m2: float
    largest_face: int
    """One triangle of its largest flat face: the normal that a turn of it is told by."""


@dataclass(frozen=True)
class Parts:
    """All parts of a mesh, the largest first."""

    each: tuple[Part, ...]
    of_triangle: IntArray
    """(n_faces,) place of the part that a triangle belongs to."""
    of_rectangle: IntArray
    """(n_rectangles,) that a face of the catalogue is on, -1 for none."""


def has_several_bodies(mesh: trimesh.Trimesh) -> bool:
    """Whether it consists of more than one body of which anything can be seen to be turned.

    A mesh of very many faces is not looked through more than once.
    """
    if mesh not in _SEVERAL_BODIES:
        areas = np.bincount(_bodies(mesh), weights=mesh.area_faces)
        large = np.count_nonzero(areas >= _BODY_AREA_SHARE * areas.sum())
        _SEVERAL_BODIES[mesh] = bool(large > 1)
    return _SEVERAL_BODIES[mesh]


def parts_of(target: Target) -> Parts:
    """The bodies of a target's mesh, and the faces of the catalogue on one that is nearly all of
    it: a file may have joined its bodies."""
    mesh = target.mesh
    labels = _bodies(mesh)
    areas = np.bincount(labels, weights=mesh.area_faces)
    whole = int(np.argmax(areas))
    if areas[whole] > _WHOLE_AREA_SHARE * areas.sum():
        faces = _faces(target)
        labels = np.where((labels == whole) & (faces >= 0), len(areas) + faces, labels)
    areas = np.bincount(labels, weights=mesh.area_faces)
    large = np.flatnonzero(areas >= _MIN_AREA_SHARE * areas.sum())
    if not large.size:
        large = np.array([int(np.argmax(areas))])
    large = large[np.argsort(-areas[large], kind="stable")]
    place = np.full(len(areas), -1, dtype=np.intp)
    place[large] = np.arange(len(large))
    body = place[labels]
    of_triangle = body.copy()
    small = of_triangle < 0
    if small.any():
        # By corners: where exactly what is small belongs does not matter.
        own = np.flatnonzero(~small)
        nearest = cKDTree(mesh.triangles[own].reshape(-1, 3)).query(mesh.triangles_center[small])[1]
        of_triangle[small] = of_triangle[own[nearest // 3]]
    faces, parts = _faces(target), []
    for k in range(len(large)):
        members = np.flatnonzero(of_triangle == k)
        # What was small and only lies near has no say in its name.
        on = np.unique(faces[(body == k) & (faces >= 0)])
        parts.append(_part(mesh, members, [target.rectangles[face].name for face in on], k + 1))
    # What stands on a face has its own foot in it.
    on_face = np.zeros((len(target.rectangles), len(large)))
    np.add.at(on_face, (faces[faces >= 0], of_triangle[faces >= 0]), mesh.area_faces[faces >= 0])
    of_rectangle = np.where(on_face.any(axis=1), np.argmax(on_face, axis=1), -1)
    return Parts(tuple(parts), of_triangle, of_rectangle)


def _bodies(mesh: trimesh.Trimesh) -> IntArray:
    """(n_faces,) label of what hangs together by shared corners."""
    scale = _MERGE_FRACTION * mesh_diameter(mesh)
    _, corner = np.unique(np.round(mesh.vertices / scale), axis=0, return_inverse=True)
    corners = np.ravel(corner)[mesh.faces]
    n = int(corners.max()) + 1
    pairs = np.vstack([corners[:, :2], corners[:, 1:]])
    graph = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(n, n))
    return np.asarray(connected_components(graph, directed=False)[1][corners[:, 0]])


def _part(mesh: trimesh.Trimesh, members: IntArray, names: list[str], number: int) -> Part:
    return Part(
        name=_shared_name(names) or f"part {number}",
        area_m2=float(mesh.area_faces[members].sum()),
        largest_face=int(members[np.argmax(_flat_areas(mesh, members))]),
    )


def _shared_name(names: list[str]) -> str:
    """The words that names begin with; none if these are only what a face without a name is
    called."""
    words: list[str] = []
    for own in zip(*(name.split("_") for name in names), strict=False):
        if len(set(own)) > 1:
            break
        words.append(own[0])
    return "" if len(names) > 1 and words == ["rectangle"] else "_".join(words)


def _flat_areas(mesh: trimesh.Trimesh, members: IntArray) -> FloatArray:
    """(n,) area of all triangles of a part that look the way that each of them does."""
    _, way = np.unique(np.round(mesh.face_normals[members], 3), axis=0, return_inverse=True)
    way = np.ravel(way)
    return np.asarray(np.bincount(way, weights=mesh.area_faces[members])[way])


def _faces(target: Target) -> IntArray:
    """(n_faces,) place in the catalogue of the face that a triangle is part of, -1 for none."""
    mesh, slack = target.mesh, _ON_FACE_FRACTION * target.diameter_m
    found = np.full(len(mesh.faces), -1, dtype=np.intp)
    for k, rectangle in enumerate(target.rectangles):
        T_rect_model = invert_transform(rectangle.T_model_rect)
        corners = np.abs(transform_points(T_rect_model, mesh.triangles.reshape(-1, 3)))
        half = np.array([0.5 * rectangle.width_m, 0.5 * rectangle.length_m, 0.0])
        on = np.all((corners < half + slack).reshape(-1, 9), axis=1)
        found[on & (found < 0)] = k
    return found
