"""The window of returns against the full image."""

from dataclasses import replace

import numpy as np
import pytest

from pcnav.core.arrays import DepthImage, FloatArray
from pcnav.core.camera import PinholeCamera, pixel_rays, range_per_depth, solid_angle
from pcnav.perception.returns import Window, smoothed_points, smoothing_size, window_of_returns
from pcnav.recordings.sequence import Frame

CAMERA = PinholeCamera(60, 40, 80.0, 85.0, 28.5, 21.0)


def frame_with(pixels: list[tuple[int, int]], depth_m: float = 7.0) -> Frame:
    """A frame whose only returns are at these (u, v)."""
    depth = np.zeros((40, 60), dtype=np.float32)
    for u, v in pixels:
        depth[v, u] = depth_m + 0.1 * u
    return Frame(0, 0.0, depth, CAMERA, np.eye(4))


def window_of(frame: Frame) -> Window:
    window = window_of_returns(frame)
    assert window is not None
    return window


def test_no_returns_give_no_window() -> None:
    assert window_of_returns(frame_with([])) is None


def test_window_holds_every_return_and_its_neighbours() -> None:
    frame = frame_with([(20, 10), (35, 14)])
    window = window_of(frame)
    assert (window.left, window.top, window.width, window.height) == (18, 8, 20, 9)
    assert window.touches_border == (False, False, False, False)
    assert window.has_return.sum() == 2


@pytest.mark.parametrize(
    ("pixel", "border"),
    [
        ((30, 0), (True, False, False, False)),
        ((30, 39), (False, True, False, False)),
        ((0, 20), (False, False, True, False)),
        ((59, 20), (False, False, False, True)),
        ((59, 39), (False, True, False, True)),
    ],
)
def test_window_ends_at_the_image(
    pixel: tuple[int, int], border: tuple[bool, bool, bool, bool]
) -> None:
    window = window_of(frame_with([pixel]))
    assert window.touches_border == border
    assert window.part[0].start >= 0 and window.part[0].stop <= 40
    assert window.part[1].start >= 0 and window.part[1].stop <= 60


def test_arrays_are_those_of_the_pixels_they_stand_for() -> None:
    rng = np.random.default_rng(0)
    depth: DepthImage = np.zeros((40, 60), dtype=np.float32)
    depth[5:30, 12:50] = rng.uniform(5.0, 9.0, (25, 38)) * (rng.random((25, 38)) > 0.2)
    frame = replace(frame_with([]), depth_m=depth)
    window = window_of(frame)
    returns = np.flatnonzero(window.has_return)
    u, v = window.pixel(returns).T
    np.testing.assert_array_equal(np.count_nonzero(depth), len(returns))
    points = window.rays[returns] * window.range_m[returns, None]
    np.testing.assert_allclose(points, (pixel_rays(CAMERA) * depth[..., None])[v, u], atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(window.rays, axis=1), 1.0, atol=1e-15)
    np.testing.assert_array_equal(window.solid_angle[returns], solid_angle(CAMERA)[v, u])
    np.testing.assert_array_equal(
        window.range_m.reshape(window.shape) > 0.0, depth[window.part] > 0.0
    )
    all_u, all_v = window.pixel(np.arange(window.height * window.width)).T
    along = pixel_rays(CAMERA)[all_v, all_u]
    np.testing.assert_allclose(window.rays / window.rays[:, 2:], along, atol=1e-12)


def _plane_frame(sigma_m: float, seed: int = 0) -> tuple[Frame, FloatArray]:
    """An oblique plane that fills the image, with noise along the ray; and its m."""
    camera = PinholeCamera.from_field_of_view(64, 48, np.deg2rad(20.0))
    normal = np.array([0.5, -0.3, -1.0]) / np.linalg.norm([0.5, -0.3, -1.0])
    m = normal / (normal @ np.array([0.0, 0.0, 20.0]))
    rays = pixel_rays(camera) / range_per_depth(camera)[..., None]
    noise = np.random.default_rng(seed).normal(0.0, sigma_m, rays.shape[:2])
    depth = (1.0 / (rays @ m) + noise) * rays[..., 2]
    return Frame(0, 0.0, depth.astype(np.float32), camera, np.eye(4)), m


@pytest.mark.parametrize("size", [1, 3, 5])
def test_averaged_points_of_a_plane_lie_on_it_whatever_is_missing(size: int) -> None:
    frame, m = _plane_frame(0.0)
    holes = np.random.default_rng(1).random(frame.depth_m.shape) < 0.2
    depth_m = np.where(holes, np.float32(0.0), frame.depth_m)
    window = window_of_returns(Frame(0, 0.0, depth_m, frame.camera, np.eye(4)))
    assert window is not None
    points = smoothed_points(window, size)
    assert len(points) > 0.5 * depth_m.size
    # Float32 depth of 20 m is good to a micrometre.
    np.testing.assert_allclose(points @ m, 1.0, atol=2e-7)


def test_averaging_divides_the_noise_by_the_width_of_the_square() -> None:
    sigma_m = 0.05
    frame, m = _plane_frame(sigma_m)
    window = window_of_returns(frame)
    assert window is not None
    points = smoothed_points(window, 5)
    along_ray = np.linalg.norm(points, axis=1) * (1.0 - 1.0 / (points @ m))
    # Neighbouring averages share returns, so their spread is known to a few per cent only.
    assert np.std(along_ray) == pytest.approx(sigma_m / 5.0, rel=0.1)


def test_squares_grow_with_noise_over_footprint() -> None:
    frame, _ = _plane_frame(0.0)
    window = window_of_returns(frame)
    assert window is not None
    footprint_m = 20.0 / frame.camera.fx
    assert smoothing_size(window, 0.2 * footprint_m) == 1
    assert smoothing_size(window, 1.4 * footprint_m) == 3
    assert smoothing_size(window, 100.0 * footprint_m) == 9
