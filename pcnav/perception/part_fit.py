"""Where the target is not as its mesh says: each part against the returns of a run's frames.

Returns are taken along with the pose into the model frame, where a part that is as in the mesh lies
on its surface, one that was turned on another plane, and one that is missing nowhere. No truth
enters: the poses are the run's own.
"""

from dataclasses import dataclass, field, replace
from enum import StrEnum

import numpy as np
import trimesh
from scipy import ndimage

from pcnav.core.arrays import BoolArray, DepthImage, FloatArray, IntArray
from pcnav.core.arrays import Part as ImagePart
from pcnav.core.camera import PinholeCamera
from pcnav.core.spatial import (
    exp_rotation,
    invert_transform,
    make_transform,
    transform_points,
)
from pcnav.perception.planes import ransac_plane
from pcnav.perception.sensor_noise import SensorNoise
from pcnav.recordings.sequence import Frame
from pcnav.target.parts import Part, Parts, parts_of
from pcnav.target.rendering import DepthRenderer, RenderedDepth
from pcnav.target.row_motion import Exposure
from pcnav.target.satellite import Target

_MAX_FRAMES = 24
"""Frames that are kept, evenly over the run."""
_MAX_POINTS = 3000
"""Returns that are kept of a frame."""
_REACH = 1.2
"""What returns within so many diameters of the model's origin may be the target's."""
_GATE_SIGMA = 4.0
_MIN_PIXELS, _MIN_FRAMES = 200, 3
"""A part of which less is seen is not judged."""
_FITS_SHARE = 0.7
"""Of the pixels of a part that nothing hides, explained: it is where the mesh has it."""
_MISSING_SHARE = 0.5
"""Seen through where it should be: it is not there."""
_MIN_ON_PLANE = 0.5
"""Of the returns about a part, on one plane, for that to be its face."""
_MIN_TURN_DEG, _CLEAR_SD = 1.0, 5.0
"""A face is turned when it is by so much, and by so many of its deviations."""
_ERRORS_PER_FRAME = 16
"""Returns of a face err alike over stretches of it: so many of a frame are independent."""
_MAX_TURN_COSINE = 0.1
_SAME_PLANE = 1e-4
"""Triangles are in a plane to this share of the diameter."""
_HINGE_REACH = 1.5
"""A part hangs on a hinge that is no farther from its middle than so many times its reach."""
_TRIALS = 200
_UNEXPLAINED, _ELSEWHERE = -1, -2
"""Returns that lie on no part of the mesh, and those that do, but not on its largest face."""


class PartVerdict(StrEnum):
    """What the frames say of a part."""

    FITS = "fits"
    TURNED = "turned"
    MISSING = "missing"
    DIFFERS = "differs"
    HARDLY_SEEN = "hardly seen"


@dataclass(frozen=True)
class PartFit:
    """A part against the frames."""

    name: str
    verdict: PartVerdict
    pixels: int
    """Of its surface that were predicted, and not hidden by something before the target."""
    explained_share: float
    """Of them, with a return where the mesh has the surface; nan where there are none."""
    seen_through_share: float
    """Of them, with a return from behind it, or none."""
    turn_deg: float = float("nan")
    """By which its largest flat face is turned against the mesh; nan where no plane was found."""
    turn_sd_deg: float = float("nan")
    axis_model: tuple[float, float, float] | None = None
    """About which, unit vector in the model frame; None of a part that is not turned."""
    T_model_part: FloatArray | None = field(default=None, compare=False)
    """(4, 4) motion of the model frame from where the mesh has a turned part to where it is."""


@dataclass(frozen=True)
class _Seen:
    """What one frame tells: counts by part, and returns in the model frame."""

    agree: IntArray
    through: IntArray
    """(n_parts,) pixels each."""
    points: FloatArray
    """(m, 3) m."""
    part: IntArray
    """(m,) part on whose largest face a return lies, or one of the two marks of others."""
    eye: FloatArray
    """(m, 3) where it is seen from, m."""


