"""The stereo rig: projection against a pinhole, Jacobians numerically, covariance by sampling."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcnav.core.camera import PinholeCamera, project
from pcnav.core.stereo import StereoRig

RIG = StereoRig(0.8, 900.0, (511.5, 383.5), (1024, 768), 0.1)

coordinates = st.tuples(st.floats(-5.0, 5.0), st.floats(-5.0, 5.0), st.floats(1.0, 100.0))


@given(point=coordinates)
def test_projection_is_that_of_two_pinholes(point: tuple[float, float, float]) -> None:
    p = np.array(point)
    camera = PinholeCamera(1024, 768, 900.0, 900.0, 511.5, 383.5)
    left, right = project(camera, p), project(camera, p - [0.8, 0.0, 0.0])
    np.testing.assert_allclose(RIG.project(p), [*left, *right], rtol=1e-12, atol=1e-10)


@given(point=coordinates)
def test_jacobian_is_the_numerical_derivative(point: tuple[float, float, float]) -> None:
    p = np.array(point)
    found = RIG.projection_jacobian(p)
    h = 1e-5 * p[2]
    for k, unit in enumerate(np.eye(3)):
        numerical = (RIG.project(p + h * unit) - RIG.project(p - h * unit)) / (2.0 * h)
        np.testing.assert_allclose(found[:, k], numerical, rtol=1e-7, atol=1e-5)


@given(point=coordinates)
def test_triangulation_undoes_projection(point: tuple[float, float, float]) -> None:
    p = np.array(point)
    found, _ = RIG.triangulate(RIG.project(p))
    np.testing.assert_allclose(found, p, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("point", [(0.0, 0.0, 10.0), (1.5, -0.7, 8.0), (-3.0, 2.0, 20.0)])
def test_covariance_is_that_of_samples_and_the_inverse_of_the_information(
    point: tuple[float, float, float],
) -> None:
    p = np.array(point)
    rng = np.random.default_rng(5)
    noise = RIG.pixel_sigma_px * rng.standard_normal((200_000, 4))
    samples, _ = RIG.triangulate(RIG.project(p) + noise)
    _, stated = RIG.triangulate(RIG.project(p))
    sd = np.sqrt(np.diag(stated))
    np.testing.assert_allclose(
        np.cov(samples.T) / np.outer(sd, sd), stated / np.outer(sd, sd), atol=0.02
    )
    H = RIG.projection_jacobian(p)
    np.testing.assert_allclose(np.linalg.inv(H.T @ H / RIG.pixel_sigma_px**2), stated, rtol=1e-9)


def test_everything_is_batched() -> None:
    p = np.random.default_rng(0).uniform(1.0, 9.0, (4, 2, 3))
    pixels, jacobian = RIG.project(p), RIG.projection_jacobian(p)
    points, covariance = RIG.triangulate(pixels)
    assert pixels.shape == (4, 2, 4)
    assert RIG.disparity(pixels).shape == (4, 2)
    for index in np.ndindex(4, 2):
        np.testing.assert_array_equal(pixels[index], RIG.project(p[index]))
        np.testing.assert_array_equal(jacobian[index], RIG.projection_jacobian(p[index]))
        one, own = RIG.triangulate(pixels[index])
        np.testing.assert_allclose(points[index], one, rtol=1e-14)
        np.testing.assert_allclose(covariance[index], own, rtol=1e-12)


def test_no_disparity_gives_no_finite_point_and_no_warning() -> None:
    points, _ = RIG.triangulate(np.array([[500.0, 400.0, 500.0, 400.0]]))
    assert not np.isfinite(points).all()
    assert RIG.disparity(np.array([500.0, 1.0, 510.0, 1.0])) == -10.0
