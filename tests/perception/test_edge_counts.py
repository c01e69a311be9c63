"""Counts of displaced pixels against displacements that are known, with things that spoil them."""

from dataclasses import replace

import numpy as np
import pytest

from pcnav.core.arrays import DepthImage, FloatArray
from pcnav.core.camera import PinholeCamera
from pcnav.core.distortion import Distortion, DistortionModel
from pcnav.core.spatial import exp_rotation, make_transform
from pcnav.perception.contour import contour_runs
from pcnav.perception.pose_doubt import PoseDoubt
from pcnav.perception.sensor_noise import SensorNoise
from pcnav.target.row_motion import Exposure, Readout, row_times
from tests.perception.outlines import (
    BOX,
    FACING,
    MESHES,
    SIGMA,
    DrawPose,
    Sample,
    View,
    drawing,
    is_mean,
    moved,
    sampled,
    sheet,
)


@pytest.mark.parametrize("sd", [(0.003, 6e-4), (0.008, 1e-3)], ids=["sharp", "blurred"])
@pytest.mark.parametrize("name", MESHES)
def test_counts_are_the_displacement_without_bias(
    camera: PinholeCamera, random_pose: DrawPose, name: str, sd: tuple[float, float]
) -> None:
    view = View(MESHES[name], camera)
    sampled(view, drawing(name, random_pose), sd, 60).check(7e-3, 0.1)


LENSES = {
    "barrel": Distortion(DistortionModel.OPENCV, (-1.5, 3.0, 0.01, -0.01, 0.0)),
    "cushion": Distortion(DistortionModel.OPENCV, (2.0, 5.0, 0.0, 0.02, 0.0)),
}


@pytest.mark.parametrize("sd", [(0.003, 6e-4), (0.008, 1e-3)], ids=["sharp", "blurred"])
@pytest.mark.parametrize("lens", LENSES)
def test_counts_along_bent_edges_are_the_displacement_without_bias(
    camera: PinholeCamera, random_pose: DrawPose, lens: str, sd: tuple[float, float]
) -> None:
    view = View(BOX, replace(camera, distortion=LENSES[lens]))
    # Wider on the image than the bodies above: edges bend by pixels.
    sampled(view, lambda rng: random_pose(rng, 11.0, 14.0), sd, 60).check(7e-3, 0.1)


def by_rows(motion: Readout, T_cam_model: FloatArray, readout_s: float) -> Exposure:
    return Exposure.by_rows(motion.poses(T_cam_model, row_times(readout_s, 256)), 256)


def test_counts_of_rows_read_out_in_turn_are_the_displacement_without_bias(
    camera: PinholeCamera, random_pose: DrawPose
) -> None:
    """The edges shear by pixels; what is counted is what the pose at the frame's time does."""
    view, sd = View(BOX, camera), (0.003, 6e-4)
    rng, parts = np.random.default_rng(8), []
    for _ in range(60):
        T = random_pose(rng, 18.0, 22.0)
        motion = Readout(rng.normal(size=6) * np.repeat([1.0, 0.5], 3))
        error = rng.normal(size=6) * np.repeat(sd, 3)
        true = moved(T, error)
        frame = view.renderer.render(true, by_rows(motion, true, 0.1)).depth_m
        rendered = view.renderer.render(T, by_rows(motion, T, 0.1))
        doubt = PoseDoubt(T, np.diag(np.square(np.repeat(sd, 3))), SIGMA)
        runs = contour_runs(view.edges, frame, rendered, doubt, 0.0, SensorNoise(SIGMA))
        parts.append((runs.value, runs.jacobian @ error, runs.variance, is_mean(runs)))
    Sample(*(np.concatenate(part) for part in zip(*parts, strict=True))).check(7e-3, 0.1)


def test_edges_through_a_lens_that_hardly_bends_are_those_of_a_pinhole(
    camera: PinholeCamera,
) -> None:
    T = make_transform(exp_rotation(np.array([0.2, 0.3, 0.2])) @ FACING, np.array([0, 0, 20.0]))
    straight = View(sheet(2.0, 2.0), camera)
    expected = straight.runs(straight.frame(T), T)
    lens = Distortion(DistortionModel.OPENCV, (-1e-9, 0.0, 0.0, 0.0, 0.0))
    view = View(sheet(2.0, 2.0), replace(camera, distortion=lens))
    runs = view.runs(view.frame(T), T)
    np.testing.assert_allclose(runs.jacobian, expected.jacobian, rtol=1e-4, atol=1e-4)
    np.testing.assert_allclose(runs.value, expected.value, atol=1e-6)
    np.testing.assert_allclose(runs.variance, expected.variance, rtol=0.3)


@pytest.mark.parametrize("name", ["box", "plate"])
def test_lost_returns_make_noise_and_no_bias(
    camera: PinholeCamera, random_pose: DrawPose, name: str
) -> None:
    def drop(depth_m: DepthImage, rng: np.random.Generator) -> DepthImage:
        return np.where(rng.random(depth_m.shape) < 0.3, np.float32(0.0), depth_m)

    view = View(MESHES[name], camera)
    draw = drawing(name, random_pose)
    sampled(view, draw, (0.01, 2e-3), 60, drop, 0.3).check(0.012, 0.05)


def test_what_hides_a_part_of_the_outline_says_nothing_of_it(
    camera: PinholeCamera, random_pose: DrawPose
) -> None:
    def hide(depth_m: DepthImage, rng: np.random.Generator) -> DepthImage:
        u, v = rng.integers(90, 130, 2)
        depth_m = depth_m.copy()
        depth_m[v : v + 40, u : u + 40] = 9.0
        return depth_m

    view = View(BOX, camera)
    draw = drawing("box", random_pose)
    hidden = sampled(view, draw, (0.01, 2e-3), 60, hide)
    hidden.check(7e-3, 0.1)
    assert hidden.is_mean.sum() > 150


def test_lone_outliers_leave_an_edge_whole(camera: PinholeCamera) -> None:
    view = View(sheet(2.0, 2.0), camera)
    T = make_transform(exp_rotation(np.array([0.2, 0.3, 0.2])) @ FACING, np.array([0, 0, 20.0]))
    clean = view.frame(T)
    rng = np.random.default_rng(0)
    spoilt = np.where((clean > 0.0) & (rng.random(clean.shape) < 0.05), np.float32(25.0), clean)
    runs, expected = view.runs(spoilt, T), view.runs(clean, T)
    np.testing.assert_array_equal(runs.jacobian, expected.jacobian)
    z = (runs.value - expected.value) / np.sqrt(expected.variance)
    assert np.all(np.abs(z) < 2.5)
