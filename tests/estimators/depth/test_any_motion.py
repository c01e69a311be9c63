"""Targets whose motion is not free, and starts from a stated pose, on rendered frames."""

import logging
from dataclasses import replace

import numpy as np
import pytest

from pcnav.config.depth import FilterTable, MotionChoice, PerceptionTable
from pcnav.core.arrays import FloatArray
from pcnav.core.camera import PinholeCamera
from pcnav.core.spatial import exp_rotation, make_transform
from pcnav.estimators.depth.pose_measurement import moved_pose, pose_error
from pcnav.estimators.depth.tracker import Tracker
from pcnav.recordings.calibration import EXACT
from pcnav.recordings.sequence import FirstPosePrior, Frame, SequenceInfo
from pcnav.runs.estimate import Estimate
from pcnav.runs.status import Status
from pcnav.target.rendering import DepthRenderer
from pcnav.target.satellite import Target

SIGMA_M, STEP_S = 0.02, 0.2
INFO = SequenceInfo("boxsat", 0.0, SIGMA_M, None, calibration=EXACT)
CAMERA = PinholeCamera.from_field_of_view(160, 160, np.deg2rad(25.0))
FIRST = make_transform(exp_rotation(np.array([0.4, 0.7, -0.5])), np.array([0.1, -0.1, 20.0]))


def swayed(n: int) -> list[FloatArray]:
    """n poses (4, 4) of a target that is swung about: by 10 deg/s at most, 0.2 m/s."""
    poses = []
    for k in range(n):
        t = STEP_S * k
        turn = np.deg2rad([12.0 * np.sin(0.8 * t), 9.0 * np.sin(1.1 * t), 6.0 * np.sin(0.5 * t)])
        shift = 0.2 * np.array([np.sin(0.9 * t), np.sin(0.7 * t), np.sin(1.2 * t)])
        poses.append(moved_pose(FIRST, np.concatenate([shift, turn])))
    return poses


def spun(n: int) -> list[FloatArray]:
    """n poses (4, 4) of a target that turns about its model's z axis by 6 deg/s and drifts."""
    rates = np.array([0.05, 0.0, 0.02, 0.0, 0.0, np.deg2rad(6.0)])
    return [moved_pose(FIRST, STEP_S * k * rates) for k in range(n)]


def seen(target: Target, poses: list[FloatArray]) -> list[Frame]:
    """Their frames, with noise along the rays."""
    renderer, rng = DepthRenderer(target.mesh, CAMERA), np.random.default_rng(8)
    frames = []
    for k, T_cam_model in enumerate(poses):
        depth_m = renderer.render(T_cam_model).depth_m.copy()
        noisy = depth_m + SIGMA_M * rng.standard_normal(depth_m.shape).astype(np.float32)
        depth_m = np.where(depth_m > 0.0, noisy, 0.0).astype(np.float32)
        frames.append(Frame(k, STEP_S * k, depth_m, CAMERA, np.eye(4)))
    return frames


def tracked(
    target: Target,
    frames: list[Frame],
    choice: MotionChoice = MotionChoice.AUTO,
    info: SequenceInfo = INFO,
) -> list[Estimate]:
    tracker = Tracker(target, info, PerceptionTable(), FilterTable(motion=choice), 0)
    return [tracker.step(frame) for frame in frames]


def errors_of(estimates: list[Estimate], poses: list[FloatArray]) -> FloatArray:
    """(n, 2) of the poses of those that have one, m and deg."""
    found = []
    for estimate, T_cam_model in zip(estimates, poses, strict=True):
        if estimate.T_cam_target is not None:
            error = pose_error(T_cam_model, estimate.T_cam_target)
            found.append([np.linalg.norm(error[:3]), np.rad2deg(np.linalg.norm(error[3:]))])
    return np.array(found)


@pytest.mark.parametrize("choice", [MotionChoice.AUTO, MotionChoice.KINEMATIC])
def test_a_target_that_is_swung_about_is_followed(boxsat: Target, choice: MotionChoice) -> None:
    poses = swayed(20)
    estimates = tracked(boxsat, seen(boxsat, poses), choice)
    assert [estimate.status for estimate in estimates[2:]] == [Status.LOCKED] * 18
    assert [estimate.notes["motion"] for estimate in estimates[:2]] == [None, None]
    assert {estimate.notes["motion"] for estimate in estimates[12:]} == {"kinematic"}
    errors = errors_of(estimates, poses)
    assert np.all(np.median(errors, axis=0) < [2e-3, 0.1])
    assert np.all(np.max(errors, axis=0) < [1e-2, 0.4])


def test_a_target_that_is_jolted_is_not_lost(
    boxsat: Target, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO, logger="pcnav")
    steady = [moved_pose(FIRST, STEP_S * k * np.repeat([0.02, 0.03], 3)) for k in range(16)]
    jolt = np.array([0.1, 0.05, -0.1, 0.03, -0.05, 0.06])
    poses = [moved_pose(p, jolt) if k >= 12 else p for k, p in enumerate(steady)]
    estimates = tracked(boxsat, seen(boxsat, poses))
    assert {estimate.status for estimate in estimates[3:]} == {Status.LOCKED}
    assert [estimate.notes["motion"] for estimate in estimates[10:13]] == [
        "torque_free",
        "torque_free",
        "kinematic",
    ]
    assert np.all(errors_of(estimates[12:], poses[12:]) < [1e-2, 0.4])
    (said,) = [r.getMessage() for r in caplog.records if "the motion is" in r.getMessage()]
    assert said.startswith("frame 12: the motion is not that of a free body (")
    assert said.endswith("): followed as kinematic")


