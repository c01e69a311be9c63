"""Attitudes over time: of a target, which are a recording, and of the camera beside a recording.

attitudes.csv          time_s, q_x, q_y, q_z, q_w of R_world_body, one row per time, in order; a
                       time without an attitude has the q fields empty. Optional: sd_theta_x_rad,
                       sd_theta_y_rad, sd_theta_z_rad, about the body axes
camera_attitude.csv    the same columns, of R_world_cam, as the chaser knows it

The states.csv of any result folder has the columns of attitudes.csv, so it is a recording, too.
"""

import logging
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from pcnav.core.arrays import BoolArray, FloatArray
from pcnav.core.errors import InputError
from pcnav.core.spatial import rotation_from_xyzw, xyzw_from_rotation
from pcnav.dynamics.blocks import ATTITUDE
from pcnav.dynamics.trajectory import Trajectory
from pcnav.files.csv_table import CsvTable, read_csv, read_header, write_csv
from pcnav.files.new_folder import new_folder
from pcnav.recordings.recording import RecordingKind
from pcnav.recordings.truth import write_truth

ATTITUDES_FILE = "attitudes.csv"
CAMERA_ATTITUDE_FILE = "camera_attitude.csv"

_OLD_CAMERA_ATTITUDE_FILE = "attitude.csv"
"""What it was called up to release 0.1."""
_COLUMNS = ("time_s", *ATTITUDE.columns)
_NORM_TOLERANCE = 1e-6
_TIME_TOLERANCE_S = 1e-9
_LOG = logging.getLogger("pcnav")


class MeasuredAttitude(NamedTuple):
    """What is known at one time."""

    time_s: float
    R_world_body: FloatArray | None
    """(3, 3); None where there is no attitude."""
    covariance: FloatArray | None
    """(3, 3) about the body axes, rad^2; None where the recording does not state it."""


@dataclass(frozen=True)
class AttitudeRecording:
    """Attitudes of a target, as another instrument or another run found them."""

    kind: ClassVar[RecordingKind] = RecordingKind.ATTITUDES

    name: str
    times_s: FloatArray
    """(n,) increasing."""
    R_world_body: FloatArray
    """(n, 3, 3), nan where there is no attitude."""
    sd: FloatArray | None = None
    """(n, 3) about the body axes, rad; None where the file does not state them."""
    path: Path | None = None
    """The table, or the folder of it."""

    @property
    def has_attitude(self) -> BoolArray:
        """(n,)"""
        return np.asarray(np.isfinite(self.R_world_body[:, 0, 0]))

    def __len__(self) -> int:
        return len(self.times_s)

    def __iter__(self) -> Iterator[MeasuredAttitude]:
        for k, known in enumerate(self.has_attitude.tolist()):
            sd = None if self.sd is None else self.sd[k]
            covariance = None if sd is None or not sd.any() else np.diag(sd**2)
            attitude = self.R_world_body[k] if known else None
            yield MeasuredAttitude(float(self.times_s[k]), attitude, covariance if known else None)


def is_attitude_recording(path: Path) -> bool:
    """Whether a path is a table, or a folder with a table, that `read_attitudes` takes."""
    return path.suffix == ".csv" or (path / ATTITUDES_FILE).is_file()


def read_attitudes(path: Path) -> AttitudeRecording:
    """A recording: its file, or the folder of it. Raises `InputError`."""
    file = path / ATTITUDES_FILE if path.is_dir() else path
    header, names = read_header(file), ATTITUDE.sd_columns
    sd_names = names if all(name in header for name in names) else ()
    table = read_csv(file, (*_COLUMNS, *sd_names))
    times_s, R, known = _attitudes(table)
    sd = table.numbers(sd_names) if sd_names else None
    if sd is not None:
        good = np.asarray(np.isfinite(sd).all(axis=1) & (sd >= 0.0).all(axis=1))
        table.require(good | ~known, "expected standard deviations", "sd_theta")
    return AttitudeRecording(file.parent.resolve().name, times_s, R, sd, path)


