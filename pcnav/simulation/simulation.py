"""A recording in memory, with the truth behind it, and how both are written."""

import logging
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Generic, TypeVar

import numpy as np

from pcnav.core.arrays import FloatArray
from pcnav.dynamics.trajectory import Trajectory
from pcnav.recordings.recording import Recording
from pcnav.recordings.tracks import TrackFrame

R = TypeVar("R", bound=Recording)
F = TypeVar("F")

OnFrame = Callable[[int, int], None]
"""Told after every frame how many are done, and of how many."""

_LOG = logging.getLogger("pcnav")


@dataclass(frozen=True)
class Simulation(Generic[R]):
    """What a sensor sees of a scenario; the same pipeline gives the same numbers."""

    recording: R
    """Its frames one by one."""
    truth: Trajectory
    """All blocks at every frame."""
    store: Callable[[Path, bool, OnFrame | None], str]
    """Writes both; see `write`."""
    points: FloatArray = field(default_factory=lambda: np.zeros((0, 3)))
    """(N, 3) true features of stereo tracks from the mass centre, body axes, m."""

    def write(self, out: Path, overwrite: bool = False, on_frame: OnFrame | None = None) -> str:
        """Write recording and truth into a folder; what it was, in a line.

        Raises `InputError` for a folder that must not be replaced; nothing is then left behind.
        """
        return self.store(out, overwrite, on_frame)


def counted(frames: Iterable[F], total: int, on_frame: OnFrame | None) -> Iterator[F]:
    """The frames, each told of when it has been taken."""
    for done, frame in enumerate(frames, start=1):
        yield frame
        if on_frame is not None:
            on_frame(done, total)


def features_seen(out: Path, frames: Iterable[TrackFrame]) -> FloatArray:
    """(n,) number of features of every frame; warns where there are none at all."""
    seen = np.array([float(len(frame.features)) for frame in frames])
    if not seen.any():
        _LOG.warning("%s: no feature is seen in any of the %d frames", out, len(seen))
    return seen