# A first pose.


def stated(T_cam_model: FloatArray) -> SequenceInfo:
    return replace(INFO, first_pose=FirstPosePrior(T_cam_model, 0.05, np.deg2rad(3.0)))


OFF = np.concatenate([np.full(3, 0.04), np.deg2rad([2.0, -2.0, 1.5])])
"""An error that the statement's spread allows."""


def test_a_first_pose_begins_the_track_in_the_first_frame(boxsat: Target) -> None:
    poses = swayed(6)
    info = stated(moved_pose(poses[0], OFF))
    estimates = tracked(boxsat, seen(boxsat, poses), info=info)
    assert {estimate.status for estimate in estimates} == {Status.LOCKED}
    errors = errors_of(estimates, poses)
    assert len(errors) == 6
    # As good as the frames allow, not as the statement was.
    assert np.all(errors < [1e-2, 0.4])


def test_a_first_pose_is_found_anywhere_in_its_spread(boxsat: Target) -> None:
    """Also where a fit from the stated pose itself ends elsewhere."""
    rates = np.array([0.3, 0.2, 0.02, 1.6, 0.9, 1.2])
    poses = [moved_pose(FIRST, STEP_S * k * rates) for k in range(2)]
    frames, rng = seen(boxsat, poses), np.random.default_rng(3)
    sd_m, sd_rad = 0.6, np.deg2rad(12.0)
    for _ in range(2):
        off = rng.normal(size=6)
        off *= 2.2 / np.linalg.norm(off) * np.repeat([sd_m, sd_rad], 3)
        prior = FirstPosePrior(moved_pose(poses[0], off), sd_m, sd_rad)
        estimates = tracked(boxsat, frames, info=replace(INFO, first_pose=prior))
        assert [estimate.status for estimate in estimates] == [Status.LOCKED] * 2
        assert np.all(errors_of(estimates, poses) < [1e-2, 0.4])


def test_a_free_motion_alone_still_needs_three_frames(boxsat: Target) -> None:
    poses = [moved_pose(FIRST, STEP_S * k * np.repeat([0.02, 0.03], 3)) for k in range(4)]
    frames, info = seen(boxsat, poses), stated(moved_pose(poses[0], OFF))
    estimates = tracked(boxsat, frames, MotionChoice.TORQUE_FREE, info)
    words = [estimate.status for estimate in estimates]
    assert words == [Status.ACQUIRING] * 2 + [Status.LOCKED] * 2


@pytest.mark.parametrize(
    ("wrong", "why"),
    [
        (np.array([0.0, 0.0, 0.0, 0.0, 0.0, 1.2]), "it explains|deg off|another pose"),
        (np.array([5.0, 0.0, 0.0, 0.0, 0.0, 0.0]), "nothing of the target|it explains|m and"),
    ],
)
def test_a_first_pose_that_the_frame_contradicts_is_dropped(
    boxsat: Target, wrong: FloatArray, why: str, caplog: pytest.LogCaptureFixture
) -> None:
    poses = swayed(5)
    estimates = tracked(boxsat, seen(boxsat, poses), info=stated(moved_pose(poses[0], wrong)))
    (said,) = [r.getMessage() for r in caplog.records if "first pose" in r.getMessage()]
    assert said.startswith("frame 0: the first pose is dropped: ")
    assert any(part in said for part in why.split("|"))
    assert estimates[0].status == Status.ACQUIRING
    assert estimates[-1].status == Status.LOCKED
    assert np.all(errors_of(estimates[-1:], poses[-1:]) < [1e-2, 0.4])


@pytest.mark.parametrize("choice", [MotionChoice.AUTO, MotionChoice.TORQUE_FREE])
def test_an_image_that_comes_twice_is_no_target_that_stops(
    boxsat: Target, choice: MotionChoice
) -> None:
    """As little is lost as where the frame had been empty; of a free body not even its place."""
    poses = swayed(16) if choice is MotionChoice.AUTO else spun(16)
    frames = seen(boxsat, poses)
    for k in (9, 12):
        frames[k] = replace(frames[k], depth_m=frames[k - 1].depth_m)
    estimates = tracked(boxsat, frames, choice)
    assert [estimate.status for estimate in estimates[2:]] == [Status.LOCKED] * 14
    shown = list(poses)
    if choice is MotionChoice.AUTO:
        shown[9], shown[12] = poses[8], poses[11]
    errors = errors_of(estimates, shown)
    assert np.all(np.max(errors, axis=0) < [1e-2, 0.4])
    assert not estimates[9].records and np.isnan(estimates[9].nis)


def test_a_target_at_rest_seen_without_noise_is_measured_in_every_frame(boxsat: Target) -> None:
    frame = seen(boxsat, [FIRST])[0]
    frames = [replace(frame, index=k, time_s=STEP_S * k) for k in range(5)]
    estimates = tracked(boxsat, frames)
    assert [estimate.status for estimate in estimates[2:]] == [Status.LOCKED] * 3
    assert all(estimate.nis_dof > 0 for estimate in estimates[3:])
