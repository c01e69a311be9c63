"""Poses of frames that a target moves in: where it is and how it moves are fitted together.

A pose that is fitted as if the target stood still is pulled by whatever returned first and last,
and explains neither. How it moves shows in the frame itself: a return seen a time t after that of
the frame lies where the pose moved by t times the rate has it, so the residual's derivative by the
rate is t times that by the pose. Then the pose is fitted anew under that motion, by the outline as
well; what the motion is uncertain by makes it as much more uncertain.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pcnav.core.arrays import FloatArray
from pcnav.estimators.depth.pose_fit import SingleFramePose, fit_pose
from pcnav.estimators.depth.pose_measurement import moved_pose, pose_error
from pcnav.perception.reading import FrameReader
from pcnav.perception.render_compare import RenderComparer
from pcnav.recordings.sequence import Frame
from pcnav.target.row_motion import Readout

_RATE_SD_RAD_S = 0.5
"""How a target may turn, and by how much its origin may move at half its diameter from what it
turns about; faster ones leave no image."""
_POSE_SD_FRACTION, _POSE_SD_RAD = 0.02, 0.15
"""How far a pose fitted to a frame as if it stood still may be off."""
_MAX_PASSES = 6
_STILL_SHARE = 0.3
"""A step of less than this many standard deviations is the last."""
_MIN_RETURNS = 60
_MAX_POSES = 12
"""Of a frame, best first, that are fitted anew."""


def unskewed(
    poses: Sequence[SingleFramePose], frame: Frame, reader: FrameReader
) -> tuple[SingleFramePose, ...]:
    """Poses found in a frame, each fitted anew with a motion of its own; the best explaining
    first."""
    expected = reader.expected_motion
    found = [_fitted(pose, frame, reader) for pose in poses[:_MAX_POSES]]
    reader.expect_motion(expected)
    return tuple(sorted(found, key=lambda pose: -pose.agreement.support))


def _fitted(pose: SingleFramePose, frame: Frame, reader: FrameReader) -> SingleFramePose:
    """One of them; itself where that explains more."""
    comparer, motion = reader.comparer(frame), reader.expected_motion
    sd = np.repeat([_POSE_SD_FRACTION * reader.diameter_m, _POSE_SD_RAD], 3)
    T_cam_model, twist, by_twist = _moving(frame, pose.T_cam_model, motion, comparer, sd)
    comparer.readout = Readout(twist)
    fit = fit_pose(frame.depth_m, T_cam_model, np.diag(sd**2), comparer, spread=pose.covariance)
    if fit is None or fit.agreement.support < pose.agreement.support:
        return pose
    return replace(fit, motion=comparer.readout, covariance=fit.covariance + by_twist)


def _moving(
    frame: Frame,
    T_guess: FloatArray,
    motion: Readout | None,
    comparer: RenderComparer,
    pose_sd: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Pose (4, 4) and twist (6,) by the ranges of a frame, from a guess of either, and what the
    uncertainty of the twist adds to the covariance (6, 6) of a pose fitted under it."""
    rate_sd = _RATE_SD_RAD_S * np.repeat([comparer.lever_m, 1.0], 3)
    prior = np.diag(np.concatenate([pose_sd, rate_sd]) ** -2.0)
    T_cam_model, twist = T_guess, np.zeros(6) if motion is None else motion.twist
    spread, by_twist = np.diag(pose_sd**2), np.zeros((6, 6))
    for _ in range(_MAX_PASSES):
        comparer.readout = Readout(twist)
        residuals = comparer.compare(frame.depth_m, T_cam_model, spread).seen.residuals
        used = residuals.agrees
        if np.count_nonzero(used) < _MIN_RETURNS or residuals.time_s is None:
            break
        by_pose = residuals.jacobian[used]
        rows = np.hstack([by_pose, residuals.time_s[used, None] * by_pose])
        sigma_m = np.broadcast_to(residuals.sigma_m, used.shape)[used]
        weighted = rows / sigma_m[:, None] ** 2
        information = prior + weighted.T @ rows
        off = np.concatenate([pose_error(T_cam_model, T_guess), -twist])
        vector = prior @ off + weighted.T @ residuals.residual_m[used]
        step = np.linalg.solve(information, vector)
        by_twist = _added_by_twist(information)
        T_cam_model, twist = moved_pose(T_cam_model, step[:6]), twist + step[6:]
        if step @ information @ step < _STILL_SHARE**2 * len(step):
            break
        # What moved is as wrong as a part of how it moved.
        spread = np.diag((0.2 * pose_sd) ** 2) + 0.1 * np.outer(step[:6], step[:6])
    return T_cam_model, twist, by_twist


def _added_by_twist(information: FloatArray) -> FloatArray:
    """(6, 6) that the covariance of a pose has more by the joint information (12, 12) of pose and
    twist than where the twist is known."""
    known = np.linalg.inv(information[:6, :6])
    return np.asarray(np.linalg.inv(information)[:6, :6] - known)
