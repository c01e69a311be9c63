"""Tracks of feature points, seen by one camera or by a stereo rig, and the table they stand in.

tracks.csv    time_s, feature and pixels: rows in order of time; a time without features is one
              row whose other fields are empty
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np

from pcnav.core.arrays import FloatArray, IntArray
from pcnav.core.camera import PinholeCamera
from pcnav.core.errors import InputError
from pcnav.core.stereo import StereoRig
from pcnav.dynamics.kepler import KeplerOrbit
from pcnav.files.csv_table import CsvTable, write_csv
from pcnav.recordings.recording import RecordingKind

TRACKS_FILE = "tracks.csv"


@dataclass(frozen=True)
class TrackFrame:
    """The features seen at one time; none in a blackout."""

    time_s: float
    R_cam_world: FloatArray
    """(3, 3) attitude of the camera, of a rig its left one, as the chaser knows it; it sits at the
    chaser's mass centre."""
    features: IntArray
    """(n,) numbers of the features seen, each at most once."""
    pixels: FloatArray
    """(n, 2) u, v, or of a rig (n, 4) u_left, v_left, u_right, v_right."""


@dataclass(frozen=True)
class StereoTracks:
    """A recording of a stereo rig."""

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


@dataclass(frozen=True)
class MonocularTracks:
    """A recording of one camera."""

    kind: ClassVar[RecordingKind] = RecordingKind.IMAGES

    name: str
    camera: PinholeCamera
    pixel_sigma_px: float
    """Standard deviation of each tracked coordinate."""
    frames: tuple[TrackFrame, ...]
    """In order of time."""
    path: Path | None = None
    """The folder it is read from."""

    def __len__(self) -> int:
        return len(self.frames)

    def __iter__(self) -> Iterator[TrackFrame]:
        return iter(self.frames)


def tracks_folder(path: Path) -> Path | None:
    """The folder of tracks given by itself or by its tracks.csv; None where there is none."""
    if path.is_file() and path.name == TRACKS_FILE:
        return path.parent
    return path if (path / TRACKS_FILE).is_file() else None


def attitudes_of(frames: Iterable[TrackFrame]) -> tuple[FloatArray, FloatArray]:
    """(n,) times, s, and (n, 3, 3) R_cam_world of frames."""
    seen = list(frames)
    times_s = np.array([frame.time_s for frame in seen])
    return times_s, np.reshape([frame.R_cam_world for frame in seen], (-1, 3, 3))


def write_track_table(folder: Path, columns: tuple[str, ...], frames: Iterable[TrackFrame]) -> None:
    """Write tracks.csv of frames in order; ``columns`` are time_s, feature and the pixels'."""
    write_csv(folder / TRACKS_FILE, columns, _rows(frames, len(columns)))


def frames_of(
    table: CsvTable, columns: tuple[str, ...]
) -> tuple[FloatArray, list[tuple[IntArray, FloatArray]]]:
    """(n,) times and the features (m,) and pixels (m, k) of each, from checked rows.

    Raises `InputError`, which names the line, for numbers that are not finite, times out of order
    and a feature twice at a time.
    """
    time_s = table.times()
    table.require_any()
    numbers, pixels = table.numbers(columns[1:2])[:, 0], table.numbers(columns[2:])
    empty = np.isnan(numbers) & np.isnan(pixels).all(axis=1)
    whole = empty | ((numbers >= 0.0) & (numbers == np.rint(numbers)) & (numbers < 2.0**53))
    later = np.diff(time_s, prepend=-np.inf) >= 0.0
    table.require(later, "expected times in order, this one is before the last", "time_s")
    table.require(whole, "expected a whole number from 0 on", "feature")
    for k, name in enumerate(columns[2:]):
        table.require(empty | np.isfinite(pixels[:, k]), "expected a finite number", name)
    features = np.where(empty, -1, np.where(empty, 0.0, numbers)).astype(np.intp)
    _refuse_repeated(table.path, time_s, features)
    # A row begins a frame when its time differs from the one before.
    starts = np.flatnonzero(np.diff(time_s, prepend=np.nan) != 0.0).tolist()
    ends = [*starts[1:], len(time_s)]
    rows = [
        slice(start, start if features[start] < 0 else end)
        for start, end in zip(starts, ends, strict=True)
    ]
    return time_s[starts], [(features[each], pixels[each]) for each in rows]


def _rows(frames: Iterable[TrackFrame], width: int) -> Iterator[list[object]]:
    for frame in frames:
        if not len(frame.features):
            yield [frame.time_s, *[""] * (width - 1)]
        pairs = zip(frame.features.tolist(), frame.pixels.tolist(), strict=True)
        yield from ([frame.time_s, feature, *pixels] for feature, pixels in pairs)


def _refuse_repeated(path: Path, time_s: FloatArray, features: IntArray) -> None:
    """Each feature at most once at a time, and nothing beside the row of a time without any."""
    order = np.lexsort((features, time_s))
    same_time = np.diff(time_s[order]) == 0.0
    twice = same_time & (np.diff(features[order]) == 0)
    beside_none = same_time & (features[order][:-1] < 0)
    for wrong in (twice, beside_none):
        if wrong.any():
            # Rows of a pair come in the file's order; the later one is at fault.
            row = int(order[1:][wrong].min())
            number = features[row]
            expected = "expected no other row at a time without features"
            if wrong is twice and number >= 0:
                expected = f"expected each feature once at a time, {number} is repeated"
            raise InputError(path, f"line {row + 2}, feature", f"{expected} ({time_s[row]:g} s)")
