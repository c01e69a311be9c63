"""Patches seen from another side and in another light: known maps, and what cannot be found."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter, map_coordinates

from pcnav.core.arrays import FloatArray
from pcnav.perception.patch_alignment import PatchGrid, SmoothImage, align, patches_of

GRID = PatchGrid(21)
MIDDLE = np.array([100.0, 100.0])


def scenery(seed: int = 0) -> FloatArray:
    """(200, 200) smooth random brightness."""
    noise = np.random.default_rng(seed).standard_normal((200, 200))
    smooth = gaussian_filter(noise, 3.0)
    return np.asarray(120.0 + 40.0 * smooth / smooth.std())


def mapped(scene: FloatArray, linear: FloatArray, shift: FloatArray) -> SmoothImage:
    """The scene under ``x -> middle + linear (x - middle) + shift``, by cubic splines."""
    v, u = np.mgrid[:200, :200].astype(np.float64)
    back = np.linalg.inv(linear)
    x = np.stack([u, v], axis=-1) - MIDDLE - shift
    x = x @ back.T + MIDDLE
    return map_coordinates(scene, [x[..., 1], x[..., 0]], order=3, mode="reflect").astype(
        np.float32
    )


def test_shear_stretch_shift_and_light_are_found() -> None:
    rng, scene = np.random.default_rng(1), scenery()
    pixels = MIDDLE + rng.uniform(-40.0, 40.0, (30, 2))
    patches = patches_of(scene.astype(np.float32), pixels, GRID)
    assert patches.usable.all()
    linear = np.array([[1.12, -0.15], [0.08, 0.88]])
    shift = np.array([0.9, -0.6])
    expected = (pixels - MIDDLE) @ linear.T + MIDDLE + shift
    image = 0.6 * mapped(scene, linear, shift) + 25.0
    near = expected + rng.uniform(-0.7, 0.7, expected.shape)
    first = np.broadcast_to(np.eye(2), (30, 2, 2))
    found = align(image, patches, near, first, GRID)
    assert found.settled.mean() > 0.9
    good = found.settled
    # Bilinear sampling of this scene is good for a few hundredths of a pixel.
    assert np.abs(found.pixels - expected)[good].max() < 0.05
    assert np.abs(found.linear - linear)[good].max() < 0.03
    assert found.correlation[good].min() > 0.99


def test_the_same_image_is_found_where_it_is() -> None:
    image = scenery(2).astype(np.float32)
    pixels = np.random.default_rng(3).uniform(40.0, 160.0, (20, 2))
    patches = patches_of(image, pixels, GRID)
    found = align(image, patches, pixels, np.broadcast_to(np.eye(2), (20, 2, 2)), GRID)
    assert found.settled.all()
    assert found.pixels == pytest.approx(pixels, abs=1e-4)
    assert found.correlation == pytest.approx(np.ones(20), abs=1e-6)


def test_another_scene_correlates_little() -> None:
    pixels = np.random.default_rng(4).uniform(40.0, 160.0, (40, 2))
    patches = patches_of(scenery(5).astype(np.float32), pixels, GRID)
    first = np.broadcast_to(np.eye(2), (40, 2, 2))
    found = align(scenery(6).astype(np.float32), patches, pixels, first, GRID)
    assert np.mean(found.settled & (found.correlation > 0.97)) == 0.0


def test_what_has_no_structure_or_leaves_the_image_is_not_usable() -> None:
    flat = np.full((200, 200), 80.0, dtype=np.float32)
    stripes = np.tile(scenery(7)[:1], (200, 1)).astype(np.float32)
    assert not patches_of(flat, MIDDLE[None], GRID).usable.any()
    assert not patches_of(stripes, MIDDLE[None], GRID).usable.any()
    image = scenery(8).astype(np.float32)
    patches = patches_of(image, np.array([[5.0, 100.0], [100.0, 100.0]]), GRID)
    assert patches.usable.tolist() == [False, True]
    # The second moves out of the image.
    found = align(
        image, patches, np.array([[5.0, 100.0], [195.0, 100.0]]), np.stack([np.eye(2)] * 2), GRID
    )
    assert not found.settled.any() and found.correlation.tolist() == [0.0, 0.0]