class MeshFit:
    """Takes in frames with their poses, and judges the parts of the mesh by them."""

    def __init__(self, target: Target) -> None:
        self._target = target
        self._parts: Parts | None = None
        self._faces: list[list[_LargestFace]] = []
        self._is_on_face = np.zeros(0, dtype=np.bool_)
        self._renderer: DepthRenderer | None = None
        self._shown: tuple[PinholeCamera, float] | None = None
        self._kept: list[_Seen] = []
        self._count, self._every = 0, 1
        self._sigma_m = 0.0

    def add(
        self,
        frame: Frame,
        T_cam_model: FloatArray,
        noise: SensorNoise,
        mesh_scale: float = 1.0,
        exposure: Exposure | None = None,
    ) -> None:
        """Take in a frame whose pose (4, 4) is known, the noise of its ranges, by how much the
        target is known to be larger than its mesh, and where that is when each pixel sees it, where
        not all do at once."""
        self._count += 1
        if (self._count - 1) % self._every:
            return
        if self._parts is None:
            self._parts = parts_of(self._target)
            self._faces = [
                _LargestFace.both(self._target, self._parts, part) for part in self._parts.each
            ]
            self._is_on_face = np.zeros(len(self._target.mesh.faces), dtype=np.bool_)
            for face in (face for both in self._faces for face in both):
                self._is_on_face[face.members] = True
        if self._renderer is None or (frame.camera, mesh_scale) != self._shown:
            self._shown = frame.camera, mesh_scale
            target = self._target if mesh_scale == 1.0 else self._target.scaled(mesh_scale)
            self._renderer = DepthRenderer(target.mesh, frame.camera)
        self._sigma_m = sigma_m = noise.sigma_in(frame.depth_m)
        rendered = self._renderer.render(T_cam_model, exposure)
        reach_m = _REACH * mesh_scale * self._target.diameter_m
        seen = _seen(
            *(frame, T_cam_model, rendered, self._parts, self._is_on_face),
            *(sigma_m, reach_m, exposure),
        )
        points, eye = seen.points / mesh_scale, seen.eye / mesh_scale
        self._kept.append(replace(seen, points=points, eye=eye))
        if len(self._kept) > _MAX_FRAMES:
            # Every second one is left out, so that what is kept stays even over the run.
            self._kept, self._every = self._kept[::2], 2 * self._every

    @property
    def frames(self) -> int:
        """That were taken in."""
        return self._count

    def parts(self, max_explained: float = 1.0) -> tuple[PartFit, ...]:
        """Every part, the largest first; none before a frame.

        Parts of which more than ``max_explained`` is explained are taken to be where they should
        be, without a look at how they may be turned.
        """
        if self._parts is None or not self._kept:
            return ()
        agree = np.stack([seen.agree for seen in self._kept])
        through = np.stack([seen.through for seen in self._kept])
        points, eye = (
            np.concatenate([getattr(seen, name) for seen in self._kept])
            for name in ("points", "eye")
        )
        owner = np.concatenate([seen.part for seen in self._kept])
        found = []
        for k, part in enumerate(self._parts.each):
            about = (owner == k) | (owner == _UNEXPLAINED)
            fits = agree[:, k].sum() > max_explained * (agree[:, k] + through[:, k]).sum()
            near = about & (not fits)
            counts = agree[:, k], through[:, k]
            found.append(self._judged(part, self._faces[k], *counts, points[near], eye[near]))
        return tuple(found)

    def _judged(
        self,
        part: Part,
        faces: "list[_LargestFace]",
        agree: IntArray,
        through: IntArray,
        points: FloatArray,
        eye: FloatArray,
    ) -> PartFit:
        pixels = int(agree.sum() + through.sum())
        frames = int(np.count_nonzero(agree + through))
        if pixels < _MIN_PIXELS or frames < _MIN_FRAMES:
            return PartFit(part.name, PartVerdict.HARDLY_SEEN, pixels, np.nan, np.nan)
        shares = float(agree.sum()) / pixels, float(through.sum()) / pixels
        turn = self._turn(faces, points, eye, _ERRORS_PER_FRAME * frames)
        if turn is not None and turn.is_clear:
            axis = (float(turn.axis[0]), float(turn.axis[1]), float(turn.axis[2]))
            return PartFit(
                *(part.name, PartVerdict.TURNED, pixels, *shares),
                *(turn.angle_deg, turn.sd_deg, axis, turn.T_model_part),
            )
        found = (np.nan, np.nan) if turn is None else (turn.angle_deg, turn.sd_deg)
        verdict = PartVerdict.FITS
        if shares[0] < _FITS_SHARE:
            is_gone = shares[1] > _MISSING_SHARE
            verdict = PartVerdict.MISSING if is_gone else PartVerdict.DIFFERS
        return PartFit(part.name, verdict, pixels, *shares, *found)

    def _turn(
        self, faces: "list[_LargestFace]", points: FloatArray, eye: FloatArray, n_errors: int
    ) -> "_Turn | None":
        """By the side of a part's largest face that more is seen of."""
        best: tuple[int, _LargestFace, FloatArray] | None = None
        for face in faces:
            seen = np.sum((eye - face.centre) * face.normal, axis=1) > 0.0
            near = points[seen & (np.linalg.norm(points - face.centre, axis=1) < face.reach_m)]
            if best is None or len(near) > best[0]:
                best = len(near), face, near
        return None if best is None else _turn(best[1], best[2], self._sigma_m, n_errors)


