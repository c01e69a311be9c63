"""Beams over a grid of pixels: where they fall, which a pixel shows, what striding keeps."""

import numpy as np

from pcnav.core.beams import beams_on
from pcnav.core.camera import PinholeCamera, pixel_rays, project

CAMERA = PinholeCamera(24, 16, 60.0, 50.0, 11.5, 7.5)


def scattered(n: int = 400, seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    rays = np.column_stack([rng.uniform(-0.25, 0.25, (n, 2)), np.ones(n)])
    return rays, rng.uniform(5.0, 9.0, n), rng.uniform(-0.2, 0.2, n)


def test_a_pixel_shows_the_beam_nearest_to_its_centre() -> None:
    rays, range_m, time_s = scattered()
    beams = beams_on(CAMERA, rays, range_m, time_s)
    place = project(CAMERA, rays)
    for v in range(CAMERA.height):
        for u in range(CAMERA.width):
            off = np.abs(place - [u, v])
            inside = np.flatnonzero((off < 0.5).all(axis=1))
            shown = beams.shown[v, u]
            if not inside.size:
                assert shown == -1 and beams.image[v, u] == 0.0
                continue
            nearest = inside[np.argmin((off[inside] ** 2).sum(axis=1))]
            np.testing.assert_array_equal(beams.rays[shown], rays[nearest])
            z = range_m[nearest] / np.linalg.norm(rays[nearest])
            assert np.isclose(beams.image[v, u], z, rtol=1e-6)
    is_shown = (np.abs(place - [11.5, 7.5]) < [12.0, 8.0]).all(axis=1)
    assert len(beams.rays) == np.count_nonzero(is_shown)


def test_striding_keeps_what_a_coarser_camera_shows() -> None:
    beams = beams_on(CAMERA, *scattered())
    coarse = beams.strided(3)
    np.testing.assert_array_equal(coarse.image, beams.image[::3, ::3])
    rays, expected = coarse.image_rays(CAMERA.strided(3)), beams.image_rays(CAMERA)[::3, ::3]
    np.testing.assert_allclose(rays, expected, atol=1e-15)
    np.testing.assert_array_equal(coarse.shown.ravel()[coarse.pixel] >= 0, True)


def test_times_are_told_apart_and_holes_take_that_of_the_nearest_beam() -> None:
    rays, range_m, _ = scattered()
    beams = beams_on(CAMERA, rays, range_m, np.where(rays[:, 1] > 0.0, 0.1, -0.1))
    np.testing.assert_array_equal(beams.slice_times_s, [-0.1, 0.1])
    np.testing.assert_array_equal(beams.slice_times_s[beams.slice], beams.time_s)
    assert (beams.slice_image[:6] == 0).all() and (beams.slice_image[10:] == 1).all()
    many = beams_on(CAMERA, *scattered(5_000, 1))
    assert len(many.slice_times_s) == 1024
    off = np.abs(many.slice_times_s[many.slice] - many.time_s)
    assert off.max() < 0.51 * 0.4 / 1023


def test_an_outline_is_seen_along_the_pixels_own_rays_alone_and_in_their_order() -> None:
    rays = pixel_rays(CAMERA).reshape(-1, 3)
    in_turn = np.linspace(-0.1, 0.1, len(rays))
    far = np.full(len(rays), 5.0)
    assert beams_on(CAMERA, rays, far, in_turn).shows_outline(CAMERA)
    assert beams_on(CAMERA, rays, far, 0.0 * in_turn).shows_outline(CAMERA)
    mixed = np.random.default_rng(2).permutation(in_turn)
    assert not beams_on(CAMERA, rays, far, mixed).shows_outline(CAMERA)
    off = rays + np.array([0.3 / 60.0, 0.0, 0.0])
    assert not beams_on(CAMERA, off, far, 0.0 * in_turn).shows_outline(CAMERA)
