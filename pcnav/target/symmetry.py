"""The proper rigid motions that map a target onto itself, and what their group is called."""

import numpy as np
import trimesh
from scipy.spatial import cKDTree

from pcnav.core.arrays import BoolArray, FloatArray
from pcnav.core.spatial import log_rotation, make_transform, rotation_angle, transform_points
from pcnav.target.facets import PlanarFace
from pcnav.target.mesh import mesh_diameter, seen_from_outside

SYMMETRY_TOLERANCE = 0.005
"""A motion is a symmetry when no visible point of the mesh leaves the surface by more than this
fraction of the diameter."""
_CONGRUENT = 0.01
"""Relative agreement of area and second moments of faces that may map onto one another."""
_ISOTROPIC = 0.05
"""Faces whose in-plane second moments differ by less have no principal axes to match."""
_SAME_ANGLE_RAD = np.radians(1.0)
_SURFACE_SAMPLES = 30_000
_PROBES = 1_500
_NEIGHBOURS = 6


def symmetry_motions(
    mesh: trimesh.Trimesh,
    faces: tuple[PlanarFace, ...],
    tolerance_fraction: float = SYMMETRY_TOLERANCE,
) -> FloatArray:
    """(n, 4, 4) proper rigid motions of the model frame that map the mesh onto itself.

    The first is the identity, the rest come in order of angle. Every symmetry takes a flat face
    to a congruent one, so the candidates are the motions that take one reference face to each face
    congruent with it; one is a symmetry when it leaves every visible point of the mesh within
    `tolerance_fraction` of the diameter from the surface. Reflections are never candidates. A
    body of revolution, whose group is infinite, gives the finite group of its tessellation.
    Without faces only the identity is returned.
    """
    identity = np.eye(4)
    tolerance = tolerance_fraction * mesh_diameter(mesh)
    candidates = _candidates(faces, tolerance)
    found = [identity]
    if len(candidates) > 1:
        surface = _Surface(mesh)
        probes = _visible_probes(mesh)
        for T in candidates:
            known = any(_same_motion(T, other, tolerance) for other in found)
            if not known and _maps_onto(T, probes, surface, tolerance):
                found.append(T)
    return _closed(found, mesh, tolerance)


def group_name(motions: FloatArray) -> str:
    """Schoenflies name of a group of motions (n, 4, 4), with its axis where it has a main one.

    "C1", "C2 about z", "D2", "D4 about z", "T", "O" or "I"; an axis off the model's is given by
    its direction.
    """
    count = len(motions)
    if count == 1:
        return "C1"
    vectors = log_rotation(motions[1:, :3, :3])
    angles = np.linalg.norm(vectors, axis=1)
    smallest = int(np.argmin(angles))
    order = round(2.0 * np.pi / float(angles[smallest]))
    axis = _axis_name(vectors[smallest] / angles[smallest])
    if count == order:
        return f"C{order} about {axis}"
    if count == 2 * order:
        return "D2" if order == 2 else f"D{order} about {axis}"
    return {12: "T", 24: "O", 60: "I"}.get(count, f"a group of {count}")


def half_turns(mesh: trimesh.Trimesh) -> FloatArray:
    """(3, 4, 4) half turns about the principal axes of a mesh's surface, model frame."""
    corners, area = np.asarray(mesh.triangles), np.asarray(mesh.area_faces)
    middles = corners.mean(axis=1)
    weight = area / area.sum()
    centre = weight @ middles
    # The second moment of a triangle is that of its corners and, ninefold, of its middle, over 12.
    corners, middles = corners - centre, middles - centre
    second = np.einsum("n,nki,nkj->ij", weight, corners, corners)
    second = (second + 9.0 * np.einsum("n,ni,nj->ij", weight, middles, middles)) / 12.0
    axes = np.linalg.eigh(second)[1]
    turns = []
    for axis in axes.T:
        R = 2.0 * np.outer(axis, axis) - np.eye(3)
        turns.append(make_transform(R, centre - R @ centre))
    return np.stack(turns)


