"""Attitudes of a target over time, as another instrument or another run found them.

attitudes.csv   time_s, q_x, q_y, q_z, q_w of R_world_body, one row per time, in order; a time
                without an attitude has the q fields empty. Optional: sd_theta_x_rad,
                sd_theta_y_rad, sd_theta_z_rad, about the body axes
truth.csv       optional truth beside it

The states.csv of any result folder has these columns, so it is a recording of attitudes, too.
"""

import csv
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar, NamedTuple

import numpy as np

from pcnav.core.arrays import BoolArray, FloatArray
from pcnav.core.errors import InputError
from pcnav.core.spatial import rotation_from_xyzw, xyzw_from_rotation
from pcnav.files.csv_table import read_csv
from pcnav.recordings.recording import RecordingKind

ATTITUDES_FILE = "attitudes.csv"
ATTITUDES_COLUMNS = ("time_s", "q_x", "q_y", "q_z", "q_w")
SD_COLUMNS = ("sd_theta_x_rad", "sd_theta_y_rad", "sd_theta_z_rad")
_NORM_TOLERANCE = 1e-6


class MeasuredAttitude(NamedTuple):
    """What is known at one time."""

    time_s: float
    R_world_body: FloatArray | None
    """(3, 3); None where there is no attitude."""
    covariance: FloatArray | None
    """(3, 3) about the body axes, rad^2; None where the recording does not state it."""


@dataclass(frozen=True)
class AttitudeRecording:
    """Attitudes over time."""

    kind: ClassVar[RecordingKind] = RecordingKind.ATTITUDES

    name: str
    path: Path | None
    """The table, or the folder of it."""
    times_s: FloatArray
    """(n,) increasing."""
    R_world_body: FloatArray
    """(n, 3, 3), nan where there is no attitude."""
    sd: FloatArray | None
    """(n, 3) about the body axes, rad; None where the file does not state them."""

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
    stated = _has_deviations(file)
    table = read_csv(file, ATTITUDES_COLUMNS + (SD_COLUMNS if stated else ()))
    times_s, xyzw = table.times(), table.numbers(ATTITUDES_COLUMNS[1:])
    table.require_any()
    known = np.asarray(np.isfinite(xyzw).all(axis=1))
    empty = np.asarray(np.isnan(xyzw).all(axis=1))
    table.require(np.diff(times_s, prepend=-np.inf) > 0.0, "expected times in order", "time_s")
    table.require(known | empty, "expected all four or none", "q_x to q_w")
    length = np.where(known, np.linalg.norm(np.where(known[:, None], xyzw, 1.0), axis=1), 1.0)
    unit = np.abs(length - 1.0) < _NORM_TOLERANCE
    table.require(unit | ~known, "expected a unit quaternion", "q_x to q_w")
    R = np.full((len(times_s), 3, 3), np.nan)
    if known.any():
        R[known] = rotation_from_xyzw(xyzw[known])
    sd = table.numbers(SD_COLUMNS) if stated else None
    if sd is not None:
        good = np.asarray(np.isfinite(sd).all(axis=1) & (sd >= 0.0).all(axis=1))
        table.require(good | ~known, "expected standard deviations", "sd_theta")
    return AttitudeRecording(file.parent.resolve().name, path, times_s, R, sd)


def write_attitudes(folder: Path, times_s: FloatArray, R_world_body: FloatArray) -> None:
    """Write attitudes.csv of times (n,) and attitudes (n, 3, 3) into a folder."""
    rows = np.column_stack([times_s, xyzw_from_rotation(R_world_body)])
    with (folder / ATTITUDES_FILE).open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(ATTITUDES_COLUMNS)
        writer.writerows(rows.tolist())


def _has_deviations(file: Path) -> bool:
    try:
        with file.open(encoding="utf-8", newline="") as stream:
            header = next(csv.reader(stream), [])
    except OSError as error:
        raise InputError(file, "file", f"expected a readable file ({error.strerror})") from error
    except (UnicodeDecodeError, csv.Error) as error:
        raise InputError(file, "file", f"expected CSV text ({error})") from error
    return all(name in header for name in SD_COLUMNS)
