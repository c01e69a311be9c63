"""Where the target is when it is not where the filter in force predicts it."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from pcnav.core.arrays import FloatArray
from pcnav.estimators.depth.evidence import Evidence
from pcnav.estimators.depth.following import FollowedMotion
from pcnav.estimators.depth.kinematic import BRIDGED, LINKED
from pcnav.estimators.depth.measuring import FrameUpdate, Kalman, Updated, predicted_pose
from pcnav.estimators.depth.motion_hypotheses import CLEAR_LEAD
from pcnav.estimators.depth.pose_fit import SingleFramePose
from pcnav.estimators.depth.pose_measurement import ObserverPose, pose_error
from pcnav.filtering.error_state import innovation_gate
from pcnav.perception.reading import FrameReader
from pcnav.recordings.sequence import Frame

_MIN_INLIER_RATIO = 0.5
"""Of a pose found without the track, or off the prediction, for it to be accepted."""
_MAX_DROP = 0.15
"""A frame explained by so much less than usual is not explained as it should be."""


@dataclass(frozen=True)
class Recovery:
    """Looks for a target in one frame."""

    reader: FrameReader
    frame: Frame
    observer: ObserverPose
    update: Callable[[FrameUpdate], Updated]
    gate_probability: float
    evidence: Evidence
    """Of the track so far."""

    def is_as_usual(self, updated: Updated) -> bool:
        """Whether an update explains its frame about as well as the frames before."""
        result, floor = updated.result, _MIN_INLIER_RATIO
        if result is None or not updated.is_good or self.evidence.is_strained(result):
            return False
        usual = self.evidence.usual_inlier_ratio
        if np.isfinite(usual):
            floor = max(floor, usual - _MAX_DROP)
        # In paper mode nothing is rendered, and the ratio is not known.
        return not updated.view.inlier_ratio < floor

    def near(self, motion: FollowedMotion) -> Updated | None:
        """An update of the kinematic filter, about its prediction or one widened by a jolt.

        The filter is left as predicted where there is none.
        """
        kinematic = motion.kinematic
        if kinematic is None:
            return None
        for _ in self._widenings(motion):
            found = self.update(
                FrameUpdate(self.reader, self.frame, kinematic.kalman, self.observer)
            )
            if self.is_as_usual(found):
                return found
        kinematic.reset()
        return None

    def nearer(self, motion: FollowedMotion, updated: Updated) -> Updated:
        """The better of an update of the kinematic filter and one about its widened prediction."""
        kinematic = motion.kinematic
        assert kinematic is not None, "it is in force"
        after = kinematic.kalman.snapshot()
        again = self.near(motion)
        if again is not None and not again.view.inlier_ratio < updated.view.inlier_ratio:
            return again
        if updated.is_good:
            kinematic.kalman.restore(after)
        return updated

    def _widenings(self, motion: FollowedMotion) -> Iterator[None]:
        kinematic = motion.kinematic
        assert kinematic is not None, "the caller saw to it"
        if motion.is_torque_free:
            yield
        kinematic.widen(BRIDGED)
        yield

    def found_again(self, kalman: Kalman, found: Sequence[SingleFramePose]) -> Updated | None:
        """An update from where the target is found without the track, if the prediction allows it.

        After a gap the prediction may be off by more than a comparison with its view can bridge.
        """
        predicted, spread = predicted_pose(kalman, self.observer)
        allowed = []
        for pose in found:
            error = pose_error(predicted, pose.T_cam_model)
            squared = float(error @ np.linalg.solve(spread + pose.covariance, error))
            gate = innovation_gate(self.gate_probability, len(error))
            if pose.inlier_ratio >= _MIN_INLIER_RATIO and squared < gate:
                allowed.append((squared, pose))
        if not allowed:
            return None
        best = min(allowed, key=lambda pair: pair[0])[1]
        start = (best.T_cam_model, best.covariance)
        updated = self.update(FrameUpdate(self.reader, self.frame, kalman, self.observer, start))
        return updated if updated.is_good else None

    def found_far(
        self,
        motion: FollowedMotion,
        found: Sequence[SingleFramePose],
        lead_of: Callable[[FloatArray], float],
    ) -> Updated | None:
        """The same where a jolt may have moved the target as far as poses are linked over.

        ``lead_of`` gives the log-likelihood of a pose (4, 4) over all others of the frame: nothing
        but the frame speaks for such a pose, so there must be no other.
        """
        kinematic = motion.kinematic
        if kinematic is None:
            return None
        predicted, _ = predicted_pose(kinematic.kalman, self.observer)
        near = [pose for pose in found if self._is_linked(predicted, pose.T_cam_model)]
        if not near or lead_of(near[0].T_cam_model) < CLEAR_LEAD:
            return None
        kinematic.widen(LINKED)
        updated = self.found_again(kinematic.kalman, near[:1])
        if updated is None or not self.is_as_usual(updated):
            kinematic.reset()
            return None
        return updated

    def _is_linked(self, predicted: FloatArray, T_cam_model: FloatArray) -> bool:
        error = pose_error(predicted, T_cam_model)
        shift = float(np.linalg.norm(error[:3])) / self.reader.diameter_m
        return shift < LINKED[0] and float(np.linalg.norm(error[3:])) < LINKED[1]
