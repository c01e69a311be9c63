"""attitude.csv beside tracks: where the camera or rig looks, as the chaser knows it."""

import csv
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from pcnav.core.arrays import FloatArray
from pcnav.core.errors import InputError
from pcnav.core.spatial import xyzw_from_rotation
from pcnav.files.csv_table import read_csv

ATTITUDE_FILE = "attitude.csv"

_COLUMNS = ("time_s", "q_x", "q_y", "q_z", "q_w")
_NORM_TOLERANCE = 1e-6
_TIME_TOLERANCE_S = 1e-9


def write_attitude_file(path: Path, times_s: FloatArray, R_sensor_world: FloatArray) -> None:
    """Of attitudes (n, 3, 3); the file holds those of the sensor, its rotation into the world."""
    quaternions = xyzw_from_rotation(np.swapaxes(R_sensor_world, 1, 2))
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(_COLUMNS)
        writer.writerows(np.column_stack([times_s, quaternions]).tolist())


def read_attitude_file(path: Path, times_s: FloatArray) -> FloatArray:
    """(n, 3, 3) R_sensor_world at times, at constant rate between those of the file.

    Raises `InputError`, which names the line, for what is no attitude and times that are not
    covered.
    """
    table = read_csv(path, _COLUMNS)
    recorded, quaternions = table.times(), table.numbers(_COLUMNS[1:])
    table.require_any()
    table.require(np.diff(recorded, prepend=-np.inf) > 0.0, "expected times that increase")
    with np.errstate(invalid="ignore"):
        unit = np.abs(np.linalg.norm(quaternions, axis=1) - 1.0) <= _NORM_TOLERANCE
    table.require(unit, "expected a unit quaternion in q_x to q_w")
    before = times_s[0] < recorded[0] - _TIME_TOLERANCE_S
    if before or times_s[-1] > recorded[-1] + _TIME_TOLERANCE_S:
        expected = f"expected times that cover the frames, {times_s[0]:g} to {times_s[-1]:g} s"
        raise InputError(path, "time_s", expected)
    R_world_sensor = Rotation.from_quat(quaternions)
    if len(recorded) > 1:
        within = np.clip(times_s, recorded[0], recorded[-1])
        R_world_sensor = Slerp(recorded, R_world_sensor)(within)
    matrices = np.asarray(R_world_sensor.as_matrix(), dtype=np.float64)
    return np.broadcast_to(np.swapaxes(matrices, 1, 2), (len(times_s), 3, 3))
