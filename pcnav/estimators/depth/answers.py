"""What the tracker answers of a frame, and when a pose is known well enough to be claimed."""

from dataclasses import replace

import numpy as np

from pcnav.dynamics.state import ratio_covariance
from pcnav.estimators.depth.acquisition import Initialised
from pcnav.estimators.depth.doubts import FrameDoubts
from pcnav.estimators.depth.measuring import pose_of, predicted_pose
from pcnav.estimators.depth.pose_measurement import ObserverPose, pose_covariance
from pcnav.estimators.depth.track import Track
from pcnav.estimators.depth.views import FrameView
from pcnav.filtering.error_state import UpdateResult
from pcnav.recordings.sequence import Frame
from pcnav.runs.estimate import Estimate
from pcnav.runs.status import WRONG_SHIFT_FRACTION, WRONG_TURN_RAD, Status
from pcnav.target.satellite import Target

_MAY_BE_SD = 2.0
"""So many deviations off, a pose still may be."""


def is_known(track: Track, target: Target, observer: ObserverPose) -> bool:
    """Whether the pose is known in all directions but those of which the target shows no trace: of
    two faces and no edge it is not.

    All counts that is stated of it in the camera, but what is assumed of a calibration of which
    nothing was stated. A mass that was only told moves the state and not the pose.
    """
    kalman = track.motion.kalman
    pose, covariance = predicted_pose(kalman, observer)
    considered = pose_covariance(kalman.state, track.considered_in_camera, observer)
    covariance = covariance + considered
    if target.roundness is not None:
        without_turns = target.roundness.without_turns(pose[:3, :3])
        covariance = without_turns @ covariance @ without_turns.T
    shift, turn = (
        float(np.sqrt(np.linalg.eigvalsh(covariance[part, part])[-1]))
        for part in (slice(0, 3), slice(3, 6))
    )
    # One that may be off by as much as makes a pose a wrong one is none that could be claimed.
    may_be = _MAY_BE_SD * shift / target.diameter_m, _MAY_BE_SD * turn
    return may_be[0] < WRONG_SHIFT_FRACTION and may_be[1] < WRONG_TURN_RAD


def answer_of_frame(
    track: Track | None,
    view: FrameView,
    result: UpdateResult | None,
    status: Status,
    observer: ObserverPose,
    doubts: FrameDoubts,
) -> Estimate:
    """The estimate after a frame.

    Args:
        track: what is followed; None while nothing is.
        view: the frame as it was measured.
        result: what the filter made of it; None where it was not updated.
        status: what the estimate is worth.
        observer: where the camera was.
        doubts: what speaks against it.
    """
    accepted = (True,) * len(view.measurements) if result is None else result.accepted
    estimate = Estimate(
        time_s=view.frame.time_s,
        status=str(status),
        nis=float("nan") if result is None else result.joint_nis,
        nis_dof=0 if result is None else result.joint_dof,
        window_nis=float("nan") if track is None else track.evidence.window_nis,
        notes={
            "inlier_ratio": view.inlier_ratio,
            "n_rectangles": sum(accepted[face] for face in view.face_of_record),
            "motion": None if track is None else str(track.motion.name),
            **doubts.notes,
        },
        records=view.outcomes(accepted, result),
    )
    if track is None:
        return estimate
    kalman, seen = track.motion.kalman, view.T_cam_seen
    return replace(
        estimate,
        values=kalman.state.values,
        covariance=ratio_covariance(kalman.state, track.stated_covariance),
        T_cam_target=pose_of(kalman, observer) if seen is None else seen,
    )


def rectangles_used(estimate: Estimate) -> int:
    """How many rectangles of a frame the filter used."""
    return int(estimate.notes["n_rectangles"] or 0)


def usual_at_start(begun: Initialised, frame: Frame) -> float:
    """Mean inlier ratio of the frames of a start; nan where they were looked at on a coarser grid,
    on which other shares are explained."""
    views = [view for view, _ in begun.start]
    if not views or any(view.frame.camera != frame.camera for view in views):
        return float("nan")
    return float(np.mean([view.inlier_ratio for view in views]))
