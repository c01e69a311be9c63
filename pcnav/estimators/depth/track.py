"""What is kept of a target that is being followed, and what it is worth."""

from dataclasses import dataclass, field

import numpy as np

from pcnav.core.arrays import FloatArray
from pcnav.estimators.depth.astray import Astray
from pcnav.estimators.depth.evidence import Evidence
from pcnav.estimators.depth.following import FollowedMotion
from pcnav.estimators.depth.lasting_errors import LastingErrors
from pcnav.estimators.depth.lock_monitor import LockMonitor
from pcnav.estimators.depth.measured_again import RecentFrames
from pcnav.estimators.depth.target_odds import TrackOdds
from pcnav.runs.status import Status


@dataclass
class Track:
    """A target being followed."""

    motion: FollowedMotion
    lock_monitor: LockMonitor
    evidence: Evidence
    recent: RecentFrames
    lasting: LastingErrors
    symmetric: bool
    """Whether the target's own symmetry leaves equivalent attitudes."""
    open_question: bool
    """Whether another motion, no equivalent one, explains the frames as well."""
    odds: TrackOdds
    blind_frames: int = 0
    refuted_frames: int = 0
    was_wrong: bool = False
    astray: Astray = field(default_factory=Astray)
    """What the frames since the last one that was taken in contradict."""

    @property
    def is_single(self) -> bool:
        """Whether one frame is all that there is of it, which shows no rate."""
        return self.recent.count == 1 and np.isnan(self.evidence.usual_inlier_ratio)

    @property
    def status(self) -> Status:
        """What it is worth after a frame that was used: while there is doubt that it is the target,
        or that it is so turned, it is followed and not claimed."""
        if self.open_question or not self.odds.is_clear:
            return Status.COASTING
        return Status.AMBIGUOUS if self.symmetric else Status.LOCKED

    @property
    def considered_covariance(self) -> FloatArray:
        """(20, 20) of the state beside what the filter knows of: errors that last from frame to
        frame, those of the calibration among them, and a motion that has failed."""
        return np.asarray(self.lasting.covariance + self.astray.covariance)

    @property
    def considered_in_camera(self) -> FloatArray:
        """(20, 20) of it that concerns where the target is in the camera."""
        return np.asarray(self.lasting.in_camera + self.astray.covariance)

    @property
    def stated_covariance(self) -> FloatArray:
        """(20, 20) of the state, whatever makes it: the one that is reported."""
        return np.asarray(self.motion.reported_covariance + self.considered_covariance)
