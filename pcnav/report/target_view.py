"""A shaded view of a target from afar: its surface, its rectangles, what lies behind it."""

from dataclasses import dataclass

import numpy as np
from matplotlib.colors import to_rgb

from pcnav.core.arrays import BoolArray, FloatArray, IntArray
from pcnav.core.camera import PinholeCamera, pixel_rays, project
from pcnav.core.spatial import invert_transform, make_transform, transform_points
from pcnav.report.figures import CATEGORIES
from pcnav.target.rendering import DepthRenderer, RenderedDepth
from pcnav.target.satellite import Rectangle, Target

SIZE_PX = 480
_RANGE_DIAMETERS = 40.0
"""From so far lines that are parallel stay so."""
_MARGIN = 1.1
_SURFACE = (0.80, 0.82, 0.85)
_TINT = 0.55
_AMBIENT = 0.5
_SUN_CAM = np.array([-0.35, -0.55, -0.76])
"""Towards the light, camera axes: over the left shoulder."""
_ON_RECTANGLE_FRACTION = 2e-3
_HIDING_FRACTION = 4e-3
"""What lies off the surface, or behind it, by more than these shares of the diameter is not on it,
or hidden."""


@dataclass(frozen=True)
class TargetView:
    """A target seen from one direction."""

    rendered: RenderedDepth
    T_cam_model: FloatArray
    """(4, 4)."""
    image: FloatArray
    """(height, width, 4) red, green, blue, opacity."""
    diameter_m: float

    @property
    def camera(self) -> PinholeCamera:
        """That took it."""
        return self.rendered.camera

    def pixels(self, points_model: FloatArray) -> FloatArray:
        """(..., 2) where points (..., 3) are imaged."""
        flat = transform_points(self.T_cam_model, points_model.reshape(-1, 3))
        return np.asarray(project(self.camera, flat).reshape(*points_model.shape[:-1], 2))

    def shown(self, points_model: FloatArray) -> BoolArray:
        """(n,) whether points (n, 3), model frame, m, are hidden by nothing."""
        points = transform_points(self.T_cam_model, points_model)
        u, v = np.rint(project(self.camera, points)).astype(np.intp).T
        inside = (u >= 0) & (u < self.camera.width) & (v >= 0) & (v < self.camera.height)
        depth = np.full(len(points), np.inf)
        seen = self.rendered.depth_m[v[inside], u[inside]].astype(np.float64)
        depth[inside] = np.where(seen > 0.0, seen, np.inf)
        return np.asarray(points[:, 2] <= depth + _HIDING_FRACTION * self.diameter_m)


def view_from(target: Target, direction_model: FloatArray, up_model: FloatArray) -> TargetView:
    """The target from a direction (3,), which points from it to the eye, with another (3,) up."""
    middle = np.asarray(target.mesh.bounds).mean(axis=0)
    distance_m = _RANGE_DIAMETERS * target.diameter_m
    z = -direction_model / np.linalg.norm(direction_model)
    x = np.cross(z, up_model)
    x /= np.linalg.norm(x)
    R_cam_model = np.stack([x, np.cross(z, x), z])
    T_cam_model = make_transform(R_cam_model, -R_cam_model @ middle + [0.0, 0.0, distance_m])
    vertices = transform_points(T_cam_model, np.asarray(target.mesh.vertices))
    half = float(np.abs(vertices[:, :2] / vertices[:, 2:]).max())
    focal = 0.5 * SIZE_PX / (_MARGIN * half)
    camera = PinholeCamera(SIZE_PX, SIZE_PX, focal, focal, 0.5 * SIZE_PX - 0.5, 0.5 * SIZE_PX - 0.5)
    rendered = DepthRenderer(target.mesh, camera).render(T_cam_model)
    image = _shaded(target, rendered, T_cam_model)
    return TargetView(rendered, T_cam_model, image, target.diameter_m)


def colour_of(index: int) -> tuple[float, float, float]:
    """Of a rectangle of the catalogue."""
    return to_rgb(CATEGORIES[index % len(CATEGORIES)])


def _shaded(target: Target, rendered: RenderedDepth, T_cam_model: FloatArray) -> FloatArray:
    image = np.zeros((*rendered.depth_m.shape, 4))
    seen = rendered.triangle >= 0
    faces = rendered.triangle[seen]
    rays = pixel_rays(rendered.camera)[seen]
    points_cam = rays * rendered.depth_m[seen].astype(np.float64)[:, None]
    points = transform_points(invert_transform(T_cam_model), points_cam)
    normals_model = np.array(target.mesh.face_normals)[faces]
    normals = normals_model @ T_cam_model[:3, :3].T
    # A face is lit on the side that is seen, however it is wound.
    normals *= np.where(np.einsum("ij,ij->i", normals, rays) > 0.0, -1.0, 1.0)[:, None]
    light = np.clip(normals @ _SUN_CAM / np.linalg.norm(_SUN_CAM), 0.0, 1.0)
    colour = np.tile(_SURFACE, (len(faces), 1))
    for index, rectangle in reversed(list(enumerate(target.rectangles))):
        on = _lies_on(rectangle, points, normals_model, target.diameter_m)
        colour[on] = (1.0 - _TINT) * np.array(_SURFACE) + _TINT * np.array(colour_of(index))
    image[seen, :3] = colour * (_AMBIENT + (1.0 - _AMBIENT) * light)[:, None]
    image[seen, 3] = 1.0
    creases = _creases(rendered.triangle, seen, normals)
    image[creases, :3] *= 0.6
    return image


def _lies_on(
    rectangle: Rectangle, points: FloatArray, normals: FloatArray, diameter_m: float
) -> BoolArray:
    """(n,) whether points (n, 3) of faces with normals (n, 3) lie on a rectangle."""
    local = transform_points(invert_transform(rectangle.T_model_rect), points)
    half = 0.5 * np.array([rectangle.width_m, rectangle.length_m])
    within = np.all(np.abs(local[:, :2]) <= half, axis=1)
    near = np.abs(local[:, 2]) < _ON_RECTANGLE_FRACTION * diameter_m
    along = np.abs(normals @ rectangle.T_model_rect[:3, 2]) > 0.99
    return np.asarray(within & near & along)


def _creases(triangle: IntArray, seen: BoolArray, normals: FloatArray) -> BoolArray:
    """(height, width) pixels at which the surface is bent sharply or ends."""
    facing = np.zeros((*triangle.shape, 3))
    facing[seen] = normals
    found = np.zeros(triangle.shape, dtype=np.bool_)
    for axis in (0, 1):
        cosine = np.einsum("ijk,ijk->ij", facing, np.roll(facing, -1, axis=axis))
        found |= cosine < np.cos(np.radians(20.0))
    return found & seen
