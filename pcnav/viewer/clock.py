"""Which frame is due, and what else: playback follows the time of the run, not what was drawn."""

from dataclasses import dataclass, field

import numpy as np

from pcnav.core.arrays import FloatArray


@dataclass(frozen=True)
class Playback:
    """Playing from a moment on at a speed; where drawing is late, frames are left out."""

    started_s: float
    """Of the wall clock."""
    from_s: float
    """Time of the run then."""
    speed: float
    """Seconds of the run per second."""

    def frame_at(self, now_s: float, time_s: FloatArray) -> int:
        """The last frame whose time has come; (n,) times of the frames, increasing."""
        at = self.from_s + (now_s - self.started_s) * self.speed
        return int(
            np.clip(np.searchsorted(time_s, at + 1e-9, side="right") - 1, 0, len(time_s) - 1)
        )

    def has_ended(self, now_s: float, time_s: FloatArray) -> bool:
        """Whether the last frame has come."""
        return self.frame_at(now_s, time_s) >= len(time_s) - 1


@dataclass
class Paced:
    """Something that is done at most so often, and at most every so many times that it is asked
    for: a browser that is slow has not the time for it with each frame."""

    period_s: float
    every: int = 1
    last_s: float = field(default=-np.inf)
    asked: int = 0

    def is_due(self, now_s: float) -> bool:
        """Whether it is time; if so it counts as done."""
        self.asked += 1
        if now_s - self.last_s < self.period_s or self.asked < self.every:
            return False
        self.last_s, self.asked = now_s, 0
        return True


def frame_to_show(due: int, shown: int, prepared: int | None) -> int:
    """The frame to draw while one is ``due`` and another ``shown``.

    A page that draws slowly leaves frames out. What was ``prepared`` for it meanwhile is nearly as
    good as the frame that is due, and at hand: it is drawn where it comes one frame early at most,
    and late by no more than it is on from the one before.
    """
    if due == shown - 1:
        # That was drawn early.
        return shown
    if prepared is None or prepared <= shown or due <= shown:
        return due
    return prepared if -1 <= due - prepared <= prepared - shown else due


def speeds(time_s: FloatArray) -> tuple[tuple[str, float], ...]:
    """Names and values of the speeds to choose from; the last shows 20 frames a second."""
    named = [(f"{speed:g} × real time", speed) for speed in (0.25, 1.0, 4.0, 16.0, 64.0)]
    steps = np.diff(time_s)
    step_s = float(np.median(steps)) if steps.size else 1.0
    return (*named, ("20 frames/s", 20.0 * step_s))
