"""RANSAC and the range fit against counts, Monte Carlo and scipy."""

import numpy as np
import pytest
import trimesh
from scipy.optimize import least_squares

from pcnav.core.arrays import FloatArray
from pcnav.core.camera import PinholeCamera, pixel_rays
from pcnav.core.spatial import exp_rotation, make_transform
from pcnav.perception.planes import (
    extract_planes,
    fit_plane,
    is_edge_on,
    plane_range,
    ransac_plane,
    trial_count,
)
from pcnav.target.rendering import DepthRenderer

SIGMA = 0.05


def oblique_view(angle_deg: float, distance: float = 20.0) -> tuple[FloatArray, FloatArray]:
    """Unit rays (n, 3) over 10 degrees and the plane m tilted by an angle about x."""
    x, y = np.meshgrid(np.linspace(-0.09, 0.09, 30), np.linspace(-0.09, 0.09, 25))
    rays = np.column_stack([x.ravel(), y.ravel(), np.ones(x.size)])
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    angle = np.deg2rad(angle_deg)
    normal = np.array([0.0, np.sin(angle), np.cos(angle)])
    return rays, normal / (normal[2] * distance)


def noisy_ranges(rays: FloatArray, m: FloatArray, seed: int, sigma: float = SIGMA) -> FloatArray:
    noise = np.random.default_rng(seed).normal(0.0, sigma, len(rays))
    return np.asarray(1.0 / (rays @ m) + noise)


@pytest.mark.parametrize(("outliers", "success"), [(0.5, 0.99), (0.3, 0.9), (0.8, 0.95)])
def test_trials_succeed_as_often_as_asked_for(outliers: float, success: float) -> None:
    trials = trial_count(outliers, success)
    rng = np.random.default_rng(0)
    runs = 4000
    pure = np.all(rng.random((runs, trials, 3)) >= outliers, axis=2)
    frequency = float(np.mean(np.any(pure, axis=1)))
    tolerance = 4.0 * np.sqrt(success * (1.0 - success) / runs)
    assert frequency > success - tolerance
    # Not one trial more than Yu 2019 (2) needs.
    assert 1.0 - (1.0 - (1.0 - outliers) ** 3) ** (trials - 1) < success


def test_without_outliers_one_trial_is_enough() -> None:
    assert trial_count(0.0, 0.999) == 1
    assert trial_count(1e-9, 0.5) == 1


def test_ransac_finds_the_plane_among_outliers_and_repeats_itself() -> None:
    rays, m = oblique_view(40.0)
    points = rays * noisy_ranges(rays, m, 1, 0.01)[:, None]
    clutter = np.random.default_rng(2).uniform([-3, -3, 15], [3, 3, 25], (300, 3))
    cloud = np.vstack([points, clutter])
    found = ransac_plane(cloud, 0.03, 200, seed=7)
    assert found is not None
    assert np.linalg.norm(found - m) < 0.01 * np.linalg.norm(m)
    ransac_plane(clutter, 0.5, 50, seed=1)  # whatever happens in between
    np.testing.assert_array_equal(ransac_plane(cloud, 0.03, 200, seed=7), found)


def test_ransac_finds_nothing_where_no_plane_is() -> None:
    rays, m = oblique_view(20.0)
    points = rays * (1.0 / (rays @ m))[:, None]
    assert ransac_plane(points[:2], 0.01, 50, 0) is None
    assert ransac_plane(np.empty((0, 3)), 0.01, 50, 0) is None
    line = np.linspace(0.0, 1.0, 50)[:, None] * [1.0, 2.0, 0.5] + [0.0, 0.0, 10.0]
    assert ransac_plane(line, 0.01, 50, 0) is None
    through_centre = np.column_stack([np.indices((6, 6)).reshape(2, -1).T, np.zeros(36)])
    assert ransac_plane(through_centre.astype(float), 0.01, 50, 0) is None


@pytest.mark.parametrize("angle_deg", [0.0, 50.0, 75.0])
def test_fit_is_unbiased_and_its_covariance_calibrated(angle_deg: float) -> None:
    rays, m = oblique_view(angle_deg)
    runs = 300
    errors, distances = np.empty((runs, 3)), np.empty(runs)
    for k in range(runs):
        fit = fit_plane(rays, noisy_ranges(rays, m, k), SIGMA, m)
        assert fit is not None
        errors[k] = fit.m - m
        distances[k] = errors[k] @ np.linalg.solve(fit.covariance, errors[k])
    standard_error = errors.std(axis=0) / np.sqrt(runs)
    assert np.all(np.abs(errors.mean(axis=0)) < 4.0 * standard_error)
    # The squared distance of 3 components has mean 3 and variance 6.
    assert distances.mean() == pytest.approx(3.0, abs=4.0 * np.sqrt(6.0 / runs))


