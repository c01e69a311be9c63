"""Learns the size of the target from the frames of a track, and tells perception."""

import logging
from dataclasses import replace

from pcnav.estimators.depth.views import FrameView
from pcnav.perception.calibration_doubt import CalibrationDoubt
from pcnav.perception.mesh_scale import ScaleBelief
from pcnav.perception.reading import FrameReader
from pcnav.recordings.calibration import NOT_STATED, Calibration

_log = logging.getLogger("pcnav")


class ScaleLearner:
    """By how much the target is larger than its mesh."""

    def __init__(self, reader: FrameReader, sd: float, stated: Calibration | None) -> None:
        """``reader`` is told; ``sd`` is how far the mesh may be off, 0 for one that is right."""
        self._reader, self._belief = reader, ScaleBelief(sd)
        self.calibration, self._is_stated = stated or NOT_STATED, stated is not None
        """How well all else is known, and the size of the target now."""
        self.factor = 1.0
        """By which the target is taken to be larger now."""
        self.doubt: CalibrationDoubt | None = None
        """What the last frames contradict most of the calibration; None before they tell."""

    def learn(self, view: FrameView, accepted: tuple[bool, ...]) -> bool:
        """Take in a frame that a track was updated with; whether it has changed the size."""
        comparison = view.comparison
        if comparison is None or self._belief.sd == 0.0:
            return False
        lever_m, used = 0.5 * self._reader.diameter_m, comparison.places(accepted)
        self._belief = self._belief.with_frame(comparison.seen, used, lever_m)
        others_sd = self.calibration.of_image(view.frame.camera)
        self.doubt = self._belief.doubt(others_sd) or self.doubt
        # What a recording does not state may be off, but is no reason to think that it is: where
        # ranges and outline contradict each other, frames would be followed by neither.
        change = self._belief.factor(others_sd if self._is_stated else 0.0 * others_sd)
        if change == 1.0:
            return False
        self._reader.rescale(change)
        sd = max(self.calibration.mesh_scale_sd, self._belief.sd_left(others_sd))
        self.calibration = replace(self.calibration, mesh_scale_sd=sd)
        # Frames that are compared at the new size tell what is left of it.
        self._belief = ScaleBelief(self._belief.sd)
        self.factor *= change
        off = self.factor - 1.0
        _log.info(
            "frame %d: the target is %.2g %% %s than its mesh: followed at that size",
            view.frame.index,
            100.0 * abs(off),
            "larger" if off > 0.0 else "smaller",
        )
        return True
