"""Lens distortion against OpenCV, numerical derivatives, and its own inverse."""

import numpy as np
import pytest

from pcnav.core.arrays import FloatArray
from pcnav.core.distortion import Distortion, DistortionModel

OPENCV, FISHEYE = DistortionModel.OPENCV, DistortionModel.FISHEYE
LENSES = {
    "barrel": Distortion(OPENCV, (-0.2, 0.05, 0.0, 0.0, 0.0)),
    "tangential": Distortion(OPENCV, (-0.3, 0.1, 0.002, -0.001, 0.01)),
    "four": Distortion(OPENCV, (0.1, -0.05, 0.001, 0.003)),
    "rational": Distortion(OPENCV, (0.5, -0.2, 0.001, 0.001, 0.02, 0.8, -0.1, 0.03)),
    "folds": Distortion(OPENCV, (-0.3, 0.0, 0.0, 0.0, 0.0)),
    "folds late": Distortion(OPENCV, (0.1, -0.4, 0.0, 0.0, 0.0)),
    "fisheye": Distortion(FISHEYE, (0.05, -0.01, 0.002, -0.0005)),
    "fisheye barrel": Distortion(FISHEYE, (-0.1, 0.0, 0.0, 0.0)),
}


def places(lens: Distortion, seed: int = 0) -> tuple[FloatArray, FloatArray]:
    """Places (n, 2) on the plane z = 1 all over what the model describes; their radii."""
    rng = np.random.default_rng(seed)
    radius = np.tan(rng.uniform(0.0, np.arctan(lens.max_radius), 3000))
    turn = rng.uniform(0.0, 2.0 * np.pi, 3000)
    return radius[:, None] * np.column_stack([np.cos(turn), np.sin(turn)]), radius


@pytest.mark.parametrize("name", LENSES)
def test_opencv_images_points_alike(name: str) -> None:
    cv2 = pytest.importorskip("cv2", reason="needs the extra images")
    lens = LENSES[name]
    xy, radius = places(lens)
    points = np.column_stack([xy, np.ones(len(xy))])[:, None]
    still, K = np.zeros(3), np.eye(3)
    project = cv2.fisheye.projectPoints if lens.model is FISHEYE else cv2.projectPoints
    expected = project(points, still, still, K, np.array(lens.coefficients))[0][:, 0]
    np.testing.assert_allclose(lens.distorted(xy), expected, rtol=1e-12, atol=1e-13)
    # Its own inverse stops after some steps; near the axis it is good.
    near = radius < 0.3
    image, k = lens.distorted(xy[near])[:, None], np.array(lens.coefficients)
    criteria = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 100, 1e-14)
    if lens.model is FISHEYE:
        found = cv2.fisheye.undistortPoints(image, K, k, criteria=criteria)
    else:
        found = cv2.undistortPoints(image, K, k, criteria=criteria)
    np.testing.assert_allclose(lens.undistorted(image[:, 0]), found[:, 0], atol=1e-8)


@pytest.mark.parametrize("name", LENSES)
def test_inverse_is_exact_and_holds_beyond_the_model(name: str) -> None:
    lens = LENSES[name]
    xy, radius = places(lens)
    scale = np.maximum(radius, 1.0)[:, None]
    np.testing.assert_allclose(lens.undistorted(lens.distorted(xy)) / scale, xy / scale, atol=1e-12)
    beyond = xy * ((lens.max_radius + 2.0 * radius) / radius)[:, None]
    again = lens.undistorted(lens.distorted(beyond))
    np.testing.assert_allclose(again, beyond, rtol=1e-6)
    assert lens.is_within(xy).all()
    assert not lens.is_within(beyond).any()


@pytest.mark.parametrize("name", LENSES)
def test_jacobian_is_the_derivative(name: str) -> None:
    lens = LENSES[name]
    xy, radius = places(lens)
    xy = np.vstack([xy[radius < 0.99 * lens.max_radius], [[0.0, 0.0], [0.2, 0.0]]])
    if lens.max_radius < 2.0:
        xy = np.vstack([xy, 1.5 * lens.max_radius * xy[:50] / np.linalg.norm(xy[:50])])
    h = 1e-6
    steps = [
        (lens.distorted(xy + h * e) - lens.distorted(xy - h * e)) / (2.0 * h) for e in np.eye(2)
    ]
    found = lens.jacobian(xy)
    size = np.abs(found).max(axis=(1, 2))[:, None, None]
    np.testing.assert_allclose(found / size, np.stack(steps, axis=-1) / size, atol=1e-7)


def test_nothing_from_beyond_a_fold_is_imaged_within_it() -> None:
    lens = LENSES["folds"]
    # r - 0.3 r^3 turns back at r = 1.054, to be at the axis again at 1.826.
    assert 1.0 < lens.max_radius < 1.0541
    edge = float(lens.distorted(np.array([lens.max_radius, 0.0]))[0])
    r = np.linspace(lens.max_radius, 60.0, 500)
    image = lens.distorted(np.column_stack([r, np.zeros(500)]))[:, 0]
    assert np.all(np.diff(image) > 0.0)
    assert image[0] == pytest.approx(edge)


def test_a_lens_has_as_many_coefficients_as_its_model() -> None:
    with pytest.raises(ValueError, match="expected 4 finite"):
        Distortion(FISHEYE, (0.1, 0.0, 0.0))
    with pytest.raises(ValueError, match="expected 4 or 5 or 8"):
        Distortion(OPENCV, (0.1,) * 6)
    with pytest.raises(ValueError, match="finite"):
        Distortion(OPENCV, (0.1, np.nan, 0.0, 0.0))
