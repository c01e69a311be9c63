"""A recording of feature tracks as a folder: tracks.csv, rig.toml, the rig's attitude, the truth.

tracks.csv          time_s, feature, u_left, v_left, u_right, v_right: rows in order of time; a
                    time without features is one row whose other fields are empty
rig.toml            [rig], [orbit] and, for a rig fixed in Hill axes, [pointing]
attitude.csv        optional: time_s, q_x, q_y, q_z, q_w of R_world_rig; replaces [pointing]
truth.csv           optional, as of a depth sequence
truth_features.csv  optional: feature, x_m, y_m, z_m in the true body axes from the mass centre
"""

import csv
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from pcnav.arrays import BoolArray, FloatArray, IntArray
from pcnav.camera import R_cam_hill
from pcnav.csv_table import CsvTable, read_csv
from pcnav.dynamics.kepler import KeplerOrbit
from pcnav.errors import InputError
from pcnav.new_folder import new_folder
from pcnav.sequences.rig_file import RIG_FILE, read_rig_file, write_rig_file
from pcnav.sequences.tracks import TrackFrame, Tracks
from pcnav.sequences.writer import TRUTH_FILE
from pcnav.spatial import xyzw_from_rotation
from pcnav.state import NavigationState
from pcnav.state_table import STATE_COLUMNS, state_row

TRACKS_FILE = "tracks.csv"
ATTITUDE_FILE = "attitude.csv"
TRUTH_FEATURES_FILE = "truth_features.csv"

TRACK_COLUMNS = ("time_s", "feature", "u_left", "v_left", "u_right", "v_right")
ATTITUDE_COLUMNS = ("time_s", "q_x", "q_y", "q_z", "q_w")
POINT_COLUMNS = ("feature", "x_m", "y_m", "z_m")

_NORM_TOLERANCE = 1e-6
_TIME_TOLERANCE_S = 1e-9


def is_track_recording(path: Path) -> bool:
    """Whether a path is a folder with tracks.csv, or that file."""
    return _folder(path) is not None


def recording_folder(path: Path) -> Path:
    """The folder of a recording given by its folder or its tracks.csv. Raises `InputError`."""
    folder = _folder(path)
    if folder is None:
        raise InputError(path, "folder", f"expected a folder with {TRACKS_FILE}, or that file")
    return folder


def read_tracks(path: Path) -> Tracks:
    """Read a recording from its folder or its tracks.csv.

    Raises `InputError`, which names the file and line, for missing files and columns, numbers that
    are not finite, times out of order, a feature twice at a time, disparities that are not
    positive and a rig without attitude.
    """
    folder = recording_folder(path)
    rig, orbit, boresight = read_rig_file(folder / RIG_FILE)
    table = read_csv(folder / TRACKS_FILE, TRACK_COLUMNS)
    time_s, features, pixels = _checked(table)
    # A row begins a frame when its time differs from the one before.
    starts = np.flatnonzero(np.diff(time_s, prepend=np.nan) != 0.0)
    attitudes = _attitudes(folder, orbit, boresight, time_s[starts])
    frames = []
    for start, end, R in zip(starts, [*starts[1:], len(time_s)], attitudes, strict=True):
        rows = slice(start, start if features[start] < 0 else end)
        frames.append(TrackFrame(float(time_s[start]), R, features[rows], pixels[rows]))
    return Tracks(folder.resolve().name, rig, orbit, tuple(frames))


def read_truth_features(folder: Path) -> dict[int, FloatArray] | None:
    """True points (3,) by feature, body axes, m; None where the recording has none.

    Raises `InputError`.
    """
    path = folder / TRUTH_FEATURES_FILE
    if not path.is_file():
        return None
    table = read_csv(path, POINT_COLUMNS)
    numbers, points = table.counts("feature"), table.numbers(POINT_COLUMNS[1:])
    _require(path, np.asarray(np.isfinite(points).all(axis=1)), "expected finite numbers")
    if len(np.unique(numbers)) != len(numbers):
        raise InputError(path, "feature", "expected each feature once")
    return dict(zip(numbers.tolist(), points, strict=True))


def write_tracks(
    out: Path,
    tracks: Tracks,
    states: Sequence[NavigationState] | None = None,
    points: FloatArray | None = None,
    overwrite: bool = False,
) -> None:
    """Write a recording; the folder appears, whole, at the end.

    ``states`` is the truth at every frame and ``points`` (N, 3) the true features, numbered from
    0, where known. Raises `InputError` for a folder that must not be replaced.
    """
    with new_folder(out, overwrite, TRACKS_FILE) as folder:
        write_rig_file(folder / RIG_FILE, tracks.rig, tracks.orbit)
        with (folder / TRACKS_FILE).open("w", encoding="utf-8", newline="") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(TRACK_COLUMNS)
            for frame in tracks.frames:
                writer.writerows(_rows(frame))
        attitudes = (
            [frame.time_s, *xyzw_from_rotation(frame.R_rig_world.T).tolist()]
            for frame in tracks.frames
        )
        _write_table(folder / ATTITUDE_FILE, ATTITUDE_COLUMNS, attitudes)
        if states is not None:
            pairs = zip(tracks.frames, states, strict=True)
            rows = (state_row(frame.time_s, state).tolist() for frame, state in pairs)
            _write_table(folder / TRUTH_FILE, STATE_COLUMNS, rows)
        if points is not None:
            numbered = ([i, *point] for i, point in enumerate(points.tolist()))
            _write_table(folder / TRUTH_FEATURES_FILE, POINT_COLUMNS, numbered)


