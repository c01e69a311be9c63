"""Where the target is when it is not where the filter in force predicts it."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from pcnav.core.arrays import FloatArray
from pcnav.dynamics.state import NavigationState
from pcnav.estimators.depth.evidence import Evidence
from pcnav.estimators.depth.following import FollowedMotion
from pcnav.estimators.depth.kinematic import BRIDGED, LINKED, KinematicFilter
from pcnav.estimators.depth.measuring import (
    FrameUpdate,
    Kalman,
    Updated,
    pose_of,
    predicted_pose,
)
from pcnav.estimators.depth.pose_fit import SingleFramePose
from pcnav.estimators.depth.pose_measurement import (
    ObserverPose,
    UncertainPose,
    moved_pose,
    pose_error,
    poses_about,
)
from pcnav.estimators.depth.target_odds import CLEAR_LEAD, frame_odds
from pcnav.filtering.error_state import Snapshot, innovation_gate
from pcnav.perception.reading import FrameReader
from pcnav.recordings.sequence import Frame

_USUAL_SHARE, _WELL_SHARE = 0.8, 0.95
"""A frame of which a smaller share than this of the usual is explained is not explained as it
should be; and below the second there may be a better pose."""


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

    def is_as_usual(self, updated: Updated, share: float = _USUAL_SHARE) -> bool:
        """Whether an update explains its frame about as well as the frames before: so large a
        share of what was usual."""
        result, comparison = updated.result, updated.view.comparison
        if result is None or not updated.is_good or self.evidence.is_strained(result):
            return False
        if comparison is not None and frame_odds(comparison.agreement) < -CLEAR_LEAD:
            # The frames before speak for the target: this one alone says that it is none.
            return False
        # Of the first frames nothing is usual yet.
        return not updated.explained < share * self.evidence.usual_inlier_ratio

    def overruled(self, motion: FollowedMotion, updated: Updated) -> Updated:
        """The update of a kinematic filter in force, or a better one about where a jolt may have
        led; the frame refused where none explains it as usual."""
        if motion.kinematic is None or self.is_as_usual(updated, _WELL_SHARE):
            return updated
        after = motion.kinematic.kalman.snapshot()
        again = self.near(motion)
        if self.is_as_usual(updated) and not (again and again.explained > updated.explained):
            motion.kinematic.reset()
            motion.kinematic.kalman.restore(after)
            return updated
        return again or updated.refused

    def start(self, motion: FollowedMotion) -> UncertainPose | None:
        """Where to compare first, if not at the prediction in all its spread: a comparison finds
        home over so much, and a view drawn in a wider one tells nothing from nothing."""
        if motion.is_torque_free:
            return None
        return self._bridged(predicted_pose(motion.kalman, self.observer))

    def _bridged(self, predicted: UncertainPose) -> UncertainPose:
        """A prediction with as much of its spread as a comparison finds home over."""
        pose, spread = predicted
        bridged = np.array([BRIDGED[0] * self.reader.diameter_m, BRIDGED[1]]) ** 2
        parts = np.array([np.trace(spread[:3, :3]), np.trace(spread[3:, 3:])]) / 3.0
        return pose, spread / max(1.0, float(np.max(parts / bridged)))

    def near(self, motion: FollowedMotion) -> Updated | None:
        """The best update of the kinematic filter about where the target may have gone.

        That is as predicted, or with a jolt; or the target stayed, or went on twice as far, as it
        seems to where a frame was repeated or left out. The filter is left as predicted where
        nothing explains the frame as usual.
        """
        kinematic = motion.kinematic
        if kinematic is None:
            return None
        best: tuple[Updated, Snapshot[NavigationState]] | None = None
        for start in self._starts(motion, kinematic):
            found = self._about(kinematic.kalman, start)
            better = best is None or found.explained > best[0].explained
            if better and self.is_as_usual(found):
                best = found, kinematic.kalman.snapshot()
            if self.is_as_usual(found, _WELL_SHARE):
                break
        if best is None:
            kinematic.reset()
            return None
        kinematic.kalman.restore(best[1])
        return best[0]

    def jolted(
        self, motion: FollowedMotion, lead_of: Callable[[FloatArray], float]
    ) -> Updated | None:
        """`near`, unless the frame shows the target elsewhere.

        ``lead_of`` gives the log-likelihood of a pose (4, 4) over all others of the frame.
        """
        again, kinematic = self.near(motion), motion.kinematic
        if again is None or kinematic is None:
            return again
        if lead_of(pose_of(kinematic.kalman, self.observer)) > -CLEAR_LEAD:
            return again
        kinematic.reset()
        return None

    def _starts(
        self, motion: FollowedMotion, kinematic: KinematicFilter
    ) -> Iterator[UncertainPose | None]:
        """Where `near` looks; the filter is put back to its prediction before each."""
        if motion.is_torque_free:
            yield None
        kinematic.widen(BRIDGED)
        predicted, spread = predicted_pose(kinematic.kalman, self.observer)
        before = motion.before.T_cam_model(self.observer.T_cam_world, self.observer.R_hill_world)
        beyond = moved_pose(predicted, pose_error(before, predicted))
        for pose in (predicted, before, beyond):
            kinematic.widen(BRIDGED)
            yield pose, spread

    def _about(self, kalman: Kalman, start: UncertainPose | None) -> Updated:
        return self.update(FrameUpdate(self.reader, self.frame, kalman, self.observer, start))

    def without_rate(
        self, kalman: Kalman, updated: Updated, predicted: Snapshot[NavigationState]
    ) -> Updated:
        """The best update with the frame after a start from a single one.

        Its prediction knows no rate: a comparison about it may end beside the target, though the
        target lies within its spread. The filter was ``predicted`` and then ``updated``.
        """
        if updated.is_good and updated.explained >= _WELL_SHARE:
            return updated
        best, after = updated, kalman.snapshot()
        kalman.restore(predicted)
        pose, spread = self._bridged(predicted_pose(kalman, self.observer))
        for guess in poses_about(pose, spread):
            kalman.restore(predicted)
            found = self._about(kalman, (guess, spread))
            if found.is_good and not found.explained <= best.explained:
                best, after = found, kalman.snapshot()
        kalman.restore(after)
        return best

    def found(self, motion: FollowedMotion, poses: Sequence[SingleFramePose]) -> Updated | None:
        """`found_again` of the filter in force; a kinematic one takes what explains as usual."""
        again = self.found_again(motion.kalman, poses)
        if again is None or motion.is_torque_free or self.is_as_usual(again):
            return again
        if motion.kinematic is not None:
            motion.kinematic.reset()
        return None

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
            if frame_odds(pose.agreement) > -CLEAR_LEAD and squared < gate:
                allowed.append((squared, pose))
        if not allowed:
            return None
        best = min(allowed, key=lambda pair: pair[0])[1]
        start = (best.T_cam_model, best.covariance)
        updated = self._about(kalman, start)
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
