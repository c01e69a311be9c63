"""What sampling by pixels does to the moments of a face: its sides are only known to a pixel.

Where a straight side crosses pixel columns i = 1..n, the last pixel centre inside it lies a
fraction ``e_i = frac(c + i s) - 1/2`` of a pixel off the side's mean position, s being the slope of
the side and c a phase that is uniform on [0, 1) because the satellite does not know the pixel
grid. The autocovariance of that sawtooth is the second Bernoulli polynomial,
``E[e_i e_j] = B2(frac((i - j) s)) / 2`` with ``B2(x) = x^2 - x + 1/6``: exact for slopes near
0 or 1, where the errors of a side add up, and for general slopes, where they average out.
"""

import numpy as np

from pcnav.core.arrays import FloatArray
from pcnav.core.camera import PinholeCamera, pixels_per_area, project, rays_through

_UNKNOWN = 1e4
"""Variance of moments that are not determined: part of the face is behind the camera."""
_MAX_SAMPLES = 2000
"""A side that runs far out of the image, seen from very near, is sampled no finer than this."""
_CORNERS = np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]])


def moment_covariance(
    camera: PinholeCamera, T_cam_rect: FloatArray, width_m: float, length_m: float
) -> FloatArray:
    """(6, 6) covariance of the area moments of a rectangle sampled at pixel centres.

    The moments are, over the area A and about the centroid, in rectangle axes: 1 (relative area
    error), x, y (m), xx, yy, xy (m^2).

    Args:
        camera: the pixel grid.
        T_cam_rect: (4, 4) pose of the rectangle frame (x along the short side).
        width_m: short side, m.
        length_m: long side, m.
    """
    corners = np.zeros((4, 3))
    corners[:, :2] = _CORNERS * [width_m, length_m]
    corners_cam = corners @ T_cam_rect[:3, :3].T + T_cam_rect[:3, 3]
    if corners_cam[:, 2].min() <= 0.0:
        return _UNKNOWN * np.eye(6)
    pixels = project(camera, corners_cam)
    covariance = np.zeros((6, 6))
    for start, end in zip(pixels, np.roll(pixels, -1, axis=0), strict=True):
        covariance += _side_covariance(camera, T_cam_rect, start, end)
    return covariance / (width_m * length_m) ** 2


def _side_covariance(
    camera: PinholeCamera, T_cam_rect: FloatArray, start: FloatArray, end: FloatArray
) -> FloatArray:
    span = end - start
    major = int(np.argmax(np.abs(span)))
    n = min(max(1, round(abs(float(span[major])))), _MAX_SAMPLES)
    slope = float(span[1 - major]) / max(abs(float(span[major])), 1e-9)
    samples = start + (np.arange(n)[:, None] + 0.5) / n * span
    position, area = _on_plane(camera, T_cam_rect, samples)
    x, y = position.T
    columns = abs(float(span[major])) / n  # pixel columns that a sample stands for: about one
    effect = columns * area[:, None] * np.stack([np.ones(n), x, y, x * x, y * y, x * y], axis=1)
    phase = np.mod(np.arange(n) * slope, 1.0)
    sawtooth = 0.5 * (phase**2 - phase + 1.0 / 6.0)
    lag = np.abs(np.arange(n)[:, None] - np.arange(n))
    return np.asarray(effect.T @ sawtooth[lag] @ effect)


def _on_plane(
    camera: PinholeCamera, T_cam_rect: FloatArray, pixels: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """(n, 2) rectangle coordinates of pixels (n, 2) and the area of the face each one covers."""
    rays = rays_through(camera, pixels)
    normal, origin = T_cam_rect[:3, 2], T_cam_rect[:3, 3]
    along = rays @ normal
    depth = (normal @ origin) / along
    position = (rays * depth[:, None] - origin) @ T_cam_rect[:3, :2]
    # A pixel at depth z spans z/fx by z/fy across the optical axis; the face is inclined to it.
    area = depth**2 / pixels_per_area(camera, rays) / np.abs(along)
    return position, area