def _folder(path: Path) -> Path | None:
    if path.is_file() and path.name == TRACKS_FILE:
        return path.parent
    return path if (path / TRACKS_FILE).is_file() else None


def _rows(frame: TrackFrame) -> list[list[float | int | str]]:
    if not len(frame.features):
        return [[frame.time_s, *[""] * (len(TRACK_COLUMNS) - 1)]]
    pairs = zip(frame.features.tolist(), frame.pixels.tolist(), strict=True)
    return [[frame.time_s, feature, *pixels] for feature, pixels in pairs]


def _write_table(path: Path, columns: Sequence[str], rows: Iterable[Sequence[float]]) -> None:
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(columns)
        writer.writerows(rows)


def _checked(table: CsvTable) -> tuple[FloatArray, IntArray, FloatArray]:
    """(n,) times, (n,) features, -1 in a time without any, and (n, 4) pixels of checked rows."""
    path, time_s = table.path, table.times()
    if not len(time_s):
        raise InputError(path, "rows", "expected at least one row")
    numbers, pixels = table.numbers(("feature",))[:, 0], table.numbers(TRACK_COLUMNS[2:])
    empty = np.isnan(numbers) & np.isnan(pixels).all(axis=1)
    whole = empty | ((numbers >= 0.0) & (numbers == np.rint(numbers)) & (numbers < 2.0**53))
    later = np.diff(time_s, prepend=-np.inf) >= 0.0
    with np.errstate(invalid="ignore"):
        positive = empty | (pixels[:, 0] - pixels[:, 2] > 0.0)
    _require(path, later, "expected times in order, this one is before the last", "time_s")
    _require(path, whole, "expected a whole number from 0 on", "feature")
    for k, name in enumerate(TRACK_COLUMNS[2:]):
        _require(path, empty | np.isfinite(pixels[:, k]), "expected a finite number", name)
    _require(path, positive, "expected a positive disparity u_left - u_right", "u_right")
    features = np.where(empty, -1, np.where(empty, 0.0, numbers)).astype(np.intp)
    _refuse_repeated(path, time_s, features)
    return time_s, features, pixels


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


def _attitudes(
    folder: Path, orbit: KeplerOrbit, boresight: FloatArray | None, time_s: FloatArray
) -> FloatArray:
    """(n, 3, 3) R_rig_world at the times of the frames."""
    path = folder / ATTITUDE_FILE
    if path.is_file():
        return _recorded_attitudes(path, time_s)
    if boresight is None:
        expected = f"expected boresight_hill of a rig fixed in Hill axes, or a file {ATTITUDE_FILE}"
        raise InputError(folder / RIG_FILE, "pointing", expected)
    R_rig_hill = R_cam_hill(boresight)
    return np.stack([R_rig_hill @ orbit.R_hill_world(float(t)) for t in time_s])


def _recorded_attitudes(path: Path, time_s: FloatArray) -> FloatArray:
    """As recorded, at constant rate between the times of the file."""
    table = read_csv(path, ATTITUDE_COLUMNS)
    recorded, quaternions = table.times(), table.numbers(ATTITUDE_COLUMNS[1:])
    if not len(recorded):
        raise InputError(path, "rows", "expected at least one row")
    _require(path, np.diff(recorded, prepend=-np.inf) > 0.0, "expected times that increase")
    with np.errstate(invalid="ignore"):
        unit = np.abs(np.linalg.norm(quaternions, axis=1) - 1.0) <= _NORM_TOLERANCE
    _require(path, unit, "expected a unit quaternion in q_x to q_w")
    before = time_s[0] < recorded[0] - _TIME_TOLERANCE_S
    if before or time_s[-1] > recorded[-1] + _TIME_TOLERANCE_S:
        expected = f"expected times that cover {TRACKS_FILE}, {time_s[0]:g} to {time_s[-1]:g} s"
        raise InputError(path, "time_s", expected)
    R_world_rig = Rotation.from_quat(quaternions)
    if len(recorded) > 1:
        R_world_rig = Slerp(recorded, R_world_rig)(np.clip(time_s, recorded[0], recorded[-1]))
    return np.asarray(np.swapaxes(R_world_rig.as_matrix(), 1, 2), dtype=np.float64)


def _require(path: Path, good: BoolArray, expected: str, column: str = "") -> None:
    """Refuse the first row that is not good."""
    if not good.all():
        line = f"line {int(np.argmin(good)) + 2}"
        raise InputError(path, f"{line}, {column}" if column else line, expected)
