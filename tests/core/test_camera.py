"""The pinhole camera against the geometry of its image pyramid."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcnav.core.camera import (
    PinholeCamera,
    pixel_rays,
    project,
    range_per_depth,
    solid_angle,
)

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
