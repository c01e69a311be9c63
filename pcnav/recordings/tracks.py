"""Tracks of feature points seen by a stereo rig: what the feature estimators consume."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from pcnav.core.arrays import FloatArray, IntArray
from pcnav.core.stereo import StereoRig
from pcnav.dynamics.kepler import KeplerOrbit
from pcnav.recordings.recording import RecordingKind


@dataclass(frozen=True)
class TrackFrame:
    """The features seen at one time; none in a blackout."""

    time_s: float
    R_rig_world: FloatArray
    """(3, 3) attitude of the rig, which sits at the chaser's mass centre."""
    features: IntArray
    """(n,) numbers of the features seen, each at most once."""
    pixels: FloatArray
    """(n, 4) u_left, v_left, u_right, v_right."""


@dataclass(frozen=True)
class Tracks:
    """A recording."""

    kind: ClassVar[RecordingKind] = RecordingKind.STEREO_TRACKS

    name: str
    rig: StereoRig
    orbit: KeplerOrbit
    frames: tuple[TrackFrame, ...]
    """In order of time."""
    path: Path | None = None
    """The folder it is read from."""

    def __len__(self) -> int:
        return len(self.frames)

    def __iter__(self) -> Iterator[TrackFrame]:
        return iter(self.frames)