def _seen(
    frame: Frame,
    T_cam_model: FloatArray,
    rendered: RenderedDepth,
    parts: Parts,
    is_on_face: BoolArray,
    sigma_m: float,
    reach_m: float,
    exposure: Exposure | None,
) -> _Seen:
    n_parts, part_of_image = len(parts.each), _worth_looking_at(frame.depth_m, rendered.triangle)
    depth_m, shown = frame.depth_m[part_of_image], rendered.triangle[part_of_image]
    label = np.where(shown >= 0, parts.of_triangle[shown], _UNEXPLAINED)
    inside, returned = _inside(label), depth_m > 0.0
    if frame.beams is not None:
        # Of a pixel that no beam fell in nothing is known.
        inside &= frame.beams.is_seen[part_of_image]
    tolerance_m = _GATE_SIGMA * sigma_m
    rays = rendered.rays[part_of_image]
    per_depth = rendered.range_per_depth[part_of_image]
    residual = (depth_m - rendered.depth_m[part_of_image]) * per_depth
    agrees = (shown >= 0) & returned & (np.abs(residual) < tolerance_m)
    through = inside & (~returned | (residual >= tolerance_m))
    counts = [
        np.bincount(label[pixels], minlength=n_parts).astype(np.intp)
        for pixels in (inside & agrees, through)
    ]
    # The wall of a ring that lies where it should would tilt the plane of the ring's face.
    owner = np.where(is_on_face[shown], label, _ELSEWHERE)
    owner[~(agrees & inside)] = _UNEXPLAINED
    # What agrees beside an edge may be of either side; what does not is on no part of the mesh.
    rows, columns = np.nonzero(returned & (inside | ~agrees))
    p_cam = rays[rows, columns] * depth_m[rows, columns].astype(np.float64)[:, None]
    near = np.flatnonzero(np.sum((p_cam - T_cam_model[:3, 3]) ** 2, axis=-1) < reach_m**2)
    near = near[:: max(len(near) // _MAX_POINTS, 1)]
    part = owner[rows[near], columns[near]]
    if exposure is None:
        T_model_cam = invert_transform(T_cam_model)
        points = transform_points(T_model_cam, p_cam[near])
        eye = np.broadcast_to(T_model_cam[:3, 3], points.shape)
    else:
        index = exposure.index[part_of_image][rows[near], columns[near]]
        points, eye = _in_model(exposure.poses[index], p_cam[near])
    return _Seen(counts[0], counts[1], points, part, eye)


def _in_model(T_cam_model: FloatArray, p_cam: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Points (n, 3) in the model's frame, and where each is seen from, each with a pose (n, 4, 4)
    of its own."""
    R_model_cam, p = np.swapaxes(T_cam_model[:, :3, :3], 1, 2), T_cam_model[:, :3, 3]
    eye = -np.einsum("nij,nj->ni", R_model_cam, p)
    return np.einsum("nij,nj->ni", R_model_cam, p_cam) + eye, eye


def _worth_looking_at(depth_m: DepthImage, shown: IntArray) -> ImagePart:
    """The rows and columns that hold all returns and all of the view, and one more about them."""
    some = (depth_m > 0.0) | (shown >= 0)
    spans = []
    for axis in (1, 0):
        places = np.flatnonzero(some.any(axis=axis))
        first, last = (places[0], places[-1]) if len(places) else (0, -1)
        spans.append(slice(max(int(first) - 1, 0), int(last) + 2))
    return spans[0], spans[1]


def _inside(label: IntArray) -> BoolArray:
    """Pixels (height, width) on a part with nothing but that part about them."""
    same = ndimage.minimum_filter(label, 3) == ndimage.maximum_filter(label, 3)
    return np.asarray(same & (label >= 0))


@dataclass(frozen=True)
class _LargestFace:
    """A side of the largest flat face of a part. Model frame, m."""

    members: IntArray
    """Triangles of the mesh."""
    centre: FloatArray
    normal: FloatArray
    reach_m: float
    """From its centre to its farthest corner."""

    @staticmethod
    def both(target: Target, parts: Parts, part: Part) -> "list[_LargestFace]":
        """The face, and the largest of the part that looks the other way: of a plate seen from
        behind, its back."""
        mesh = target.mesh
        front = np.asarray(mesh.face_normals[part.largest_face], dtype=np.float64)
        own = parts.of_triangle == parts.of_triangle[part.largest_face]
        offset = np.sum(mesh.triangles_center * front, axis=1)
        found = []
        for normal in (front, -front):
            along = np.flatnonzero(own & (mesh.face_normals @ normal > 1.0 - 1e-6))
            if not len(along):
                continue
            step_m = _SAME_PLANE * target.diameter_m
            _, plane = np.unique(np.round(offset[along] / step_m), return_inverse=True)
            areas = np.bincount(plane, weights=mesh.area_faces[along])
            found.append(_LargestFace._of(mesh, along[plane == np.argmax(areas)], normal))
        return found

    @staticmethod
    def _of(mesh: trimesh.Trimesh, members: IntArray, normal: FloatArray) -> "_LargestFace":
        weights = mesh.area_faces[members]
        centre = np.average(mesh.triangles_center[members], axis=0, weights=weights)
        corners = mesh.triangles[members].reshape(-1, 3)
        reach = float(np.max(np.linalg.norm(corners - centre, axis=1)))
        return _LargestFace(members, np.asarray(centre, dtype=np.float64), normal, reach)


@dataclass(frozen=True)
class _Turn:
    angle_deg: float
    sd_deg: float
    axis: FloatArray
    T_model_part: FloatArray

    @property
    def is_clear(self) -> bool:
        return self.angle_deg > max(_MIN_TURN_DEG, _CLEAR_SD * self.sd_deg)


def _turn(face: _LargestFace, near: FloatArray, sigma_m: float, n_errors: int) -> _Turn | None:
    """How the plane of most returns (n, 3) about a face lies against it; None where most lie on
    none.

    ``n_errors`` of them are independent.
    """
    if len(near) < _MIN_PIXELS:
        return None
    tolerance_m = _GATE_SIGMA * sigma_m
    # Planes are told by their distance from the origin, which none may pass through.
    seen_from = near - face.centre + 4.0 * face.reach_m * face.normal
    plane = ransac_plane(seen_from, tolerance_m, _TRIALS, seed=0)
    if plane is None:
        return None
    on = near[np.abs(seen_from @ plane - 1.0) < tolerance_m * np.linalg.norm(plane)]
    if len(on) < _MIN_ON_PLANE * len(near):
        return None
    centre = on.mean(axis=0)
    _, spread, axes = np.linalg.svd(on - centre, full_matrices=False)
    normal = axes[2] * np.sign(axes[2] @ face.normal or 1.0)
    cosine = float(normal @ face.normal)
    if cosine < _MAX_TURN_COSINE or not spread[1] > 0.0:
        return None
    angle = float(np.rad2deg(np.arccos(min(cosine, 1.0))))
    axis = np.cross(face.normal, normal)
    axis = axis / max(float(np.linalg.norm(axis)), 1e-12)
    n_errors = min(n_errors, len(on))
    sd = float(np.rad2deg(spread[2] / np.sqrt(n_errors) / spread[1]))
    return _Turn(angle, sd, axis, _motion(face, axis, np.deg2rad(angle), normal, centre))


def _motion(
    face: _LargestFace, axis: FloatArray, angle_rad: float, normal: FloatArray, point: FloatArray
) -> FloatArray:
    """(4, 4) that takes a face to the plane of a normal through a point (3,): a turn about the
    line in which the two planes meet, where that is a hinge within reach, else about its centre
    and along the normal."""
    R = exp_rotation(angle_rad * axis)
    planes = np.stack([face.normal, normal, axis])
    offsets = np.array([face.normal @ face.centre, normal @ point, axis @ face.centre])
    pivot, shift = face.centre, np.zeros(3)
    hinge = np.linalg.solve(planes, offsets) if angle_rad > 0.0 else np.full(3, np.inf)
    if np.linalg.norm(hinge - face.centre) < _HINGE_REACH * face.reach_m:
        pivot = hinge
    else:
        shift = normal * float(normal @ (point - face.centre))
    return make_transform(R, pivot - R @ pivot + shift)
