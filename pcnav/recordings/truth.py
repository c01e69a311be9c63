"""The truth stored beside a sequence; nothing in perception or estimation reads it."""

from pathlib import Path

import numpy as np

from pcnav.core.arrays import FloatArray
from pcnav.core.errors import InputError
from pcnav.core.spatial import rotation_from_xyzw
from pcnav.dynamics.blocks import ATTITUDE, FILE_ORDER, MASS_CENTRE_LAYOUT, POSE_LAYOUT
from pcnav.dynamics.trajectory import Trajectory
from pcnav.recordings.bop_scene import (
    SCENE_CAMERA_FILE,
    SCENE_GT_FILE,
    read_scene_camera,
    read_scene_poses,
)
from pcnav.recordings.state_table import STATE_COLUMNS
from pcnav.recordings.writer import TRUTH_FILE

_QUATERNION = slice(7, 11)
_NORM_TOLERANCE = 1e-6
_TIME_TOLERANCE_S = 1e-9


def read_truth(path: Path) -> Trajectory | None:
    """Truth of a sequence folder, or None when it has neither truth.csv nor scene_gt.json.

    Raises `InputError` when a file is invalid or the two do not speak of the same times.
    """
    has_states = (path / TRUTH_FILE).is_file()
    if not (path / SCENE_GT_FILE).is_file():
        return _states(path / TRUTH_FILE, None) if has_states else None
    scene = read_scene_camera(path / SCENE_CAMERA_FILE)
    numbers, T_cam_model = read_scene_poses(path / SCENE_GT_FILE)
    known = np.isin(numbers, scene.numbers)
    if not known.all():
        expected = f"expected only frames of {SCENE_CAMERA_FILE}"
        raise InputError(path / SCENE_GT_FILE, str(numbers[int(np.argmin(known))]), expected)
    time_s = scene.time_s[np.searchsorted(scene.numbers, numbers)]
    if not has_states:
        return Trajectory(time_s, POSE_LAYOUT, T_cam_target=T_cam_model)
    truth = _states(path / TRUTH_FILE, T_cam_model)
    same = len(truth.time_s) == len(time_s) and np.allclose(
        truth.time_s, time_s, rtol=0.0, atol=_TIME_TOLERANCE_S
    )
    if not same:
        expected = f"expected the times of the frames in {SCENE_GT_FILE}"
        raise InputError(path / TRUTH_FILE, "time_s", expected)
    return truth


def _states(path: Path, T_cam_model: FloatArray | None) -> Trajectory:
    """All blocks of truth.csv; the pose is of the model frame."""
    rows, values = _rows(path), {}
    for block in FILE_ORDER:
        first = STATE_COLUMNS.index(block.columns[0])
        values[block.name] = rows[:, first : first + len(block.columns)]
    values[ATTITUDE.name] = rotation_from_xyzw(values[ATTITUDE.name])
    return Trajectory(rows[:, 0], MASS_CENTRE_LAYOUT, values, T_cam_target=T_cam_model)


def _rows(path: Path) -> FloatArray:
    """(n, 22) checked numbers of truth.csv."""
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(path, "file", f"expected a readable text file ({error})") from error
    if not lines or tuple(lines[0].split(",")) != STATE_COLUMNS:
        raise InputError(path, "header", f"expected the columns {','.join(STATE_COLUMNS)}")
    rows = np.empty((len(lines) - 1, len(STATE_COLUMNS)))
    for k, line in enumerate(lines[1:]):
        try:
            rows[k] = [float(word) for word in line.split(",")]
        except ValueError as error:
            expected = f"expected {len(STATE_COLUMNS)} numbers"
            raise InputError(path, f"line {k + 2}", expected) from error
    finite = np.isfinite(rows).all(axis=1)
    unit = np.abs(np.linalg.norm(rows[:, _QUATERNION], axis=1) - 1.0) <= _NORM_TOLERANCE
    later = np.diff(rows[:, 0], prepend=-np.inf) > 0.0
    for good, expected in (
        (finite, "expected finite numbers"),
        (unit, "expected a unit quaternion in q_x to q_w"),
        (later, "expected times that increase"),
    ):
        if not good.all():
            raise InputError(path, f"line {int(np.argmin(good)) + 2}", expected)
    if len(rows) == 0:
        raise InputError(path, "rows", "expected at least one row")
    return rows
