"""How errors of a frame's pose move the state of a filter that takes the frame in."""

from dataclasses import dataclass

import numpy as np

from pcnav.core.arrays import FloatArray
from pcnav.dynamics.state import R_HILL, STATE_SIZE, THETA_BODY
from pcnav.estimators.depth.measuring import Kalman
from pcnav.estimators.depth.pose_measurement import ObserverPose, pose_jacobian
from pcnav.perception.modality import POSE_SIZE, Evidence
from pcnav.perception.render_compare import Comparison

_FAINT = 1e-3
"""What a frame tells of a pose is not its own where it is less than that of what is known."""


@dataclass(frozen=True)
class Influence:
    """Of one frame on a filter of n states."""

    kept: FloatArray
    """(n, n) of the error before the frame, ``1 - K H``."""
    by_evidence: FloatArray
    """(n, 6) by what is added to the vector of the evidence of the frame's pose."""
    of_pose: FloatArray
    """(6, 6 + k) of that vector, by one that has k errors besides which the frame shares."""
    information: FloatArray
    """(6, 6) of the frame's pose."""
    of_first: FloatArray | None = None
    """(n, 6) by the pose that all frames so far show, of the first that is known of a filter."""

    def by_pose(self, error: FloatArray) -> FloatArray:
        """(n, m) by errors (6, m) of the pose that the frame shows."""
        if self.of_first is not None:
            return np.asarray(self.of_first @ error)
        return np.asarray(self.by_evidence @ self.information @ error)


def influence_of(
    kalman: Kalman,
    observer: ObserverPose,
    comparison: Comparison,
    used: tuple[bool, ...],
    *,
    is_first: bool,
) -> Influence:
    """Of a compared frame that a filter was just updated with.

    What a filter that is new made of its frames is not known: all of them then saw the target as
    much off its place as this one, so it moves as it seems to, but elsewhere.

    Args:
        kalman: the filter.
        observer: where the camera was.
        comparison: of the frame with the view.
        used: which of its faces were.
        is_first: whether what the filter made of its frames so far is not known.
    """
    n_shared = comparison.seen.noise.n_shared
    faces = zip(comparison.faces, used, strict=True)
    together = Evidence.together((f.joint for f, ok in faces if ok), n_shared)
    shared = together.information[POSE_SIZE:, POSE_SIZE:] + np.eye(n_shared)
    cross = together.information[:POSE_SIZE, POSE_SIZE:]
    of_pose = np.hstack([np.eye(POSE_SIZE), -np.linalg.solve(shared, cross.T).T])
    information = together.of_pose.information
    if observer.noise.is_there:
        # What the camera's own pose errs by is part of what the frame shows.
        by = observer.noise.by_unit(comparison.T_cam_model)
        inner = np.eye(by.shape[1]) + by.T @ information @ by
        left = np.eye(POSE_SIZE) - information @ by @ np.linalg.solve(inner, by.T)
        information, of_pose = left @ information, left @ of_pose
    J, P = pose_jacobian(kalman.state, observer), kalman.covariance
    gain = P @ J.T
    if not is_first:
        return Influence(np.eye(STATE_SIZE) - gain @ information @ J, gain, of_pose, information)
    index, none = np.r_[R_HILL, THETA_BODY], np.zeros((STATE_SIZE, STATE_SIZE))
    of_first = np.zeros((STATE_SIZE, POSE_SIZE))
    of_first[index] = np.linalg.inv(J[:, index])
    known = _FAINT * np.linalg.inv(J @ gain)
    alone = np.asarray(np.linalg.inv(information + known))
    return Influence(none, of_first @ alone, of_pose, information, of_first)
