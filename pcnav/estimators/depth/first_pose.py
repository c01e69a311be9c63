"""A start from where the target is said to be in the first frame, if the frame does not object."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pcnav.config.depth import Measurements
from pcnav.core.arrays import FloatArray
from pcnav.estimators.depth.pose_fit import SingleFramePose, fit_pose
from pcnav.estimators.depth.pose_measurement import pose_error
from pcnav.estimators.depth.single_frame import refined_hypotheses, refitted
from pcnav.estimators.depth.target_odds import CLEAR_LEAD, frame_odds, lead
from pcnav.filtering.error_state import innovation_gate
from pcnav.perception.perceive import PerceivedFrame
from pcnav.perception.reading import FrameReader
from pcnav.recordings.sequence import FirstPosePrior

STATED_ODDS = CLEAR_LEAD
"""Logarithm of the odds that the statement itself gives."""
_MIN_SD_FRACTION, _MIN_SD_RAD = 0.01, 0.02
"""What a comparison may be off by at first, over the diameter and in rad: more than any frame, so
that the frame decides however sharp the statement."""
_GATE_PROBABILITY = 0.9999
"""Of how far the frame may move the pose, in its stated spread."""
_SAME_PX = 3.0
"""Poses that show no point of the target further apart are one."""


@dataclass(frozen=True)
class FirstPoseFit:
    """What a first frame makes of a stated pose."""

    pose: SingleFramePose | None
    """The pose fitted from there; None where the frame contradicts it."""
    objection: str = ""
    """Why it does."""


def fit_first_pose(
    stated: FirstPosePrior, perceived: PerceivedFrame, reader: FrameReader
) -> FirstPoseFit:
    """Begin from a stated pose: fitted to the frame, and dropped where that contradicts it.

    It is contradicted where too little of the frame agrees, where the frame moves it further than
    its spread allows, and where another pose of the same frame is clearly more likely. A statement
    from which no fit leads to the target chooses among the poses that a search finds.
    """
    pose = _fitted(stated.T_cam_model, stated, perceived, reader)
    near = stated.T_cam_model if pose is None else pose.T_cam_model
    others = refined_hypotheses(perceived, reader, (near,))
    if not _agrees(pose):
        likely = [other for other in others if _is_within(stated, other)]
        pose = max([*likely, *([pose] if pose else [])], key=_odds, default=None)
    if pose is None or np.isnan(pose.agreement.visible_ratio):
        return FirstPoseFit(None, "nothing of the target is seen from there")
    if not _agrees(pose):
        return FirstPoseFit(None, f"it explains {pose.agreement.visible_ratio:.0%} of the frame")
    if not _is_within(stated, pose):
        error = pose_error(stated.T_cam_model, pose.T_cam_model)
        shift, turn = np.linalg.norm(error[:3]), np.rad2deg(np.linalg.norm(error[3:]))
        return FirstPoseFit(None, f"the frame has it {shift:.3g} m and {turn:.2g} deg off")
    if _lead(pose, others, perceived, reader) < -CLEAR_LEAD:
        return FirstPoseFit(None, "another pose explains the frame better")
    return FirstPoseFit(pose)


def _is_within(stated: FirstPosePrior, pose: SingleFramePose) -> bool:
    """Whether a pose of the frame is one that the statement allows."""
    error = pose_error(stated.T_cam_model, pose.T_cam_model)
    spread = np.diag(_deviations(stated, 0.0, 0.0) ** 2) + pose.covariance
    squared = float(error @ np.linalg.solve(spread, error))
    return squared <= innovation_gate(_GATE_PROBABILITY, len(error))


def _odds(pose: SingleFramePose) -> float:
    """Logarithm of the odds by the frame; -inf where it shows nothing that could agree."""
    if np.isnan(pose.agreement.visible_ratio):
        return -np.inf
    return frame_odds(pose.agreement)


def _agrees(pose: SingleFramePose | None) -> bool:
    return pose is not None and STATED_ODDS + _odds(pose) >= 0.0


def _fitted(
    guess: FloatArray, stated: FirstPosePrior, perceived: PerceivedFrame, reader: FrameReader
) -> SingleFramePose | None:
    """The pose that the frame has near a guess (4, 4) within the stated spread."""
    if reader.measured_by is Measurements.RECTANGLES:
        found = refitted([guess], perceived, reader)
        return found[0] if found else None
    frame = perceived.frame
    comparer = reader.comparer(frame)
    sd = _deviations(stated, _MIN_SD_FRACTION * reader.diameter_m, _MIN_SD_RAD)
    prior = np.diag(sd**2)
    rough = fit_pose(frame.depth_m, guess, prior, comparer.coarse(frame.depth_m))
    if rough is None:
        return None
    # The frame is used once: the coarse pass says where to start, not what is known.
    return fit_pose(frame.depth_m, rough.T_cam_model, prior, comparer, spread=rough.covariance)


def _deviations(stated: FirstPosePrior, min_m: float, min_rad: float) -> FloatArray:
    place, turn = max(stated.position_sd_m, min_m), max(stated.attitude_sd_rad, min_rad)
    return np.repeat([place, turn], 3)


def _lead(
    pose: SingleFramePose,
    found: Sequence[SingleFramePose],
    perceived: PerceivedFrame,
    reader: FrameReader,
) -> float:
    """Log-likelihood of a pose over the best other one; inf where there is none."""
    frame = perceived.frame
    others = [
        other.agreement
        for other in found
        if reader.moved_px(pose.T_cam_model, other.T_cam_model, frame) > _SAME_PX
    ]
    return lead(pose.agreement, others)
