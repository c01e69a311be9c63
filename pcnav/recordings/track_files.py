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

from pcnav.core.arrays import FloatArray
from pcnav.core.camera import R_cam_hill
from pcnav.core.errors import InputError
from pcnav.dynamics.kepler import KeplerOrbit
from pcnav.dynamics.state import NavigationState
from pcnav.files.csv_table import read_csv
from pcnav.files.new_folder import new_folder
from pcnav.recordings.attitude_file import ATTITUDE_FILE, read_attitude_file, write_attitude_file
from pcnav.recordings.rig_file import RIG_FILE, read_rig_file, write_rig_file
from pcnav.recordings.state_table import STATE_COLUMNS, state_row
from pcnav.recordings.track_table import checked_tracks, frame_rows, write_track_table
from pcnav.recordings.tracks import TrackFrame, Tracks
from pcnav.recordings.writer import TRUTH_FILE

TRACKS_FILE = "tracks.csv"
TRUTH_FEATURES_FILE = "truth_features.csv"

TRACK_COLUMNS = ("time_s", "feature", "u_left", "v_left", "u_right", "v_right")
POINT_COLUMNS = ("feature", "x_m", "y_m", "z_m")


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
    time_s, features, pixels = checked_tracks(table, TRACK_COLUMNS)
    with np.errstate(invalid="ignore"):
        positive = (features < 0) | (pixels[:, 0] - pixels[:, 2] > 0.0)
    table.require(positive, "expected a positive disparity u_left - u_right", "u_right")
    frames = frame_rows(time_s, features)
    times_s = np.array([time_s[rows.start] for rows in frames])
    attitudes = _attitudes(folder, orbit, boresight, times_s)
    seen = tuple(
        TrackFrame(float(t), R, features[rows], pixels[rows])
        for t, R, rows in zip(times_s, attitudes, frames, strict=True)
    )
    return Tracks(folder.resolve().name, rig, orbit, seen, folder)


def read_truth_features(folder: Path) -> dict[int, FloatArray] | None:
    """True points (3,) by feature, body axes, m; None where the recording has none.

    Raises `InputError`.
    """
    path = folder / TRUTH_FEATURES_FILE
    if not path.is_file():
        return None
    table = read_csv(path, POINT_COLUMNS)
    numbers, points = table.counts("feature"), table.numbers(POINT_COLUMNS[1:])
    table.require(np.asarray(np.isfinite(points).all(axis=1)), "expected finite numbers")
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
        frames = ((frame.time_s, frame.features, frame.pixels) for frame in tracks.frames)
        write_track_table(folder / TRACKS_FILE, TRACK_COLUMNS, frames)
        times_s = np.array([frame.time_s for frame in tracks.frames])
        R_rig_world = np.reshape([frame.R_rig_world for frame in tracks.frames], (-1, 3, 3))
        write_attitude_file(folder / ATTITUDE_FILE, times_s, R_rig_world)
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


def _write_table(path: Path, columns: Sequence[str], rows: Iterable[Sequence[float]]) -> None:
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(columns)
        writer.writerows(rows)


def _attitudes(
    folder: Path, orbit: KeplerOrbit, boresight: FloatArray | None, time_s: FloatArray
) -> FloatArray:
    """(n, 3, 3) R_rig_world at the times of the frames."""
    path = folder / ATTITUDE_FILE
    if path.is_file():
        return read_attitude_file(path, time_s)
    if boresight is None:
        expected = f"expected boresight_hill of a rig fixed in Hill axes, or a file {ATTITUDE_FILE}"
        raise InputError(folder / RIG_FILE, "pointing", expected)
    R_rig_hill = R_cam_hill(boresight)
    return np.stack([R_rig_hill @ orbit.R_hill_world(float(t)) for t in time_s])
