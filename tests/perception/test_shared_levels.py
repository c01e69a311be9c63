"""Sizes of the errors that pixels share, from frames in which they are known."""

import numpy as np
import pytest

from pcnav.core.arrays import FloatArray
from pcnav.core.spatial import make_transform
from pcnav.perception.modality import Evidence
from pcnav.perception.sensor_noise import SensorNoise
from pcnav.perception.shared_levels import FrameErrors

LEVER_M, WHITE = 2.0, SensorNoise(0.02)
POSE_SD = 1e-3
"""Of a place that one frame alone tells, m."""
NO_OUTLINE = SensorNoise(0.02, outline_offset_sd_px=(0.3, 0.3, 0.3, 0.3))


def after(frames: int, seed: int, offset_m: float, jerk_m: float = 0.0) -> SensorNoise:
    """Frames of a target that moves by, each with an offset along the line of sight."""
    rng, errors = np.random.default_rng(seed), FrameErrors.before_any_frame(LEVER_M)
    information = np.diag([POSE_SD**-2.0] * 3 + [1e8] * 3)
    for k in range(frames):
        at: FloatArray = np.array([0.05 * k, 1.0 - 0.02 * k, 15.0 + 0.1 * k + 0.002 * k**2])
        at += rng.normal(0.0, jerk_m, 3) if jerk_m else 0.0
        seen = at * (1.0 + rng.normal(0.0, offset_m) / np.linalg.norm(at))
        error = np.concatenate([rng.normal(0.0, POSE_SD, 3), np.zeros(3)])
        face = Evidence(information, information @ error)
        T_cam_model = make_transform(np.eye(3), seen)
        errors = errors.with_frame(0.5 * k, T_cam_model, face, WHITE)
    return errors.applied(WHITE)


def after_with_outline(
    frames: int, seed: int, offset_m: float, outline_px: float, uneven_px: float = 0.0
) -> SensorNoise:
    """Frames at the true pose of a target that is shaken by far more than its offsets, with an
    outline whose size tells the distance."""
    rng, errors = np.random.default_rng(seed), FrameErrors.before_any_frame(LEVER_M)
    unit, outline_sd, px_per_m = NO_OUTLINE.frame_unit_m, 0.01, 20.0
    place, velocity = np.array([0.0, 0.0, 15.0]), np.zeros(3)
    for k in range(frames):
        # Columns: pose, offset of the frame (in its unit), outline's offsets (in 0.3 px).
        ranges = np.zeros((3, 11))
        ranges[:, :3], ranges[2, 6] = np.eye(3), unit
        grown = np.zeros((1, 11))
        grown[0, 2], grown[0, 7] = -px_per_m, 0.3
        r = np.append(rng.normal(0.0, POSE_SD, 3), outline_px + rng.normal(0.0, uneven_px))
        r[2] += rng.normal(0.0, offset_m)
        r[3] += rng.normal(0.0, outline_sd)
        both = Evidence.of(r[:3], np.full(3, POSE_SD**2), ranges).with_also(
            Evidence.of(r[3:], np.full(1, outline_sd**2), grown)
        )
        velocity = velocity + rng.normal(0.0, 0.1, 3)
        place = place + velocity
        T_cam_model = make_transform(np.eye(3), place)
        errors = errors.with_frame(0.5 * k, T_cam_model, both, NO_OUTLINE)
    return errors.applied(NO_OUTLINE)


@pytest.mark.parametrize("seed", range(3))
def test_an_outline_that_is_off_in_all_frames_is_no_offset_of_a_frame(seed: int) -> None:
    assert after_with_outline(30, seed, 0.0, 0.4).frame_sd_m == 0.0
    assert after_with_outline(30, seed, 0.0, 0.4, uneven_px=0.05).frame_sd_m == 0.0


@pytest.mark.parametrize("seed", range(3))
def test_an_offset_of_every_frame_is_found_with_its_size(seed: int) -> None:
    assert after(60, seed, 0.05).frame_sd_m == pytest.approx(0.05, rel=0.35)
    assert after(9, seed, 0.05).frame_sd_m == pytest.approx(0.05, rel=0.8)


@pytest.mark.parametrize("seed", range(6))
def test_none_is_found_where_there_is_none(seed: int) -> None:
    for frames in (3, 5, 7, 12, 60):
        assert after(frames, seed, 0.0).frame_sd_m == 0.0


@pytest.mark.parametrize("seed", range(3))
def test_a_target_that_is_shaken_in_all_directions_has_none(seed: int) -> None:
    assert after(60, seed, 0.0, jerk_m=0.05).frame_sd_m == 0.0
