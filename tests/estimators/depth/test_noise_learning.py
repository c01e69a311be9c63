"""The sensor's noise, learnt by a tracker from frames whose noise is known here and not stated."""

import logging
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pcnav.config.depth import PerceptionTable
from pcnav.config.pipeline_file import Pipeline
from pcnav.core.camera import PinholeCamera
from pcnav.estimators.depth.tracker import Tracker
from pcnav.perception.range_level import FaceLevel, RangeLevel, first_guess
from pcnav.perception.sensor_noise import SensorNoise
from pcnav.recordings.calibration import EXACT
from pcnav.recordings.sequence import SequenceInfo
from pcnav.simulation.depth import Scene
from pcnav.target.satellite import Target, load_target
from studies.following import follow

FRAMES, SIGMA_M = 14, 0.02


@pytest.fixture(scope="module")
def target(repository: Path) -> Target:
    return load_target(repository / "meshes" / "boxsat.obj")


def simulated(target: Target, seed: int = 5, **noise: object) -> Scene:
    """A recording with what a sensor does, here known."""
    pipeline = Pipeline.model_validate(
        {
            "seed": seed,
            "scenario": {"frames": FRAMES, "frame_rate_hz": 1.0},
            "orbit": {"r_hill_m": [20.0, 0.2, -0.1]},
            "body": {
                "attitude_rotvec_deg": [25.0, 40.0, -30.0],
                "omega_body_deg_s": [2.0, -1.4, 2.5],
            },
            "camera": {"horizontal_fov_deg": 30.0},
            "noise": {"range_sigma_m": SIGMA_M, **noise},
        }
    )
    return Scene.showing(target, pipeline)


def learnt(target: Target, stated_m: float | None, seed: int = 5, **noise: object) -> SensorNoise:
    """By a tracker that has seen a simulated recording."""
    scene = simulated(target, seed, **noise)
    pipeline = scene.pipeline
    info = SequenceInfo("test", pipeline.orbit.mean_motion_rad_s, stated_m, None, calibration=EXACT)
    tracker = Tracker(target, info, PerceptionTable(), pipeline.filter, 1)
    for frame in scene:
        tracker.step(frame)
    return tracker.sensor_noise


def test_an_exact_sensor_is_found_to_be_one(target: Target) -> None:
    noise = learnt(target, SIGMA_M)
    assert noise.sigma_m == SIGMA_M
    assert noise.outline_offset_px[:2] == noise.outline_offset_sd_px[:2] == (0.0, 0.0)
    assert noise.outline_sd_px == noise.face_sd_m == noise.frame_sd_m == 0.0


UNEVEN: dict[str, Any] = {"face_offset_sd_m": SIGMA_M, "face_tilt_sd_deg": 0.3}
OFFSET: dict[str, Any] = {"frame_offset_sd_m": 5.0 * SIGMA_M}


def test_offsets_of_faces_are_learnt_with_their_size(target: Target) -> None:
    noise = learnt(target, SIGMA_M, **UNEVEN)
    # They are drawn along the rays: along the normals by the cosine of incidence, 30 to 65 deg.
    assert 0.4 * SIGMA_M < noise.face_sd_m < 0.9 * SIGMA_M
    # The panels are up to 4 m long: at one deviation of their pixels 0.3 deg are 2 to 6 mm.
    assert 0.0 < noise.face_tilt_sd_m < 0.01
    assert noise.frame_sd_m == 0.0


@pytest.mark.parametrize("error", [UNEVEN, OFFSET])
def test_errors_that_pixels_share_are_known_from_the_first_claim_on(
    target: Target, error: dict[str, Any]
) -> None:
    run = follow(simulated(target, **error), target)
    assert run.lock is not None and run.lock <= 3
    # Before they were: thousands, in the first frames of an offset and in all of uneven faces.
    squared = run.pose_nees[run.claims] / 6.0
    assert np.mean(squared) < 2.0 and np.max(squared) < 6.0


LASTING: dict[str, Any] = UNEVEN | {"face_correlation_s": 1e6}


