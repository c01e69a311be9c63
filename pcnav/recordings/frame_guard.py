"""What frames have to be one after another, for an estimator that takes them in."""

import logging

from pcnav.core.errors import InputError
from pcnav.recordings.frame_checks import units_doubt
from pcnav.recordings.sequence import Frame

_LOG = logging.getLogger("pcnav")


class FrameGuard:
    """Holds frames to the order of time, and says once where their depths can hardly be metres."""

    def __init__(self, diameter_m: float) -> None:
        """``diameter_m`` is that of the target."""
        self._diameter_m = diameter_m
        self._last: tuple[int, float] | None = None
        self._units_judged = False

    def check(self, frame: Frame) -> None:
        """Raises `InputError` for a frame no later than the one before; nothing then changes."""
        if self._last is not None and not frame.time_s > self._last[1]:
            index, last_s = self._last
            expected = f"expected a time after the {last_s} s of frame {index}"
            raise InputError(f"frame {frame.index}", "time_s", f"{expected}, got {frame.time_s} s")
        self._last = (frame.index, frame.time_s)

    def doubt_units(self, frame: Frame) -> None:
        """Say once of the first frame with returns whether its depths can hardly be metres."""
        if not self._units_judged and frame.depth_m.any():
            self._units_judged = True
            doubt = units_doubt(frame.depth_m, frame.camera, self._diameter_m)
            if doubt is not None:
                _LOG.warning("frame %d: depth_m: %s", frame.index, doubt)
