"""Poses of a camera over time, as TUM files and trees of transforms have them; between them, too.

A line of a file: timestamp tx ty tz qx qy qz qw, the camera in the world (T_world_cam), m.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from pcnav.core.arrays import FloatArray
from pcnav.core.errors import InputError
from pcnav.core.spatial import invert_transform, make_transform
from pcnav.files.regular_file import require_regular

_FIELDS = "timestamp tx ty tz qx qy qz qw"
_MAX_BYTES = 500_000_000
"""Of a table of poses: some millions of them."""
_NORM_TOLERANCE = 1e-2
_MAX_GAP_STEPS = 5.0
"""Between poses so many times further apart than usual none is taken to be known."""


@dataclass(frozen=True)
class TimedPoses:
    """Poses in order of time."""

    time_s: FloatArray
    """(n,) increasing."""
    T: FloatArray
    """(n, 4, 4)"""


def read_timed_poses(path: Path) -> TimedPoses:
    """Raises `InputError` for a file that is none, or empty."""
    rows = _numbers(path)
    norm = np.linalg.norm(rows[:, 4:], axis=1)
    good = np.isfinite(rows).all(axis=1) & (np.abs(norm - 1.0) < _NORM_TOLERANCE)
    if not good.all():
        expected = f"expected {_FIELDS} with a unit quaternion"
        raise InputError(path, f"pose {int(np.argmin(good)) + 1}", expected)
    rows = rows[np.unique(rows[:, 0], return_index=True)[1]]
    R = Rotation.from_quat(rows[:, 4:]).as_matrix()
    return TimedPoses(rows[:, 0], make_transform(R, rows[:, 1:4]))


def poses_at(poses: TimedPoses, time_s: FloatArray) -> FloatArray:
    """(m, 4, 4) inverses of the poses at times (m,): T_cam_world of T_world_cam.

    Between two poses the path is straight and the turn uniform; nan before the first, after the
    last and in gaps.
    """
    return invert_transform(interpolated(poses, time_s))


def interpolated(poses: TimedPoses, time_s: FloatArray) -> FloatArray:
    """(m, 4, 4) poses at times (m,), nan where none is near."""
    stamps, T = poses.time_s, poses.T
    found = np.full((len(time_s), 4, 4), np.nan)
    exact = stamps[np.searchsorted(stamps, time_s).clip(0, len(stamps) - 1)] == time_s
    rows = np.searchsorted(stamps, time_s).clip(0, len(stamps) - 1)
    found[exact] = T[rows[exact]]
    if len(stamps) < 2:
        return found
    steps = np.diff(stamps)
    after = np.searchsorted(stamps, time_s, side="right").clip(1, len(stamps) - 1)
    gap = steps[after - 1] > _MAX_GAP_STEPS * np.median(steps)
    between = (time_s > stamps[0]) & (time_s < stamps[-1]) & ~exact & ~gap
    asked = time_s[between]
    if asked.size:
        R = Slerp(stamps, Rotation.from_matrix(T[:, :3, :3]))(asked).as_matrix()
        p = np.column_stack([np.interp(asked, stamps, T[:, k, 3]) for k in range(3)])
        found[between] = make_transform(R, p)
    return found


def _numbers(path: Path) -> FloatArray:
    """(n, 8)"""
    rows = []
    require_regular(path, _MAX_BYTES)
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(path, "file", f"expected a readable text ({error})") from error
    for number, line in enumerate(lines, start=1):
        words = line.split("#")[0].replace(",", " ").split()
        if not words:
            continue
        try:
            row = [float(word) for word in words]
        except ValueError as error:
            raise InputError(path, f"line {number}", f"expected {_FIELDS}") from error
        if len(row) != len(_FIELDS.split()):
            raise InputError(path, f"line {number}", f"expected {_FIELDS}")
        rows.append(row)
    if not rows:
        raise InputError(path, "poses", f"expected at least one line {_FIELDS}")
    return np.array(rows)
