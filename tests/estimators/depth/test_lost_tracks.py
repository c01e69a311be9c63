"""Targets that jump, and wrong locks: they are found out, and found again."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

from pcnav.config.pipeline_file import Pipeline
from pcnav.core.arrays import DepthImage
from pcnav.core.spatial import exp_rotation, log_rotation, rotation_angle
from pcnav.dynamics.rigid_body import ratios_from_inertia
from pcnav.runs.estimate import Estimate
from pcnav.runs.status import Status
from pcnav.target.satellite import Target, load_target
from tests.estimators.depth.tracked_boxsat import (
    PIPELINE,
    SIGMA_M,
    Recording,
    note,
    recorded,
    shortened,
    track,
    tracker_of,
)

JUMP = 8
"""Frame at which the third sequence jumps to quite another attitude, 56 degrees away."""


@pytest.fixture(scope="module")
def jumped(recording: Recording) -> list[tuple[Estimate, float]]:
    """Estimates of a sequence whose target jumps, each with its error in attitude (rad)."""
    shown = [*range(24, 24 + JUMP), *range(30)]
    frames = [
        replace(recording.frames[k], index=index, time_s=0.5 * index)
        for index, k in enumerate(shown)
    ]
    rows = []
    for estimate, k in zip(track(recording, frames), shown, strict=True):
        error = np.nan
        if estimate.T_cam_target is not None:
            truth = recording.motion.truth.poses[k]
            error = float(rotation_angle(truth[:3, :3].T @ estimate.T_cam_target[:3, :3]))
        rows.append((estimate, error))
    return rows


def test_a_target_that_jumps_is_lost_and_found_again(
    jumped: list[tuple[Estimate, float]],
) -> None:
    words = [estimate.status for estimate, _ in jumped]
    assert words[JUMP - 1] == Status.LOCKED
    assert Status.COASTING in words[JUMP:]
    lost = words.index(Status.LOST)
    again = words.index(Status.LOCKED, lost)
    assert again - lost < 6
    assert set(words[again:]) == {Status.LOCKED}
    assert max(error for _, error in jumped[again:]) < np.deg2rad(0.5)


def test_a_wrong_attitude_is_not_called_locked(
    jumped: list[tuple[Estimate, float]],
) -> None:
    wrong = [estimate.status for estimate, error in jumped if error > np.deg2rad(5.0)]
    assert len(wrong) >= 2
    assert Status.LOCKED not in wrong


def test_frames_that_contradict_the_motion_widen_what_is_stated(
    jumped: list[tuple[Estimate, float]],
) -> None:
    def sd(estimate: Estimate) -> float:
        assert estimate.covariance is not None
        return float(np.sqrt(np.linalg.eigvalsh(estimate.covariance[9:12, 9:12])[-1]))

    astray = [(sd(e), error) for e, error in jumped if error > np.deg2rad(30.0)]
    assert len(astray) >= 2
    # Two deviations hold a jump of 56 degrees, of which the frame before knew nothing.
    assert all(error < 2.0 * deviation for deviation, error in astray)
    assert astray[1][0] > astray[0][0] > 100.0 * sd(jumped[JUMP - 1][0])
    again = [sd(e) for e, error in jumped[JUMP:] if error < np.deg2rad(0.5)]
    assert max(again) < np.deg2rad(0.5)


# A wrong lock: the attitude tracked is another one than the target's, which turns as it did.


def turned(pipeline: Pipeline, axis: tuple[float, float, float]) -> Pipeline:
    """The same motion of a target that is turned by half a turn about an axis of its body."""
    turn = exp_rotation(np.pi * np.array(axis) / np.linalg.norm(axis))
    attitude = exp_rotation(np.deg2rad(pipeline.body.attitude_rotvec_deg)) @ turn
    change = {
        "attitude_rotvec_deg": tuple(np.rad2deg(log_rotation(attitude)).tolist()),
        "omega_body_deg_s": tuple((turn.T @ pipeline.body.omega_body_deg_s).tolist()),
    }
    body = pipeline.body.model_copy(update=change)
    return pipeline.model_copy(update={"body": body})


SWITCH = 12
"""Frame at which the target of a sequence is exchanged for the turned one."""


def switched(
    target: Target, pipeline: Pipeline, axis: tuple[float, float, float]
) -> list[tuple[Estimate, float]]:
    """Estimates before and after the switch, each with its error in attitude (rad)."""
    before = recorded(target, shortened(pipeline, SWITCH))
    after = recorded(target, turned(pipeline, axis), SWITCH)
    shown = [(source, frame) for source in (before, after) for frame in source.frames]
    tracker = tracker_of(target)
    rows = []
    for source, frame in shown:
        estimate = tracker.step(frame)
        error = np.nan
        if estimate.T_cam_target is not None:
            truth = source.motion.truth.poses[frame.index]
            error = float(rotation_angle(truth[:3, :3].T @ estimate.T_cam_target[:3, :3]))
        rows.append((estimate, error))
    return rows


def check_the_lock_is_mended(rows: list[tuple[Estimate, float]], most_wrong: int) -> None:
    """Locked, wrong, lost and locked again rightly; few frames called locked while wrong."""
    words = [estimate.status for estimate, _ in rows]
    assert words[SWITCH - 1] == Status.LOCKED
    assert rows[SWITCH - 1][1] < np.deg2rad(0.1)
    assert rows[SWITCH][1] > np.deg2rad(170.0)
    lost = words.index(Status.LOST)
    again = words.index(Status.LOCKED, lost)
    assert again - lost < 6
    assert set(words[again:]) == {Status.LOCKED} and len(words) - again > 3
    assert max(error for _, error in rows[again:]) < np.deg2rad(0.5)
    wrong = [estimate.status for estimate, error in rows if error > np.deg2rad(5.0)]
    assert wrong.count(Status.LOCKED) <= most_wrong


def test_a_wrong_lock_that_explains_little_is_never_called_locked(recording: Recording) -> None:
    rows = switched(recording.target, shortened(PIPELINE, 30), (1.0, -2.0, 0.5))
    check_the_lock_is_mended(rows, most_wrong=0)
    assert note(rows[SWITCH][0], "inlier_ratio") < 0.2


def box_with_a_tower(folder: Path, height_m: float) -> Target:
    """A box that only a small tower on one side tells from itself turned by half a turn."""
    box = trimesh.creation.box((2.4, 1.8, 1.4))
    tower = trimesh.creation.box((0.8, 0.6, height_m))
    tower.apply_translation((0.5, 0.3, 0.7 + 0.5 * height_m))
    path = folder / "tower.obj"
    trimesh.util.concatenate([box, tower]).export(path)
    return load_target(path)


@pytest.mark.study
def test_a_track_that_sees_only_other_things_is_given_up_after_ten_frames(
    recording: Recording,
) -> None:
    rng = np.random.default_rng(0)

    def wall() -> DepthImage:
        """Never the same twice: a frame that repeats the one before is none."""
        depth_m = np.zeros_like(recording.frames[0].depth_m)
        depth_m[:40, :40] = 60.0 + rng.normal(0.0, SIGMA_M, (40, 40))
        return depth_m

    frames = recording.frames[:8] + [
        replace(frame, depth_m=wall()) for frame in recording.frames[8:20]
    ]
    words = [estimate.status for estimate in track(recording, frames)]
    assert words[7] == Status.LOCKED
    assert words[8:] == [*[Status.COASTING] * 10, Status.LOST, Status.ACQUIRING]


@pytest.mark.parametrize(
    ("height_m", "axis", "inlier_ratio"),
    [(0.5, (1.0, 0.0, 0.0), (0.5, 0.9)), (0.3, (0.0, 0.0, 1.0), (0.8, 0.97))],
)
def test_a_wrong_lock_that_explains_most_of_the_frame_is_found_out(
    tmp_path: Path,
    height_m: float,
    axis: tuple[float, float, float],
    inlier_ratio: tuple[float, float],
) -> None:
    almost_symmetric = box_with_a_tower(tmp_path, height_m)
    assert len(almost_symmetric.symmetry_transforms) == 1
    own = {
        "com_model_m": tuple(almost_symmetric.mesh.center_mass.tolist()),
        "inertia_ratios": tuple(
            ratios_from_inertia(np.array(almost_symmetric.mesh.moment_inertia)).tolist()
        ),
    }
    body = PIPELINE.body.model_copy(update=own)
    pipeline = shortened(PIPELINE.model_copy(update={"body": body}), 30)
    rows = switched(almost_symmetric, pipeline, axis)
    assert inlier_ratio[0] < note(rows[SWITCH][0], "inlier_ratio") < inlier_ratio[1]
    # The first fresh look opens the question, the second one answers it.
    check_the_lock_is_mended(rows, most_wrong=0)
    words = [estimate.status for estimate, _ in rows]
    assert words.index(Status.LOST) <= SWITCH + 3