def write_attitudes(
    out: Path,
    recording: AttitudeRecording,
    truth: Trajectory | None = None,
    overwrite: bool = False,
) -> None:
    """Write a recording but for its deviations; the folder appears, whole, at the end.

    Raises `InputError` for a folder that must not be replaced.
    """
    with new_folder(out, overwrite, ATTITUDES_FILE) as folder:
        _write(folder / ATTITUDES_FILE, recording.times_s, recording.R_world_body)
        write_truth(folder, truth)


def has_camera_attitudes(folder: Path) -> bool:
    """Whether a folder tells where its camera looks."""
    return _camera_file(folder) is not None


def read_camera_attitudes(folder: Path, times_s: FloatArray) -> FloatArray:
    """(n, 3, 3) R_cam_world at times, at constant rate between those of the folder's file.

    Without the file the camera is at rest. Raises `InputError`, which names the line, for what is
    no attitude and times that are not covered.
    """
    path = _camera_file(folder)
    if path is None:
        return np.broadcast_to(np.eye(3), (len(times_s), 3, 3))
    if path.name == _OLD_CAMERA_ATTITUDE_FILE:
        warning = "%s is called %s now; the old name is read for one release"
        _LOG.warning(warning, path, CAMERA_ATTITUDE_FILE)
    table = read_csv(path, _COLUMNS)
    recorded, _, known = _attitudes(table)
    table.require(known, "expected a unit quaternion in q_x to q_w")
    before = times_s[0] < recorded[0] - _TIME_TOLERANCE_S
    if before or times_s[-1] > recorded[-1] + _TIME_TOLERANCE_S:
        expected = f"expected times that cover the frames, {times_s[0]:g} to {times_s[-1]:g} s"
        raise InputError(path, "time_s", expected)
    R_world_cam = Rotation.from_quat(table.numbers(ATTITUDE.columns))
    if len(recorded) > 1:
        R_world_cam = Slerp(recorded, R_world_cam)(np.clip(times_s, recorded[0], recorded[-1]))
    matrices = np.asarray(R_world_cam.as_matrix(), dtype=np.float64)
    return np.broadcast_to(np.swapaxes(matrices, 1, 2), (len(times_s), 3, 3))


def write_camera_attitudes(folder: Path, times_s: FloatArray, R_cam_world: FloatArray) -> None:
    """Write camera_attitude.csv of times (n,) and attitudes (n, 3, 3)."""
    _write(folder / CAMERA_ATTITUDE_FILE, times_s, np.swapaxes(R_cam_world, 1, 2))


def _camera_file(folder: Path) -> Path | None:
    places = (folder / CAMERA_ATTITUDE_FILE, folder / _OLD_CAMERA_ATTITUDE_FILE)
    return next((path for path in places if path.is_file()), None)


def _attitudes(table: CsvTable) -> tuple[FloatArray, FloatArray, BoolArray]:
    """(n,) checked times, (n, 3, 3) attitudes, nan where the fields are empty, and whether not."""
    times_s, xyzw = table.times(), table.numbers(ATTITUDE.columns)
    table.require_any()
    known = np.asarray(np.isfinite(xyzw).all(axis=1))
    empty = np.asarray(np.isnan(xyzw).all(axis=1))
    table.require(np.diff(times_s, prepend=-np.inf) > 0.0, "expected times that increase", "time_s")
    table.require(known | empty, "expected all four or none", "q_x to q_w")
    length = np.where(known, np.linalg.norm(np.where(known[:, None], xyzw, 1.0), axis=1), 1.0)
    unit = np.abs(length - 1.0) <= _NORM_TOLERANCE
    table.require(unit, "expected a unit quaternion", "q_x to q_w")
    R = np.full((len(times_s), 3, 3), np.nan)
    if known.any():
        R[known] = rotation_from_xyzw(xyzw[known])
    return times_s, R, known


def _write(path: Path, times_s: FloatArray, R: FloatArray) -> None:
    write_csv(path, _COLUMNS, np.column_stack([times_s, xyzw_from_rotation(R)]).tolist())
