"""The pinhole depth camera: the only place that knows where pixel centres are.

Pixel centres lie at integer coordinates (BOP): pixel (u, v) looks along
``((u - cx) / fx, (v - cy) / fy, 1)`` in the OpenCV camera frame (x right, y down, z forward).
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from pcnav.core.arrays import FloatArray

_PARALLEL_SINE = 1e-6
"""A direction closer to nadir or zenith than this (rad) leaves image down undefined."""
_KEPT = 12
"""Images kept of what depends on the camera alone, of one camera and of its strided ones."""


@dataclass(frozen=True)
class PinholeCamera:
    """Size and intrinsics of a depth camera without distortion, all in pixels."""

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float

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
    rays.flags.writeable = False
    return rays


@lru_cache(maxsize=_KEPT)
def range_per_depth(camera: PinholeCamera) -> FloatArray:
    """(height, width) range along the ray divided by z-depth, >= 1. Read-only, cached."""
    ratio = np.asarray(np.linalg.norm(pixel_rays(camera), axis=-1))
    ratio.flags.writeable = False
    return ratio


@lru_cache(maxsize=_KEPT)
def solid_angle(camera: PinholeCamera) -> FloatArray:
    """(height, width) solid angle of each pixel, sr: dx dy / (1 + x^2 + y^2)^(3/2). Cached."""
    angle = 1.0 / (camera.fx * camera.fy * range_per_depth(camera) ** 3)
    angle.flags.writeable = False
    return angle


def project(camera: PinholeCamera, p_cam: FloatArray) -> FloatArray:
    """(..., 2) pixel coordinates (u, v) of points (..., 3) in the camera frame with z > 0."""
    scaled = p_cam[..., :2] / p_cam[..., 2:]
    return np.asarray(scaled * [camera.fx, camera.fy] + [camera.cx, camera.cy])


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
