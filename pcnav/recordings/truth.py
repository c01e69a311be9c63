"""The truth stored beside a recording; nothing in perception or estimation reads it.

truth.csv        time_s and the columns of all blocks: position, velocity, attitude, rate, mass
                 centre, inertia ratios
scene_gt.json    of a BOP scene: poses of the model in the camera
"""

import logging
from pathlib import Path

import numpy as np

from pcnav.core.arrays import FloatArray, IntArray
from pcnav.core.errors import InputError
from pcnav.core.spatial import rotation_from_xyzw, xyzw_from_rotation
from pcnav.dynamics.blocks import ATTITUDE, FILE_ORDER, MASS_CENTRE_LAYOUT, POSE_LAYOUT
from pcnav.dynamics.trajectory import Trajectory
from pcnav.files.csv_table import read_csv, write_csv
from pcnav.recordings.bop import time_zero
from pcnav.recordings.bop_scene import (
    SCENE_CAMERA_FILE,
    SCENE_GT_FILE,
    SceneCamera,
    read_scene_camera,
    read_scene_poses,
)
from pcnav.recordings.depth_stack import is_depth_stack, read_stack_truth
from pcnav.recordings.recording import Recording, truth_folder
from pcnav.recordings.sequence import Sequence
from pcnav.recordings.time_line import time_line
from pcnav.recordings.tum_rgbd import is_tum_rgbd, read_tum_truth

TRUTH_FILE = "truth.csv"
STATE_COLUMNS = ("time_s", *MASS_CENTRE_LAYOUT.columns)
"""Names of the 22 columns in file order; q is R_world_body, scalar last."""

_NORM_TOLERANCE = 1e-6
_LOG = logging.getLogger("pcnav")
_TIME_TOLERANCE_S = 1e-9


def truth_of(recording: Recording) -> Trajectory | None:
    """Truth stored with a recording that is open, whatever its format; None without.

    Raises `InputError` for one that is invalid.
    """
    path = recording.path
    if path is None:
        return None
    if isinstance(recording, Sequence):
        zero_s = recording.info.time_zero_s
        if is_tum_rgbd(path):
            return read_tum_truth(path, zero_s)
        if is_depth_stack(path):
            return read_stack_truth(path, zero_s)
        if path.is_file():
            return None
        return read_truth(path, recording.object_id)
    return read_truth(truth_folder(path))


def read_truth(path: Path, object_id: int | None = None) -> Trajectory | None:
    """Truth of a recording's folder, or None when it has neither truth.csv nor scene_gt.json.

    ``object_id`` says which of the objects of scene_gt.json is the target. Where that is not clear
    there is no truth, which is said. Raises `InputError` when a file is invalid or the two do not
    speak of the same times.
    """
    has_states = (path / TRUTH_FILE).is_file()
    has_scene = (path / SCENE_CAMERA_FILE).is_file()
    if not (path / SCENE_GT_FILE).is_file():
        if not has_states:
            return None
        scene = read_scene_camera(path / SCENE_CAMERA_FILE) if has_scene else None
        time_s, values = _states(path / TRUTH_FILE, scene)
        zero_s = 0.0 if scene is None else time_zero(path, scene)
        return Trajectory(time_s - zero_s, MASS_CENTRE_LAYOUT, values)
    scene = read_scene_camera(path / SCENE_CAMERA_FILE)
    zero_s = time_zero(path, scene)
    numbers, T_cam_model = read_scene_poses(path / SCENE_GT_FILE, object_id)
    if not len(numbers):
        _LOG.warning(
            "%s: several objects: no truth; --object says which of them is the target",
            path / SCENE_GT_FILE,
        )
        return None
    kept = ~np.isin(numbers, scene.left_out)
    numbers, T_cam_model = numbers[kept], T_cam_model[kept]
    known = np.isin(numbers, scene.numbers)
    if not known.all():
        expected = f"expected only frames of {SCENE_CAMERA_FILE}"
        raise InputError(path / SCENE_GT_FILE, str(numbers[int(np.argmin(known))]), expected)
    stamp_s, T_cam_model = _in_order(scene, numbers, T_cam_model)
    time_s = stamp_s - zero_s
    if not has_states:
        return Trajectory(time_s, POSE_LAYOUT, T_cam_target=T_cam_model)
    stated_s, values = _states(path / TRUTH_FILE, scene)
    tolerance = _TIME_TOLERANCE_S + 4.0 * np.spacing(abs(zero_s))
    rows = np.minimum(np.searchsorted(stated_s, stamp_s - tolerance), len(stated_s) - 1)
    has_all = bool(np.all(np.abs(stated_s[rows] - stamp_s) <= tolerance))
    # A frame that repeats the stamp of another may have a time of its own here.
    if not has_all or len(stated_s) > len(stamp_s) + len(scene.left_out):
        expected = f"expected the times of the frames in {SCENE_GT_FILE}"
        raise InputError(path / TRUTH_FILE, "time_s", expected)
    values = {name: value[rows] for name, value in values.items()}
    return Trajectory(time_s, MASS_CENTRE_LAYOUT, values, T_cam_target=T_cam_model)


def write_truth(folder: Path, truth: Trajectory | None) -> None:
    """Write truth.csv of a motion that has all blocks; nothing where none is known."""
    if truth is None:
        return
    values = {**truth.values, ATTITUDE.name: xyzw_from_rotation(truth[ATTITUDE])}
    blocks = [values[block.name] for block in FILE_ORDER]
    rows = np.column_stack([truth.time_s, *blocks])
    write_csv(folder / TRUTH_FILE, STATE_COLUMNS, rows.tolist())


def _in_order(
    scene: SceneCamera, numbers: IntArray, T_cam_model: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Stamps (n,) and poses (n, 4, 4) of frames by number, in order of time."""
    by_number = np.argsort(scene.numbers)
    rows = by_number[np.searchsorted(scene.numbers, numbers, sorter=by_number)]
    in_time = np.argsort(rows)
    return scene.time_s[rows[in_time]], T_cam_model[in_time]


def _states(path: Path, scene: SceneCamera | None) -> tuple[FloatArray, dict[str, FloatArray]]:
    """Increasing stamps and all blocks of truth.csv.

    Where frames of the scene repeat a stamp, or come out of order, its rows may do so as well: they
    are treated alike.
    """
    table = read_csv(path, STATE_COLUMNS)
    table.require_any()
    rows = table.numbers(STATE_COLUMNS)
    table.require(np.asarray(np.isfinite(rows).all(axis=1)), "expected finite numbers")
    norm = np.linalg.norm(table.numbers(ATTITUDE.columns), axis=1)
    unit = np.abs(norm - 1.0) <= _NORM_TOLERANCE
    table.require(unit, "expected a unit quaternion in q_x to q_w")
    in_order = scene is None or bool(np.all(np.diff(scene.numbers) > 0))
    if in_order and (scene is None or not len(scene.left_out)):
        later = np.diff(rows[:, 0], prepend=-np.inf) > 0.0
        table.require(later, "expected times that increase")
    kept = time_line(rows[:, 0], np.arange(len(rows))).kept
    values = {block.name: table.numbers(block.columns)[kept] for block in FILE_ORDER}
    values[ATTITUDE.name] = rotation_from_xyzw(values[ATTITUDE.name])
    return rows[kept, 0], values