def _axis_name(axis: FloatArray) -> str:
    aligned = np.abs(axis) > np.cos(_SAME_ANGLE_RAD)
    if aligned.any():
        return "xyz"[int(np.argmax(aligned))]
    axis = axis * np.sign(axis[int(np.argmax(np.abs(np.round(axis, 6))))])
    return "({:.3f}, {:.3f}, {:.3f})".format(*(axis + 0.0))


def _candidates(faces: tuple[PlanarFace, ...], tolerance_m: float) -> list[FloatArray]:
    """The motions that take one face to each face congruent with it: as few as can be had."""
    if not faces:
        return []
    shapes = np.array([_shape(face) for face in faces])
    frames = [_anchor_frames(face, tolerance_m) for face in faces]
    counts = np.array([len(own) for own in frames])
    congruent = np.all(np.abs(shapes[:, None] - shapes) <= _CONGRUENT * shapes + 1e-12, axis=-1)
    reference = int(np.argmin(congruent @ counts))
    T_face_model = np.linalg.inv(frames[reference][0])
    targets = np.flatnonzero(congruent[:, reference])
    return [T_model_face @ T_face_model for k in targets for T_model_face in frames[k]]


def _shape(face: PlanarFace) -> FloatArray:
    """(4,) lengths that congruent faces share, and 1 for a two-sided face."""
    spread = np.sqrt(np.linalg.eigvalsh(face.second_moments_m2))
    return np.array([*spread, np.sqrt(face.area_m2), float(face.two_sided)])


def _anchor_frames(face: PlanarFace, tolerance_m: float) -> list[FloatArray]:
    """Frames (4, 4) of a face among which any of its own symmetries permutes.

    Their origin is the centroid, x a direction the shape singles out: its long principal axis
    either way or, where it has none, the directions of its farthest corners; z the normal, on a
    two-sided face either way.
    """
    variances, axes = np.linalg.eigh(face.second_moments_m2)
    if variances[1] > (1.0 + _ISOTROPIC) * variances[0]:
        directions = np.stack([axes[:, 1], -axes[:, 1]])
    else:
        reach = np.linalg.norm(face.outline, axis=1)
        far = face.outline[reach > reach.max() - tolerance_m]
        directions = far / np.linalg.norm(far, axis=1, keepdims=True)
    frames = []
    R_model_face, centroid = face.T_model_face[:3, :3], face.T_model_face[:3, 3]
    for side in (1.0, -1.0) if face.two_sided else (1.0,):
        z = side * R_model_face[:, 2]
        for direction in directions:
            x = R_model_face[:, :2] @ direction
            frames.append(make_transform(np.column_stack([x, np.cross(z, x), z]), centroid))
    return frames


class _Surface:
    """Tells whether points lie on a mesh: by the nearest surface samples, then exactly."""

    def __init__(self, mesh: trimesh.Trimesh) -> None:
        points, faces = trimesh.sample.sample_surface(mesh, _SURFACE_SAMPLES, seed=0)
        # Points hard by the corners make sure that no small face is without a sample. They stay off
        # the vertices, where the neighbours found would all be one vertex, shared by other faces.
        self._faces = np.concatenate([faces, np.repeat(np.arange(len(mesh.faces)), 3)])
        self._tree = cKDTree(np.vstack([points, _near_corners(mesh)]))
        self._triangles = np.asarray(mesh.triangles)

    def holds(self, points: FloatArray, tolerance_m: float) -> bool:
        """Whether all points (n, 3) are within the tolerance of the surface."""
        _, nearest = self._tree.query(points, k=_NEIGHBOURS)
        distance = _distance(points, self._triangles[self._faces[nearest]])
        doubtful = np.flatnonzero(distance > tolerance_m)
        # The samples miss a triangle now and then; only every triangle gives the true distance.
        # The worst point comes first, so that one look settles most motions that are none.
        for k in doubtful[np.argsort(-distance[doubtful])]:
            if _distance(points[k : k + 1], self._triangles[None])[0] > tolerance_m:
                return False
        return True


