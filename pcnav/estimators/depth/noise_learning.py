"""Learns the noise of the sensor from the frames of a track, and tells perception.

Only frames that the track explains are learnt from, so that a wrong lock cannot explain itself by
noise; what is stated holds until frames contradict it.
"""

import logging
from collections.abc import Sequence
from dataclasses import replace

from pcnav.core.arrays import FloatArray
from pcnav.estimators.depth.views import FrameView
from pcnav.perception.modality import Evidence
from pcnav.perception.noise_belief import NoiseBelief
from pcnav.perception.range_level import first_guess
from pcnav.perception.reading import FrameReader
from pcnav.perception.sensor_noise import SensorNoise
from pcnav.recordings.sequence import Frame

_log = logging.getLogger("pcnav")

_MIN_INLIER_RATIO = 0.7
"""Of a frame, to be learnt from."""
_EVERY_FRAME = 25
"""So many frames are all learnt from; afterwards every so many of"""
_EVERY = 5
_MOVED_PX = 0.3
"""A view that has moved by less errs as it did before."""
_CONTRADICTED = 1.5
"""Noise that differs from what is stated by this factor is told."""


class NoiseLearner:
    """The sensor noise of one recording, and what it is learnt from."""

    def __init__(self, reader: FrameReader, stated_m: float | None) -> None:
        """``reader`` is told; ``stated_m`` is None where nothing is known of the range noise."""
        self._reader, self._stated_m = reader, stated_m
        self._begun = reader.noise
        self._guessed = stated_m is not None
        self._told = False
        self._forget()

    def _forget(self) -> None:
        self._belief = self._before_start = self._no_belief()
        self._seen = 0
        self._last_pose: FloatArray | None = None

    def _no_belief(self) -> NoiseBelief:
        return NoiseBelief.before_any_frame(0.5 * self._reader.diameter_m, self._stated_m)

    @property
    def noise(self) -> SensorNoise:
        """As far as it is known now."""
        return self._reader.noise

    def begin(self, frame: Frame) -> None:
        """Make a first guess from a frame, where nothing is stated and nothing was seen yet."""
        if self._guessed:
            return
        guess = first_guess(frame.depth_m, frame.camera)
        if guess is not None:
            self._guessed = True
            self._begun = self._reader.noise = SensorNoise.before_any_frame(guess)
            _log.info("range noise is not stated: %.3g m in the first frame", guess)

    def start_again(self) -> None:
        """Forget what a track taught that was wrong."""
        self._forget()
        self._reader.noise = self._begun

    def learn(self, view: FrameView, accepted: tuple[bool, ...], pose: FloatArray) -> None:
        """Take in a frame that a track was updated with, to a pose (4, 4)."""
        if self._take_in(view, accepted, pose):
            self._apply()
            self._tell(view.frame)

    def learn_start(
        self, views: Sequence[FrameView], poses: Sequence[FloatArray], *, again: bool
    ) -> None:
        """Take in the frames that a track is to begin with, at poses (4, 4) found.

        ``again`` instead of the last time: they were measured anew under what was learnt then.
        """
        if not again:
            self._before_start = self._belief
        self._belief = replace(self._before_start, offsets=self._no_belief().offsets)
        self._last_pose = None
        for view, pose in zip(views, poses, strict=True):
            self._take_in(view, (True,) * len(view.measurements), pose)
        self._apply()

    def _take_in(self, view: FrameView, accepted: tuple[bool, ...], pose: FloatArray) -> bool:
        """Whether there may be something new to believe."""
        comparison = view.comparison
        if comparison is None or view.inlier_ratio < _MIN_INLIER_RATIO:
            return False
        self._seen += 1
        belief = self._belief
        used = [face for face, ok in zip(comparison.faces, accepted, strict=True) if ok]
        together = Evidence.together(
            (face.joint for face in used), comparison.seen.sensor_noise.n_shared
        )
        self._belief = belief.followed(view.frame.time_s, comparison, together)
        if belief.frames > _EVERY_FRAME and self._seen % _EVERY:
            return False
        if self._has_moved(pose, view.frame):
            lever_m = 0.5 * self._reader.diameter_m
            self._belief = self._belief.with_frame(comparison, together, lever_m)
        return True

    def _apply(self) -> None:
        noise = self._belief.applied(self.noise)
        if noise != self.noise:
            self._reader.noise = noise

    def _has_moved(self, pose: FloatArray, frame: Frame) -> bool:
        last = self._last_pose
        if last is not None and self._reader.moved_px(last, pose, frame) < _MOVED_PX:
            return False
        self._last_pose = pose
        return True

    def _tell(self, frame: Frame) -> None:
        stated, learnt = self._stated_m, self.noise.sigma_in(frame.depth_m)
        if stated is None or self._told:
            return
        if not 1.0 / _CONTRADICTED < learnt / stated < _CONTRADICTED:
            self._told = True
            _log.warning(
                "range_sigma_m is stated as %.3g m, the frames show %.3g m: that is used",
                stated,
                learnt,
            )
