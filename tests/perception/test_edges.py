"""The pixel-sampling covariance against counting pixel centres inside the projected polygon."""

import numpy as np
import pytest

from pcnav.core.arrays import FloatArray
from pcnav.core.camera import PinholeCamera, project
from pcnav.core.spatial import exp_rotation, make_transform
from pcnav.perception.edges import moment_covariance

WIDTH, LENGTH = 1.5, 4.0
RUNS = 500


def sampled_moments(camera: PinholeCamera, T: FloatArray) -> FloatArray:
    """(6,) area moments 1, x, y, xx, yy, xy over the area, as pixel centres sample them."""
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * [0.5 * WIDTH, 0.5 * LENGTH]
    polygon = project(camera, corners @ T[:3, :2].T + T[:3, 3])
    low, high = np.floor(polygon.min(axis=0)), np.ceil(polygon.max(axis=0))
    u, v = np.meshgrid(np.arange(low[0], high[0] + 1), np.arange(low[1], high[1] + 1))
    pixels = np.column_stack([u.ravel(), v.ravel()])
    side = np.roll(polygon, -1, axis=0) - polygon
    offset = pixels[:, None] - polygon
    turn = side[:, 0] * offset[..., 1] - side[:, 1] * offset[..., 0]
    inside = pixels[(turn >= 0).all(axis=1) | (turn <= 0).all(axis=1)]

    def on_face(uv: FloatArray) -> FloatArray:
        rays = np.column_stack(
            [(uv - [camera.cx, camera.cy]) / [camera.fx, camera.fy], np.ones(len(uv))]
        )
        depth = (T[:3, 2] @ T[:3, 3]) / (rays @ T[:3, 2])
        return np.asarray((rays * depth[:, None] - T[:3, 3]) @ T[:3, :2])

    # Area of a pixel's footprint: the determinant of its map onto the face, by differences.
    half_right, half_down = np.array([[0.5, 0.0], [0.0, 0.5]])
    right = on_face(inside + half_right) - on_face(inside - half_right)
    down = on_face(inside + half_down) - on_face(inside - half_down)
    area = np.abs(right[:, 0] * down[:, 1] - right[:, 1] * down[:, 0])
    x, y = on_face(inside).T
    terms = np.stack([np.ones(len(x)), x, y, x * x, y * y, x * y])
    return np.asarray(terms @ area / (WIDTH * LENGTH))


def monte_carlo(T: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Sample covariance (6, 6) over the phase of the pixel grid, and the predicted one."""
    rng = np.random.default_rng(0)
    moments, predicted = np.empty((RUNS, 6)), np.zeros((6, 6))
    for k in range(RUNS):
        # Opposite sides share the grid's phase; a focal length that varies makes theirs differ.
        focal = 577.0 * rng.uniform(0.97, 1.03)
        camera = PinholeCamera(256, 256, focal, focal, *(127.5 + rng.random(2)).tolist())
        moments[k] = sampled_moments(camera, T)
        if k < 20:
            predicted += moment_covariance(camera, T, WIDTH, LENGTH) / 20.0
    assert np.abs(moments[:, 0].mean() - 1.0) < 2e-3
    return np.cov(moments.T), predicted


@pytest.mark.parametrize(
    "rotvec",
    [(0.0, 0.0, 0.37), (0.7, 0.4, 0.9), (-0.9, 0.3, -0.5), (0.0, 0.0, 0.0), (0.0, 0.8, 0.0)],
    ids=["facing", "oblique", "steep", "aligned", "aligned and tilted"],
)
def test_variances_are_those_of_sampling_by_pixels(rotvec: tuple[float, float, float]) -> None:
    T = make_transform(exp_rotation(np.array(rotvec)), np.array([0.2, -0.1, 25.0]))
    sampled, predicted = monte_carlo(T)
    # Four times the standard error of a variance. The model is of first order: what errors of
    # two sides do together (0.1 mrad of yaw where sides are aligned with the grid) is not in it.
    tolerance = 4.0 * np.sqrt(2.0 / RUNS)
    np.testing.assert_allclose(np.diag(predicted), np.diag(sampled), rtol=tolerance, atol=2e-8)
    scale = np.sqrt(np.maximum(np.diag(sampled), 4e-8))
    scale = np.outer(scale, scale)
    np.testing.assert_allclose(predicted / scale, sampled / scale, atol=tolerance)


def test_aligned_sides_are_uncertain_by_a_pixel_over_root_twelve() -> None:
    # Facing the camera with sides along the grid: each side is off by one uniform draw, and the
    # centroid by the mean of the draws of two opposite sides.
    camera = PinholeCamera(256, 256, 577.0, 577.0, 127.5, 127.5)
    T = make_transform(np.eye(3), np.array([0.0, 0.0, 25.0]))
    covariance = moment_covariance(camera, T, WIDTH, LENGTH)
    pixel = 25.0 / 577.0
    side = pixel / np.sqrt(12.0)
    area = np.sqrt(2.0 * (side / WIDTH) ** 2 + 2.0 * (side / LENGTH) ** 2)
    assert np.sqrt(covariance[0, 0]) == pytest.approx(area, rel=1e-2)
    assert np.sqrt(covariance[1, 1]) == pytest.approx(side / np.sqrt(2.0), rel=0.2)
    assert np.sqrt(covariance[2, 2]) == pytest.approx(side / np.sqrt(2.0), rel=0.2)


def test_covariance_is_symmetric_and_positive_and_vast_behind_the_camera() -> None:
    camera = PinholeCamera(256, 256, 577.0, 577.0, 127.5, 127.5)
    rng = np.random.default_rng(1)
    for _ in range(20):
        T = make_transform(exp_rotation(rng.normal(size=3)), np.array([0.3, 0.2, 20.0]))
        covariance = moment_covariance(camera, T, WIDTH, LENGTH)
        np.testing.assert_allclose(covariance, covariance.T, atol=1e-15)
        eigenvalues = np.linalg.eigvalsh(covariance)
        assert eigenvalues.min() > -1e-12 * eigenvalues.max()
    T[:3, 3] = [0.0, 0.0, 0.1]
    T[:3, :3] = exp_rotation(np.array([1.2, 0.0, 0.0]))
    behind = moment_covariance(camera, T, WIDTH, LENGTH)
    # A hundred metres: says nothing, and can still be computed with.
    assert np.diag(behind).min() >= 100.0**2


def test_a_face_at_a_hand_s_breadth_costs_no_memory() -> None:
    camera = PinholeCamera(256, 256, 577.0, 577.0, 127.5, 127.5)
    T = make_transform(exp_rotation(np.array([1.2, 0.0, 0.0])), np.array([0.0, 0.0, 1.87]))
    # Its nearest corners are 5 mm in front of the camera: their sides span 100,000 pixels.
    covariance = moment_covariance(camera, T, WIDTH, LENGTH)
    assert np.isfinite(covariance).all()