def _distance(points: FloatArray, triangles: FloatArray) -> FloatArray:
    """(n,) distance of each point (n, 3) to the nearest of its own triangles (n, m, 3, 3)."""
    count = triangles.shape[1]
    repeated = np.repeat(points, count, axis=0)
    closest = trimesh.triangles.closest_point(triangles.reshape(-1, 3, 3), repeated)
    distance = np.linalg.norm(closest - repeated, axis=1)
    return np.asarray(distance.reshape(-1, count).min(axis=1))


def _near_corners(mesh: trimesh.Trimesh) -> FloatArray:
    """(3 faces, 3) points of the faces next to their corners, face by face."""
    inset = 0.98 * np.eye(3) + 0.02 / 3.0
    return np.asarray(np.einsum("kj,nji->nki", inset, mesh.triangles).reshape(-1, 3))


def _visible_probes(mesh: trimesh.Trimesh) -> FloatArray:
    """(n, 3) points of the surface that are seen from outside: corners of faces and samples."""
    samples, owner = trimesh.sample.sample_surface(mesh, _PROBES, seed=1)
    # Just inside its corners a face has a definite normal and is still as far out as it gets.
    points = np.vstack([samples, _near_corners(mesh)])
    normals = mesh.face_normals[np.concatenate([owner, np.repeat(np.arange(len(mesh.faces)), 3)])]
    if len(points) > 3 * _PROBES:
        chosen = np.random.default_rng(2).choice(len(points), 3 * _PROBES, replace=False)
        points, normals = points[chosen], normals[chosen]
    clearance = 1e-4 * mesh_diameter(mesh)
    seen = seen_from_outside(mesh, points, normals, clearance)
    seen |= seen_from_outside(mesh, points, -normals, clearance)
    return np.asarray(points[seen])


def _maps_onto(T: FloatArray, probes: FloatArray, surface: _Surface, tolerance_m: float) -> bool:
    """Whether the moved probes all lie on the surface; most motions fail on the first few."""
    first_few = probes[:: max(1, len(probes) // 100)]
    return all(
        surface.holds(transform_points(T, some), tolerance_m) for some in (first_few, probes)
    )


def _same_motion(T: FloatArray, other: FloatArray, tolerance_m: float) -> bool:
    difference = np.linalg.inv(T) @ other
    near = bool(np.linalg.norm(difference[:3, 3]) < 2.0 * tolerance_m)
    return near and float(rotation_angle(difference[:3, :3])) < _SAME_ANGLE_RAD


def _closed(found: list[FloatArray], mesh: trimesh.Trimesh, tolerance_m: float) -> FloatArray:
    """The largest set of the found motions that composition does not leave, sorted by angle.

    Only a motion that fits barely within the tolerance can break closure; it is then dropped.
    """
    # About the mesh's centre the translations of equal motions agree best.
    centre = make_transform(np.eye(3), mesh.bounds.mean(axis=0))
    motions = np.linalg.inv(centre) @ np.array(found) @ centre
    while True:
        products = motions[:, None] @ motions[None, :]
        member = _members(products.reshape(-1, 4, 4), motions, tolerance_m)
        strays = (~member.reshape(len(motions), -1)).sum(axis=1)
        if not strays.any():
            break
        motions = np.delete(motions, int(np.argmax(strays)), axis=0)
    angles = np.round(rotation_angle(motions[:, :3, :3]), 4)
    axes = np.round(log_rotation(motions[:, :3, :3]), 4)
    order = np.lexsort((axes[:, 0], axes[:, 1], -axes[:, 2], angles))
    return np.asarray(centre @ motions[order] @ np.linalg.inv(centre))


def _members(products: FloatArray, motions: FloatArray, tolerance_m: float) -> BoolArray:
    """(n,) whether each product is one of the motions, within twice their own tolerance."""
    trace = np.einsum("nij,mij->nm", products[:, :3, :3], motions[:, :3, :3])
    angle = np.arccos(np.clip((trace - 1.0) / 2.0, -1.0, 1.0))
    shift = np.linalg.norm(products[:, None, :3, 3] - motions[None, :, :3, 3], axis=-1)
    near = (angle < 2.0 * _SAME_ANGLE_RAD) & (shift < 4.0 * tolerance_m)
    return np.asarray(near.any(axis=1))
