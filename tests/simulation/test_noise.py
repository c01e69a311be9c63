"""Statistics of the simulated sensor's faults."""

from typing import Any

import numpy as np
import pytest
import trimesh
from scipy import stats

from pcnav.config.sensors import NoiseTable
from pcnav.core.arrays import DepthImage
from pcnav.core.camera import PinholeCamera, range_per_depth
from pcnav.core.spatial import exp_rotation, make_transform
from pcnav.simulation.noise import add_sensor_faults
from pcnav.target.rendering import DepthRenderer, RenderedDepth

CAMERA = PinholeCamera.from_field_of_view(200, 160, np.deg2rad(60.0))
FINE = 1e-6
CLEAN = {"range_sigma_m": 0.0, "quantisation_m": FINE}


def join(*parts: trimesh.Trimesh) -> trimesh.Trimesh:
    """One mesh of several."""
    mesh = trimesh.util.concatenate(list(parts))
    assert isinstance(mesh, trimesh.Trimesh)
    return mesh


@pytest.fixture(scope="module")
def rendered() -> RenderedDepth:
    """A tilted plate that fills most of the image, with a plate half a metre before it."""
    back = trimesh.creation.box((9.0, 6.0, 0.01))
    front = trimesh.creation.box((2.0, 2.0, 0.01))
    front.apply_translation((0.0, 0.0, -0.5))
    pose = make_transform(exp_rotation(np.array([0.2, 0.5, 0.0])), np.array([0.0, 0.0, 8.0]))
    image = DepthRenderer(join(back, front), CAMERA).render(pose)
    assert (image.depth_m > 0.0).sum() > 15_000
    assert (image.depth_m == 0.0).any()
    return image


def faulty(rendered: RenderedDepth, frame: int = 0, seed: int = 1, **faults: float) -> DepthImage:
    return add_sensor_faults(rendered, NoiseTable.model_validate({**CLEAN, **faults}), seed, frame)


def assert_share(count: int, total: int, share: float) -> None:
    """A binomial count within five standard deviations."""
    assert abs(count - share * total) < 5.0 * np.sqrt(total * share * (1.0 - share))
    assert count > 0


def test_perfect_sensor_only_rounds(rendered: RenderedDepth) -> None:
    step = 0.004
    image = faulty(rendered, quantisation_m=step)
    assert np.abs(image - rendered.depth_m).max() <= 0.5 * step + 1e-6
    units = image.astype(np.float64) / step
    np.testing.assert_allclose(units, np.rint(units), atol=1e-3)


def test_gaussian_noise_lies_along_the_ray(rendered: RenderedDepth) -> None:
    sigma = 0.03
    seen = rendered.depth_m > 0.0
    error = (faulty(rendered, range_sigma_m=sigma) - rendered.depth_m)[seen]
    ratio = range_per_depth(CAMERA)[seen]
    assert ratio.max() > 1.1
    normalised = error * ratio / sigma
    assert stats.kstest(normalised, "norm").pvalue > 1e-3
    # At the image's rim the z-depth noise is smaller by the cosine of the ray.
    oblique = ratio > np.quantile(ratio, 0.9)
    assert error[oblique].std() == pytest.approx(sigma / ratio[oblique].mean(), rel=0.06)


def test_dropouts_and_empty_pixels(rendered: RenderedDepth) -> None:
    seen = rendered.depth_m > 0.0
    image = faulty(rendered, dropout_fraction=0.1)
    assert not image[~seen].any()
    assert_share(int((image[seen] == 0.0).sum()), int(seen.sum()), 0.1)
    assert not faulty(rendered, dropout_fraction=1.0).any()


def test_outliers_are_uniform_over_the_depth_span(rendered: RenderedDepth) -> None:
    seen = rendered.depth_m > 0.0
    clean = rendered.depth_m[seen]
    moved = faulty(rendered, outlier_fraction=0.2)[seen]
    changed = np.abs(moved - clean) > 1e-5
    assert_share(int(changed.sum()), int(seen.sum()), 0.2)
    low, high = float(clean.min()), float(clean.max())
    assert stats.kstest(moved[changed], "uniform", args=(low, high - low)).pvalue > 1e-3


def test_mixed_pixels_lie_between_the_two_surfaces(rendered: RenderedDepth) -> None:
    seen = rendered.depth_m > 0.0
    whole = faulty(rendered, mixed_pixel_fraction=1.0)
    changed = np.abs(whole - rendered.depth_m) > 1e-5
    on_edge = int(changed.sum())
    assert on_edge > 200
    rows, columns = np.nonzero(changed)
    for i, j in zip(rows.tolist(), columns.tolist(), strict=True):
        patch = rendered.depth_m[i - 1 : i + 2, j - 1 : j + 2]
        assert patch[patch > 0.0].min() - 2e-6 <= whole[i, j] <= patch.max() + 2e-6
        assert np.ptp(patch[patch > 0.0]) > 0.2
    # The outline keeps its surface: no pixel is lost and none appears.
    np.testing.assert_array_equal(whole > 0.0, seen)
    some = faulty(rendered, mixed_pixel_fraction=0.4)
    assert_share(int((np.abs(some - rendered.depth_m) > 1e-5).sum()), on_edge, 0.4)


def test_any_frame_can_be_repeated_alone(rendered: RenderedDepth) -> None:
    faults: dict[str, Any] = {
        "range_sigma_m": 0.02,
        "outlier_fraction": 0.1,
        "dropout_fraction": 0.1,
    }
    first = [faulty(rendered, frame=k, **faults) for k in range(3)]
    np.testing.assert_array_equal(faulty(rendered, frame=2, **faults), first[2])
    assert (first[1] != first[2]).mean() > 0.3
    assert (faulty(rendered, frame=2, seed=2, **faults) != first[2]).mean() > 0.3


def test_faults_have_streams_of_their_own(rendered: RenderedDepth) -> None:
    plain = faulty(rendered, range_sigma_m=0.02)
    dropped = faulty(rendered, range_sigma_m=0.02, dropout_fraction=0.3)
    kept = dropped > 0.0
    assert kept.sum() > 5_000
    np.testing.assert_array_equal(plain[kept], dropped[kept])


def test_empty_frame_stays_empty() -> None:
    image = DepthRenderer(trimesh.creation.box((1.0, 1.0, 1.0)), CAMERA).render(
        make_transform(np.eye(3), np.array([0.0, 0.0, -9.0]))
    )
    faults: dict[str, Any] = {
        "range_sigma_m": 0.02,
        "outlier_fraction": 1.0,
        "mixed_pixel_fraction": 1.0,
    }
    assert not faulty(image, **faults).any()
