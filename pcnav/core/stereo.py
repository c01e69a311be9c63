"""A stereo rig: two parallel pinhole cameras, projection, triangulation and their derivatives.

Axes of the rig are those of its left camera (OpenCV): x right, y down, z forward. The right camera
sits at ``+baseline`` on x. A feature is seen as ``(u_left, v_left, u_right, v_right)`` in pixels;
its disparity ``u_left - u_right = f b / z`` is positive in front of the rig (Hu 2024 (1) with the
errata: depth lies along the optical axis).
"""

from dataclasses import dataclass

import numpy as np

from pcnav.core.arrays import FloatArray


@dataclass(frozen=True)
class StereoRig:
    """The geometry of a rig and how well it measures."""

    baseline_m: float
    focal_px: float
    centre_px: tuple[float, float]
    """Principal point, the same in both images."""
    size_px: tuple[int, int]
    """Width and height of both images."""
    pixel_sigma_px: float
    """Standard deviation of each measured coordinate."""

    def project(self, p_rig: FloatArray) -> FloatArray:
        """(..., 4) pixels of points (..., 3) in front of the rig, m."""
        x, y, z = p_rig[..., 0], p_rig[..., 1], p_rig[..., 2]
        u = self.focal_px * x / z + self.centre_px[0]
        v = self.focal_px * y / z + self.centre_px[1]
        return np.stack([u, v, u - self.focal_px * self.baseline_m / z, v], axis=-1)

    def projection_jacobian(self, p_rig: FloatArray) -> FloatArray:
        """(..., 4, 3) derivative of `project` by the point."""
        x, y, z = p_rig[..., 0], p_rig[..., 1], p_rig[..., 2]
        jacobian = np.zeros((*np.shape(z), 4, 3))
        per_metre = self.focal_px / z
        jacobian[..., 0, 0] = jacobian[..., 2, 0] = per_metre
        jacobian[..., 1, 1] = jacobian[..., 3, 1] = per_metre
        jacobian[..., 0, 2] = -per_metre * x / z
        jacobian[..., 1, 2] = jacobian[..., 3, 2] = -per_metre * y / z
        jacobian[..., 2, 2] = -per_metre * (x - self.baseline_m) / z
        return jacobian

    def triangulate(self, pixels: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Points (..., 3) in rig axes, m, and their covariances (..., 3, 3), from pixels (..., 4).

        The two rows are averaged, so the point is the least-squares one to first order. Disparities
        that are not positive give points that are not finite: `disparity` tells them first.
        """
        u_left, v_left, u_right, v_right = np.moveaxis(np.asarray(pixels, np.float64), -1, 0)
        with np.errstate(divide="ignore", invalid="ignore"):
            z = self.focal_px * self.baseline_m / (u_left - u_right)
            # The left column and the right one plus the disparity carry the same x; depth alone
            # takes their difference.
            x = (0.5 * (u_left + u_right) - self.centre_px[0]) * z / self.focal_px
            x = x + 0.5 * self.baseline_m
            y = (0.5 * (v_left + v_right) - self.centre_px[1]) * z / self.focal_px
            points = np.stack([x, y, z], axis=-1)
            return points, self.point_covariance(points)

    def point_covariance(self, p_rig: FloatArray) -> FloatArray:
        """(..., 3, 3) covariance of a triangulated point, m^2: inverse of its information."""
        x, y, z = p_rig[..., 0], p_rig[..., 1], p_rig[..., 2]
        # Derivatives of x, y, z by (mean column, mean row, disparity), which are independent with
        # variances sigma^2 times 1/2, 1/2 and 2.
        by = np.zeros((*np.shape(z), 3, 3))
        scale = z / self.focal_px
        by_disparity = -(z**2) / (self.focal_px * self.baseline_m)
        by[..., 0, 0] = by[..., 1, 1] = scale
        by[..., 0, 2] = by_disparity * (x - 0.5 * self.baseline_m) / z
        by[..., 1, 2] = by_disparity * y / z
        by[..., 2, 2] = by_disparity
        variances = self.pixel_sigma_px**2 * np.array([0.5, 0.5, 2.0])
        return np.asarray((by * variances) @ np.swapaxes(by, -1, -2))

    @staticmethod
    def disparity(pixels: FloatArray) -> FloatArray:
        """(...,) ``u_left - u_right``, px."""
        return np.asarray(pixels[..., 0] - pixels[..., 2])
