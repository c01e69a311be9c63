"""Planes: Open3D RANSAC (Yu 2019, section 2.1) and the least-squares refit on range residuals.

A plane is the vector ``m`` (3,) with ``m . p = 1`` for its points p in the camera frame, so a unit
ray u meets it at range ``1 / (m . u)``. Its normal facing the sensor is ``-m / |m|``.
"""

from dataclasses import dataclass
from math import ceil, log

import numpy as np

from pcnav.core._open3d import open3d
from pcnav.core.arrays import FloatArray, IntArray

_MIN_POINTS = 3
_MAX_CONDITION = 1e10
"""Of the normal equations: a face of a few pixels in the corner of the image is at about 1e7."""
_MIN_COSINE = 0.03
"""A plane seen flatter than this (88 degrees of incidence) is edge-on."""
_MAX_SEARCH_POINTS = 1000
"""RANSAC looks for a plane in at most so many points; its inliers are then taken from all."""


def trial_count(outlier_fraction: float, success_probability: float) -> int:
    """RANSAC trials K for the probability Phi that one sample is all inliers (Yu 2019 (2))."""
    all_inliers = (1.0 - outlier_fraction) ** _MIN_POINTS
    if all_inliers >= 1.0:
        return 1
    return max(1, ceil(log(1.0 - success_probability) / log(1.0 - all_inliers)))


def ransac_plane(
    points: FloatArray, distance_threshold_m: float, trials: int, seed: int
) -> FloatArray | None:
    """The plane ``m`` with the most points (n, 3) within the threshold, or None.

    None where no plane is determined: fewer than three points, collinear ones, or a plane through
    the camera centre. Deterministic: Open3D's generator is seeded for this call alone.
    """
    if len(points) < _MIN_POINTS:
        return None
    library = open3d()
    cloud = library.geometry.PointCloud(library.utility.Vector3dVector(points))
    library.utility.random.seed(seed % 2**31)  # it takes a C int
    # With a probability below 1 Open3D stops early after a number of trials that depends on
    # the order its threads finish in, which makes two runs differ.
    coefficients, _ = cloud.segment_plane(distance_threshold_m, _MIN_POINTS, trials, 1.0)
    normal, offset = np.asarray(coefficients[:3]), float(coefficients[3])
    if not np.any(normal) or abs(offset) < 1e-9:
        return None
    return np.asarray(-normal / offset)


@dataclass(frozen=True)
class PlaneFit:
    """A plane fitted to ranges."""

    m: FloatArray
    """(3,) the plane, 1/m."""
    covariance: FloatArray
    """(3, 3) of m."""
    chi_square_per_dof: float
    """Of the range residuals, in units of the stated noise."""

    @property
    def normal(self) -> FloatArray:
        """(3,) unit normal facing the sensor, camera frame."""
        return np.asarray(-self.m / np.linalg.norm(self.m))


def is_edge_on(m: FloatArray, range_m: float) -> bool:
    """Whether the plane is seen too flat, at that range, for its ranges to mean anything."""
    return bool(_MIN_COSINE * range_m * np.linalg.norm(m) > 1.0)


def plane_range(m: FloatArray, rays: FloatArray) -> FloatArray:
    """(n,) range at which unit rays (n, 3) meet the plane; inf where they never do."""
    inverse = rays @ m
    return np.where(inverse > 0.0, 1.0 / np.where(inverse > 0.0, inverse, 1.0), np.inf)


def fit_plane(
    rays: FloatArray, range_m: FloatArray, sigma_m: float, m: FloatArray
) -> PlaneFit | None:
    """Least squares on range residuals, the noise being along the ray; None without a plane.

    There is none in returns that lie in a line, or in one that the sensor sees edge-on.

    ``1 / range = m . u`` is linear in m, and noise sigma in range is ``sigma / range^2`` there:
    weighted least squares with the ranges of the previous fit in the weights (two passes; weights
    from the noisy ranges themselves would bias the plane towards far returns).

    Args:
        rays: (n, 3) unit rays.
        range_m: (n,) measured ranges.
        sigma_m: noise along the ray, one standard deviation.
        m: (3,) plane to start from.
    """
    information = np.eye(3)
    for _ in range(2):
        # 1/range is a biased observation of 1/true (by sigma^2 / range^3): linearise about the
        # last plane instead, 1/r ~ (2 r0 - r) / r0^2, which has weight r0^4 / sigma^2.
        predicted = 1.0 / (rays @ m)
        weight = predicted**2
        weighted_rays = rays.T * (weight * weight)
        information = weighted_rays @ rays
        if not np.all(np.isfinite(information)):
            return None
        least, _, most = np.linalg.eigvalsh(information)
        if least * _MAX_CONDITION < most:
            return None
        m = np.asarray(
            np.linalg.solve(information, rays.T @ (weight * (2.0 * predicted - range_m)))
        )
    # A ray that meets the plane behind the sensor, or hardly at all, has no range on it.
    if is_edge_on(m, float(np.mean(range_m))) or float(np.min(rays @ m)) <= 0.0:
        return None
    residual = (range_m - 1.0 / (rays @ m)) / sigma_m
    chi_square = float(residual @ residual) / max(len(residual) - 3, 1)
    # Flatness or noise worse than stated widens the covariance; better never narrows it.
    covariance = np.asarray(np.linalg.inv(information) * (sigma_m**2 * max(1.0, chi_square)))
    return PlaneFit(m=m, covariance=covariance, chi_square_per_dof=chi_square)


def extract_planes(
    points: FloatArray, distance_threshold_m: float, trials: int, minimum_points: int, seed: int
) -> list[tuple[FloatArray, IntArray]]:
    """Planes of a cloud (n, 3), largest first, with the indices of their points.

    RANSAC is repeated on what the planes found so far leave over, until fewer than
    ``minimum_points`` agree on one.
    """
    planes: list[tuple[FloatArray, IntArray]] = []
    left = np.arange(len(points))
    while len(left) >= minimum_points:
        stride = -(-len(left) // _MAX_SEARCH_POINTS)
        sample = points[left[::stride]]
        m = ransac_plane(sample, distance_threshold_m, trials, seed + len(planes))
        if m is None:
            break
        # The inliers Open3D returns belong to the plane before its last refit: select again.
        near = np.abs(points[left] @ m - 1.0) < distance_threshold_m * np.linalg.norm(m)
        if np.count_nonzero(near) < minimum_points:
            break
        planes.append((m, left[near]))
        left = left[~near]
    return planes
