"""The pinhole camera against the geometry of its image pyramid."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcnav.core.arrays import FloatArray
from pcnav.core.camera import (
    PinholeCamera,
    pixel_rays,
    pixels_without_ray,
    project,
    project_outline,
    projection_jacobian,
    range_per_depth,
    rays_through,
    solid_angle,
)
from pcnav.core.distortion import Distortion, DistortionModel

UNEVEN = PinholeCamera(40, 30, 55.0, 61.0, 17.3, 16.1)


def test_pixel_centres_are_at_integer_coordinates() -> None:
    rays = pixel_rays(UNEVEN)
    assert rays.shape == (30, 40, 3)
    v, u = np.indices((30, 40))
    np.testing.assert_allclose(project(UNEVEN, 7.0 * rays), np.stack([u, v], axis=-1), atol=1e-12)
    # BOP: K maps a point to homogeneous pixel coordinates.
    homogeneous = rays @ UNEVEN.matrix.T
    np.testing.assert_allclose(homogeneous[12, 31], [31.0, 12.0, 1.0], atol=1e-12)


def test_depth_along_rays_projects_onto_its_own_pixel() -> None:
    depth = np.random.default_rng(0).uniform(1.0, 40.0, (30, 40)).astype(np.float32)
    depth[3, 5] = 0.0
    points = pixel_rays(UNEVEN) * depth[..., None]
    np.testing.assert_array_equal(points[3, 5], 0.0)
    np.testing.assert_array_equal(points[..., 2], depth.astype(np.float64))
    np.testing.assert_allclose(
        np.linalg.norm(points, axis=-1), depth * range_per_depth(UNEVEN), rtol=1e-12
    )
    v, u = np.nonzero(depth)
    pixels = project(UNEVEN, points[v, u])
    np.testing.assert_allclose(pixels, np.column_stack([u, v]), atol=1e-12)


def test_axes_are_right_down_forward() -> None:
    pixels = project(UNEVEN, np.array([[0.0, 0.0, 5.0], [1.0, 0.0, 5.0], [0.0, 1.0, 5.0]]))
    np.testing.assert_allclose(pixels[0], [UNEVEN.cx, UNEVEN.cy])
    np.testing.assert_allclose(pixels[1] - pixels[0], [UNEVEN.fx / 5.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(pixels[2] - pixels[0], [0.0, UNEVEN.fy / 5.0], atol=1e-12)


@given(st.floats(1.0, 120.0), st.integers(2, 64), st.integers(2, 64))
def test_field_of_view_reaches_the_outer_edges_of_the_outer_pixels(
    fov_deg: float, width: int, height: int
) -> None:
    camera = PinholeCamera.from_field_of_view(width, height, np.deg2rad(fov_deg))
    left, right = (-0.5 - camera.cx) / camera.fx, (width - 0.5 - camera.cx) / camera.fx
    assert np.degrees(np.arctan(right) - np.arctan(left)) == pytest.approx(fov_deg, rel=1e-12)
    assert camera.fx == camera.fy
    rays = pixel_rays(camera)
    np.testing.assert_allclose(rays[..., :2], -rays[::-1, ::-1, :2], atol=1e-12)


def test_solid_angles_add_up_to_the_image_pyramid() -> None:
    camera = PinholeCamera.from_field_of_view(200, 120, np.deg2rad(50.0))
    a, b = np.tan(np.deg2rad(25.0)), np.tan(np.deg2rad(25.0)) * 120 / 200
    pyramid = 4.0 * np.arctan(a * b / np.sqrt(1.0 + a * a + b * b))
    # The rule takes each pixel at its centre: off by about (pixel / focal)^2 / 24 or less.
    assert solid_angle(camera).sum() == pytest.approx(pyramid, rel=1.0 / camera.fx**2)
    assert solid_angle(camera)[60, 100] > solid_angle(camera)[0, 0] > 0.0


def test_solid_angle_of_one_pixel_off_the_axis() -> None:
    def corner(x: float, y: float) -> float:
        return float(np.arctan2(x * y, np.sqrt(1.0 + x * x + y * y)))

    u, v = 35, 2
    x0, x1 = ((u + side - UNEVEN.cx) / UNEVEN.fx for side in (-0.5, 0.5))
    y0, y1 = ((v + side - UNEVEN.cy) / UNEVEN.fy for side in (-0.5, 0.5))
    exact = corner(x1, y1) - corner(x0, y1) - corner(x1, y0) + corner(x0, y0)
    assert solid_angle(UNEVEN)[v, u] == pytest.approx(exact, rel=1e-3)


def test_cached_arrays_cannot_be_changed() -> None:
    for array in (pixel_rays(UNEVEN), range_per_depth(UNEVEN), solid_angle(UNEVEN)):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0.0


LENS = Distortion(DistortionModel.OPENCV, (-0.3, 0.1, 0.002, -0.001, 0.01))
BENT = replace(UNEVEN, distortion=LENS)
NARROW = Distortion(DistortionModel.OPENCV, (-0.3, 0.0, 0.0, 0.0, 0.0))


def test_rays_through_a_lens_project_onto_their_pixels() -> None:
    v, u = np.indices((30, 40))
    pixels = np.stack([u, v], axis=-1)
    rays = pixel_rays(BENT)
    np.testing.assert_allclose(project(BENT, 7.0 * rays), pixels, atol=1e-11)
    np.testing.assert_allclose(rays_through(BENT, pixels.astype(float)), rays, atol=1e-12)
    assert np.abs(rays - pixel_rays(UNEVEN)).max() > 0.01
    every_third = rays[::3, ::3]
    np.testing.assert_allclose(pixel_rays(BENT.strided(3)), every_third, atol=1e-12)


def test_projection_jacobian_is_the_derivative() -> None:
    p = np.random.default_rng(2).uniform(-1.0, 1.0, (50, 3))
    p[:, 2] += 4.0
    for camera in (UNEVEN, BENT):
        h = 1e-6
        steps = [
            (project(camera, p + h * e) - project(camera, p - h * e)) / (2 * h) for e in np.eye(3)
        ]
        np.testing.assert_allclose(
            projection_jacobian(camera, p), np.stack(steps, axis=-1), rtol=1e-6, atol=1e-6
        )


def test_solid_angle_through_a_lens_is_that_between_the_corners_of_the_pixel() -> None:
    u, v = 35.0, 2.0
    corners = np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]])
    corners += np.array([u, v])
    a, b, c, d = rays_through(BENT, corners)

    def triangle(p: FloatArray, q: FloatArray, r: FloatArray) -> float:
        # van Oosterom and Strackee 1983.
        p, q, r = (x / np.linalg.norm(x) for x in (p, q, r))
        return float(2.0 * np.arctan2(p @ np.cross(q, r), 1.0 + p @ q + q @ r + r @ p))

    exact = triangle(a, b, c) + triangle(a, c, d)
    assert solid_angle(BENT)[2, 35] == pytest.approx(exact, rel=1e-3)
    assert solid_angle(UNEVEN)[2, 35] != pytest.approx(exact, rel=0.05)


def test_pixels_beyond_the_lens_model_have_no_ray() -> None:
    wide = replace(UNEVEN, fx=20.0, fy=20.0, distortion=NARROW)
    blind = pixels_without_ray(wide)
    assert blind is not None
    # The fold is imaged at 0.703 focal lengths.
    v, u = np.indices(blind.shape)
    radius = np.hypot(u - wide.cx, v - wide.cy) / 20.0
    assert not blind[radius < 0.69].any()
    assert blind[radius > 0.71].all()
    assert pixels_without_ray(BENT) is None
    assert pixels_without_ray(UNEVEN) is None


def test_outlines_follow_the_sides_that_a_lens_bends() -> None:
    corners = np.array([[-1.0, -0.8, 4.0], [1.0, -0.8, 4.5], [1.0, 0.8, 4.5], [-1.0, 0.8, 4.0]])
    plain = project_outline(UNEVEN, corners)
    np.testing.assert_array_equal(plain, project(UNEVEN, corners[[0, 1, 2, 3, 0]]))
    bent = project_outline(BENT, corners)
    assert len(bent) > len(plain)
    np.testing.assert_array_equal(bent[[0, -1]], project(BENT, corners[[0, 0]]))
    # All of it on the sides, which are straight in space.
    rays = rays_through(BENT, bent)
    a, b = corners[0] / corners[0, 2], corners[1] / corners[1, 2]
    first_side = rays[: len(bent) // 4 + 1]
    cross = (first_side - a)[:, 0] * (b - a)[1] - (first_side - a)[:, 1] * (b - a)[0]
    np.testing.assert_allclose(cross, 0.0, atol=1e-9)
