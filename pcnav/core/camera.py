"""The pinhole depth camera: the only place that knows where pixel centres are.

Pixel centres lie at integer coordinates (BOP): pixel (u, v) looks along
``((u - cx) / fx, (v - cy) / fy, 1)`` in the OpenCV camera frame (x right, y down, z forward), or
along the ray that a distorting lens bends there.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from pcnav.core.arrays import BoolArray, FloatArray
from pcnav.core.distortion import Distortion

_PARALLEL_SINE = 1e-6
"""A direction closer to nadir or zenith than this (rad) leaves image down undefined."""
_PIECES_OF_A_SIDE = 16
"""That the side of a drawn outline is cut into where a lens bends it."""
_KEPT = 12
"""Images kept of what depends on the camera alone, of one camera and of its strided ones."""


@dataclass(frozen=True)
class PinholeCamera:
    """Size and intrinsics of a depth camera, all in pixels."""

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    distortion: Distortion | None = None
    """Of the lens; None for a pinhole."""

    @staticmethod
    def from_field_of_view(width: int, height: int, horizontal_fov_rad: float) -> "PinholeCamera":
        """A camera of square pixels whose image centre is the optical axis."""
        focal = 0.5 * width / np.tan(0.5 * horizontal_fov_rad)
        return PinholeCamera(width, height, focal, focal, 0.5 * (width - 1), 0.5 * (height - 1))

    def strided(self, stride: int) -> "PinholeCamera":
        """The camera whose pixels are every so many of this one's, from the first one on."""
        if stride == 1:
            return self
        return PinholeCamera(
            -(-self.width // stride),
            -(-self.height // stride),
            self.fx / stride,
            self.fy / stride,
            self.cx / stride,
            self.cy / stride,
            self.distortion,
        )

    @property
    def matrix(self) -> FloatArray:
        """(3, 3) camera matrix K."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])


@lru_cache(maxsize=_KEPT)
def pixel_rays(camera: PinholeCamera) -> FloatArray:
    """(height, width, 3) ray of each pixel, scaled to z = 1, camera frame. Read-only, cached."""
    u = (np.arange(camera.width) - camera.cx) / camera.fx
    v = (np.arange(camera.height) - camera.cy) / camera.fy
    rays = np.ones((camera.height, camera.width, 3))
    rays[..., 0] = u[None, :]
    rays[..., 1] = v[:, None]
    if camera.distortion is not None:
        rays[..., :2] = camera.distortion.undistorted(rays[..., :2])
    rays.flags.writeable = False
    return rays


@lru_cache(maxsize=_KEPT)
def pixels_without_ray(camera: PinholeCamera) -> BoolArray | None:
    """(height, width) pixels beyond what the lens model describes; None where there are none.

    Nothing is known of them, whatever they return. Read-only, cached.
    """
    if camera.distortion is None:
        return None
    # The outermost rays lie on the limit but for rounding.
    outside = ~camera.distortion.is_within(pixel_rays(camera)[..., :2] * (1.0 - 1e-9))
    outside.flags.writeable = False
    return outside if outside.any() else None


@lru_cache(maxsize=_KEPT)
def range_per_depth(camera: PinholeCamera) -> FloatArray:
    """(height, width) range along the ray divided by z-depth, >= 1. Read-only, cached."""
    ratio = np.asarray(np.linalg.norm(pixel_rays(camera), axis=-1))
    ratio.flags.writeable = False
    return ratio


@lru_cache(maxsize=_KEPT)
def solid_angle(camera: PinholeCamera) -> FloatArray:
    """(height, width) solid angle of each pixel, sr: dx dy / (1 + x^2 + y^2)^(3/2). Cached."""
    angle = 1.0 / (pixels_per_area(camera, pixel_rays(camera)) * range_per_depth(camera) ** 3)
    angle.flags.writeable = False
    return angle


def rays_through(camera: PinholeCamera, pixels: FloatArray) -> FloatArray:
    """(..., 3) rays, scaled to z = 1, through places (..., 2) in the image: u, v."""
    xy = (pixels - [camera.cx, camera.cy]) / [camera.fx, camera.fy]
    if camera.distortion is not None:
        xy = camera.distortion.undistorted(xy)
    return np.concatenate([xy, np.ones((*xy.shape[:-1], 1))], axis=-1)


def pixels_per_area(camera: PinholeCamera, rays: FloatArray) -> FloatArray:
    """(...) pixels that a unit of area of the plane z = 1 fills, at rays (..., 3) with z = 1."""
    pixels = np.full(rays.shape[:-1], camera.fx * camera.fy)
    if camera.distortion is None:
        return pixels
    return np.asarray(pixels * np.linalg.det(camera.distortion.jacobian(rays[..., :2])))


def ray_steps(camera: PinholeCamera, rays: FloatArray) -> FloatArray:
    """(n, 2, 2) how x and y of rays (n, 3) with z = 1 change from a pixel to the next, times the
    focal length: row 0 is a step right, row 1 a step down. The identity for a pinhole."""
    if camera.distortion is None:
        return np.broadcast_to(np.eye(2), (len(rays), 2, 2))
    lens = np.linalg.inv(camera.distortion.jacobian(rays[:, :2]))
    return np.asarray(np.swapaxes(lens, -1, -2))


def project(camera: PinholeCamera, p_cam: FloatArray) -> FloatArray:
    """(..., 2) pixel coordinates (u, v) of points (..., 3) in the camera frame with z > 0.

    Points beyond what the lens model describes lie outside the image of all that it does.
    """
    scaled = p_cam[..., :2] / p_cam[..., 2:]
    if camera.distortion is not None:
        scaled = camera.distortion.distorted(scaled)
    return np.asarray(scaled * [camera.fx, camera.fy] + [camera.cx, camera.cy])


def project_outline(camera: PinholeCamera, corners_cam: FloatArray) -> FloatArray:
    """(m, 2) pixels along the closed outline of corners (n, 3), z > 0, the first one again at the
    end; between them where a lens bends the sides."""
    start, end = corners_cam, np.roll(corners_cam, -1, axis=0)
    pieces = 1 if camera.distortion is None else _PIECES_OF_A_SIDE
    share = (np.arange(pieces) / pieces)[None, :, None]
    points = (start[:, None] + share * (end - start)[:, None]).reshape(-1, 3)
    return project(camera, np.vstack([points, corners_cam[:1]]))


def projection_jacobian(camera: PinholeCamera, p_cam: FloatArray) -> FloatArray:
    """(n, 2, 3) derivative of the pixel coordinates (u, v) by points (n, 3), z > 0; px/m."""
    x, y, z = p_cam.T
    zero = np.zeros_like(z)
    if camera.distortion is None:
        du = np.column_stack([camera.fx / z, zero, -camera.fx * x / z**2])
        dv = np.column_stack([zero, camera.fy / z, -camera.fy * y / z**2])
        return np.stack([du, dv], axis=1)
    dx = np.column_stack([1.0 / z, zero, -x / z**2])
    dy = np.column_stack([zero, 1.0 / z, -y / z**2])
    lens = camera.distortion.jacobian(p_cam[:, :2] / z[:, None])
    focal = np.array([camera.fx, camera.fy])[:, None]
    return np.asarray(focal * (lens @ np.stack([dx, dy], axis=1)))


def R_cam_hill(direction_hill: FloatArray) -> FloatArray:
    """(..., 3, 3) attitude of a camera looking along directions (..., 3), not 0, OpenCV axes.

    Image down is nadir (+z) as far as the direction allows; a camera that looks along nadir or
    zenith has along-track (+x) up in the image.
    """
    forward = direction_hill / np.linalg.norm(direction_hill, axis=-1, keepdims=True)
    right = np.cross(np.array([0.0, 0.0, 1.0]), forward)
    length = np.linalg.norm(right, axis=-1, keepdims=True)
    right = np.where(length < _PARALLEL_SINE, np.cross([-1.0, 0.0, 0.0], forward), right)
    right = right / np.linalg.norm(right, axis=-1, keepdims=True)
    return np.stack([right, np.cross(forward, right), forward], axis=-2)