@pytest.mark.parametrize("seed", [5, 7])
def test_what_errors_that_last_make_of_a_pose_is_stated(target: Target, seed: int) -> None:
    scene = simulated(target, seed, **LASTING)
    # Of a mesh that is taken for right: such errors look like another size, too.
    perception = scene.pipeline.perception.model_copy(update={"mesh_scale_sd": 0.0})
    pipeline = scene.pipeline.model_copy(update={"perception": perception})
    run = follow(replace(scene, pipeline=pipeline), target)
    known = run.pose_nees[6:] / 6.0
    assert 0.1 < np.mean(known) < 1.5 and np.max(known) < 3.0
    assert np.max(run.position_m[6:]) < SIGMA_M


def test_errors_of_faces_are_owned_up_to_where_the_outline_is_no_witness_of_them(
    target: Target,
) -> None:
    """Weighed by as noise of its pixels alone, a face would be known thirty times better than it
    is."""
    run = follow(simulated(target, footprint="any", **UNEVEN), target)
    known = run.claims
    known[:6] = False
    assert np.count_nonzero(known) >= 6
    assert 0.05 < np.mean(run.pose_nees[known]) / 6.0 < 3.0
    assert np.median(run.position_m[known]) > 0.2 * SIGMA_M


@pytest.mark.study
def test_whether_errors_of_faces_last_is_learnt(target: Target) -> None:
    assert learnt(target, SIGMA_M, **LASTING).face_correlation > 0.8
    assert learnt(target, SIGMA_M, **UNEVEN).face_correlation < 0.4


def test_pixels_that_return_from_any_of_their_area_show_a_larger_outline(target: Target) -> None:
    noise = learnt(target, SIGMA_M, footprint="any")
    # Five rays along a side: the outermost are 0.4 px from the middle, along rows and columns.
    assert noise.outline_offset_px[:2] == pytest.approx((0.4, 0.4), abs=0.1)
    assert noise.has_footprint


@pytest.mark.parametrize("factor", [1.0 / 3.0, 3.0, None])
def test_a_level_that_is_not_stated_or_stated_wrongly_is_learnt(
    target: Target, factor: float | None, caplog: pytest.LogCaptureFixture
) -> None:
    with caplog.at_level(logging.INFO, "pcnav"):
        noise = learnt(target, None if factor is None else factor * SIGMA_M)
    assert noise.sigma_m == pytest.approx(SIGMA_M, rel=0.06)
    said = [r.message for r in caplog.records if "range_sigma_m" in r.message]
    assert len(said) == (0 if factor is None else 1)


@pytest.mark.parametrize("growth", [0, 1, 2])
def test_the_growth_of_noise_with_range_is_learnt_from_a_target_that_comes_nearer(
    growth: int,
) -> None:
    rng, level = np.random.default_rng(growth), RangeLevel(0.01)
    for range_m in np.linspace(20.0, 10.0, 60):
        variance = (0.01 * (range_m / 20.0) ** growth) ** 2
        faces = [
            FaceLevel(range_m, variance * float(rng.chisquare(500)) / 500, 500) for _ in range(3)
        ]
        level = level.with_levels(faces)
    noise = level.applied(SensorNoise(0.01))
    assert noise.growth == growth
    for range_m in (10.0, 15.0):
        assert noise.sigma_at(range_m) == pytest.approx(0.01 * (range_m / 20.0) ** growth, rel=0.1)


def test_first_guess_of_a_frame_of_slanted_planes_and_steps() -> None:
    camera = PinholeCamera.from_field_of_view(96, 96, 0.4)
    v, u = np.mgrid[:96, :96]
    depth = 5.0 + 0.004 * u + 0.002 * v + np.where(u > 40, 0.5, 0.0)
    depth[:20] = 0.0
    noise = np.random.default_rng(3).normal(0.0, 0.01, depth.shape)
    frame = np.where(depth > 0.0, depth + noise, 0.0)
    guess = first_guess(frame.astype(np.float32), camera)
    assert guess == pytest.approx(0.01, rel=0.1)
    # Noise below the step that depths are stored in cannot be seen, but that of rounding is there.
    rounded = np.round(np.where(depth > 0.0, depth, 0.0) / 0.05) * 0.05
    guess = first_guess(rounded.astype(np.float32), camera)
    assert guess is not None and 0.3 < guess / (0.05 / np.sqrt(12.0)) < 3.0
    assert first_guess(np.zeros((96, 96), dtype=np.float32), camera) is None
