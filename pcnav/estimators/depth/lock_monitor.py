"""The lock monitor: a doubtful track against the poses found in one frame without it.

An update leaves out what does not fit, so a filter may go on with the faces that a wrong pose
happens to match. So the target is detected anew: the pose tracked and the poses found without it
are fitted to the same frame and compared by their conflicts, as motions are in the acquisition.
"""

from collections.abc import Sequence
from enum import Enum, auto

from pcnav.core.arrays import FloatArray
from pcnav.estimators.depth.evidence import Evidence
from pcnav.estimators.depth.pose_fit import SingleFramePose
from pcnav.estimators.depth.single_frame import refined_hypotheses, refitted
from pcnav.estimators.depth.target_odds import CLEAR_LEAD, frame_odds, lead
from pcnav.perception.perceive import PerceivedFrame
from pcnav.perception.reading import FrameReader
from pcnav.recordings.sequence import Frame
from pcnav.target.satellite import Target

_MAX_WAIT_FRAMES = 40
_MAX_WAIT_OPEN_FRAMES = 5
"""The same while the question is open: sooner or later a view tells the two apart."""
_VOTES = 2
"""Checks in a row against a track that end it: one frame may be spoilt by something in the way."""
_SAME_ANGLE_RAD = 0.1
_SAME_SHIFT_FRACTION = 0.05
"""Poses closer than this angle and share of the diameter are one."""


class LockCheck(Enum):
    """What the detection in one frame says of a track."""

    CONFIRMED = auto()
    """No other pose explains the frame nearly as well."""
    OPEN = auto()
    """Another pose explains it as well, or better in the first check."""
    REJECTED = auto()
    """Checks in a row found the target clearly elsewhere."""


class LockMonitor:
    """When to check a track, and what came of it. One for each track."""

    def __init__(self, target: Target, reader: FrameReader) -> None:
        self._target, self._reader = target, reader
        self._wait, self._since_check, self._votes = 1, 0, 0
        self._lead = 0.0

    def is_due(self, evidence: Evidence, *, is_open: bool) -> bool:
        """Whether the track is to be checked in this frame; asked once a frame.

        ``is_open``: whether the track is one of several that fitted the frames so far.
        """
        self._since_check += 1
        if self._votes:
            return True
        if not (evidence.is_doubtful or is_open):
            self._wait = 1
            return False
        return self._since_check >= self._wait

    def detect(self, frame: Frame) -> tuple[PerceivedFrame, tuple[SingleFramePose, ...]]:
        """The frame as seen without the track, and where the target may be in it."""
        perceived = self._reader.look(self._reader.thinned(frame))
        return perceived, refined_hypotheses(perceived, self._reader)

    def check(
        self, perceived: PerceivedFrame, found: Sequence[SingleFramePose], T_cam_model: FloatArray
    ) -> LockCheck:
        """Compare the pose tracked (4, 4) with the poses found in the same frame."""
        self._since_check = 0
        # What confirms a doubtful track once will do so in the next frame: doubt has other reasons.
        self._wait = min(2 * self._wait, _MAX_WAIT_FRAMES)
        led_by = self.lead_of(perceived, found, T_cam_model)
        self._votes = self._votes + 1 if led_by < -CLEAR_LEAD else 0
        if self._votes >= _VOTES:
            return LockCheck.REJECTED
        self._lead += led_by
        if self._votes or self._lead <= CLEAR_LEAD:
            self._wait = min(self._wait, _MAX_WAIT_OPEN_FRAMES)
            return LockCheck.OPEN
        # What was clear stays so while frames speak for it; one that speaks against it opens it.
        self._lead = CLEAR_LEAD
        return LockCheck.CONFIRMED

    def lead_of(
        self, perceived: PerceivedFrame, found: Sequence[SingleFramePose], T_cam_model: FloatArray
    ) -> float:
        """Log-likelihood of the pose tracked over the best other one; inf where there is none.

        Where the target is out of sight, something of anything else always fits best: a pose that
        the frame contradicts is none.
        """
        others = [
            pose
            for pose in found
            if frame_odds(pose.agreement) > 0.0 and not self._same(pose.T_cam_model, T_cam_model)
        ]
        if not others:
            return float("inf")
        fitted = refitted([T_cam_model], perceived, self._reader)
        stayed = [pose for pose in fitted if self._same(pose.T_cam_model, T_cam_model)]
        if stayed:
            tracked = stayed[0].agreement
        else:
            tracked = self._reader.score(perceived.frame, T_cam_model)
        return lead(tracked, [pose.agreement for pose in others])

    def _same(self, a: FloatArray, b: FloatArray) -> bool:
        return self._target.shows_alike(a, b, _SAME_ANGLE_RAD, _SAME_SHIFT_FRACTION)