def test_fit_is_the_least_squares_solution_of_scipy_from_a_rough_start() -> None:
    rays, m = oblique_view(55.0)
    ranges = noisy_ranges(rays, m, 3)
    fit = fit_plane(rays, ranges, SIGMA, m * 1.01 + [0.0, 5e-4, 0.0])
    assert fit is not None

    def residual(x: FloatArray) -> FloatArray:
        return np.asarray((ranges - 1.0 / (rays @ x)) / SIGMA)

    exact = least_squares(residual, m, xtol=1e-15, gtol=1e-15)
    sd = np.sqrt(np.diag(fit.covariance))
    assert np.all(np.abs(fit.m - exact.x) < 0.02 * sd)
    assert fit.chi_square_per_dof == pytest.approx(2.0 * exact.cost / (len(rays) - 3), rel=1e-3)
    np.testing.assert_allclose(fit.normal, -m / np.linalg.norm(m), atol=2e-3)
    assert fit.normal[2] < 0.0


def test_more_noise_than_stated_widens_the_covariance_and_less_does_not_narrow_it() -> None:
    rays, m = oblique_view(30.0)
    stated = fit_plane(rays, 1.0 / (rays @ m), SIGMA, m)
    noisier = fit_plane(rays, noisy_ranges(rays, m, 5, 3.0 * SIGMA), SIGMA, m)
    assert stated is not None and noisier is not None
    by_m = -rays / ((rays @ m) ** 2)[:, None]  # of the range 1 / (m . u)
    information = by_m.T @ by_m
    expected = SIGMA**2 * np.linalg.inv(information)
    np.testing.assert_allclose(stated.covariance, expected, rtol=1e-6, atol=1e-20)
    ratio = noisier.covariance[2, 2] / stated.covariance[2, 2]
    assert ratio == pytest.approx(9.0, rel=0.2)


def test_edge_on_planes_and_lines_are_no_planes() -> None:
    for angle_deg, edge_on in ((80.0, False), (87.5, False), (89.0, True)):
        _, m = oblique_view(angle_deg)
        assert is_edge_on(m, 20.0) is edge_on  # on the axis the incidence is the angle itself
    rays, m = oblique_view(89.0)
    near_axis = rays[np.abs(rays[:, 1]) < 0.01]
    assert fit_plane(near_axis, 1.0 / (near_axis @ m), 0.01, m) is None
    row = rays[:30]
    facing = np.array([0.0, 0.0, 0.05])
    assert fit_plane(row, 1.0 / (row @ facing), 0.01, facing) is None


def test_range_of_a_plane_along_rays() -> None:
    rays, m = oblique_view(40.0)
    distance = plane_range(m, rays)
    np.testing.assert_allclose((rays * distance[:, None]) @ m, 1.0, atol=1e-12)
    assert np.all(np.isinf(plane_range(m, -rays)))
    assert np.isinf(plane_range(np.array([1.0, 0.0, 0.0]), np.array([[0.0, 0.0, 1.0]])))[0]


def test_planes_of_a_box_are_its_faces(camera: PinholeCamera) -> None:
    box = trimesh.creation.box((3.0, 2.5, 2.0))
    T = make_transform(exp_rotation(np.array([0.6, -0.7, 0.2])), np.array([0.1, 0.0, 15.0]))
    rendered = DepthRenderer(box, camera).render(T)
    seen = rendered.depth_m > 0.0
    noise = np.random.default_rng(0).normal(0.0, 0.005, seen.sum())
    points = (pixel_rays(camera) * rendered.depth_m[..., None])[seen]
    points += noise[:, None] * points / np.linalg.norm(points, axis=1, keepdims=True)

    planes = extract_planes(points, 0.015, 800, 60, seed=1)
    assert len(planes) == 3
    sizes = [len(indices) for _, indices in planes]
    assert sizes == sorted(sizes, reverse=True)
    together = np.concatenate([indices for _, indices in planes])
    assert len(np.unique(together)) == len(together) > 0.97 * len(points)
    normals = np.array([-m / np.linalg.norm(m) for m, _ in planes])
    alignment = np.abs(normals @ T[:3, :3])
    np.testing.assert_array_equal(np.sort(alignment.argmax(axis=1)), [0, 1, 2])
    assert np.all(alignment.max(axis=1) > np.cos(0.01))
    assert np.all(np.sum(normals * T[:3, 3], axis=1) < 0.0)
    again = extract_planes(points, 0.015, 800, 60, seed=1)
    for (m, indices), (other, others) in zip(planes, again, strict=True):
        np.testing.assert_array_equal(m, other)
        np.testing.assert_array_equal(indices, others)
    assert extract_planes(points[:40], 0.015, 800, 60, seed=1) == []
