"""The pose in the first frame: as a prior, and as command lines and files state it."""

import json
import math
from pathlib import Path
from typing import Any

import numpy as np

from pcnav.config.first_pose import FirstPoseTable
from pcnav.core.arrays import FloatArray
from pcnav.core.errors import InputError
from pcnav.core.spatial import make_transform, rotation_from_xyzw, xyzw_from_rotation
from pcnav.files.regular_file import read_bytes
from pcnav.files.toml_file import checked
from pcnav.recordings.bop_scene import read_scene_poses
from pcnav.recordings.frame_checks import checked_transform
from pcnav.recordings.sequence import FirstPosePrior

POSITION_SD_SHARE = 0.02
"""Of the distance from the camera, where no deviation of the position is stated."""
ATTITUDE_SD_DEG = 5.0
"""Where none of the attitude is stated."""
_MAX_BYTES = 100_000
_NUMBERS = "tx ty tz qx qy qz qw"


def prior_of(table: FirstPoseTable | None) -> FirstPosePrior | None:
    """What a table says; None where it holds no pose."""
    if table is None or table.position_cam_m is None or table.quaternion_cam_model_xyzw is None:
        return None
    quaternion = np.array(table.quaternion_cam_model_xyzw)
    R = rotation_from_xyzw(quaternion / np.linalg.norm(quaternion))
    p_m = np.array(table.position_cam_m)
    position_sd_m = table.position_sd_m or POSITION_SD_SHARE * float(np.linalg.norm(p_m))
    attitude_sd_deg = table.attitude_sd_deg or ATTITUDE_SD_DEG
    # A target about the camera's own origin has no distance: any deviation but none will do.
    return FirstPosePrior(
        make_transform(R, p_m), position_sd_m or POSITION_SD_SHARE, math.radians(attitude_sd_deg)
    )


def table_of(prior: FirstPosePrior) -> FirstPoseTable:
    """A first pose as files state it."""
    return FirstPoseTable(
        position_cam_m=tuple(prior.T_cam_model[:3, 3].tolist()),
        quaternion_cam_model_xyzw=tuple(xyzw_from_rotation(prior.T_cam_model[:3, :3]).tolist()),
        position_sd_m=prior.position_sd_m,
        attitude_sd_deg=math.degrees(prior.attitude_sd_rad),
    )


def first_pose_table(
    T_cam_model: FloatArray, sd: tuple[float, float] | None = None
) -> FirstPoseTable:
    """A first pose (4, 4) as a program states it; ``sd`` as in `parsed_first_pose`.

    Raises `InputError` for what is no pose.
    """
    T = checked_transform("Tracker", "initial_pose", T_cam_model)
    found: dict[str, Any] = {
        "position_cam_m": T[:3, 3].tolist(),
        "quaternion_cam_model_xyzw": xyzw_from_rotation(T[:3, :3]).tolist(),
    }
    if sd is not None:
        found |= {"position_sd_m": sd[0], "attitude_sd_deg": sd[1]}
    return checked("Tracker", FirstPoseTable, found, "initial_pose_sd")


def parsed_first_pose(text: str, sd: tuple[float, float] | None = None) -> FirstPoseTable:
    """A first pose as a command line states it.

    Args:
        text: seven numbers, position in m and quaternion (scalar last) of T_cam_model, or the path
            of a file with them: a TUM file of one pose, or JSON with the keys of `FirstPoseTable`
            or a BOP scene_gt.json of one frame.
        sd: deviations of the position, m, and of the attitude, deg; they replace those of a file.

    Raises `InputError`.
    """
    values, source = _numbers(text), Path("--initial-pose")
    if values is None:
        source = Path(text)
        found = _from_file(source)
    else:
        found = _from_numbers(values, source)
    if sd is not None:
        found |= {"position_sd_m": sd[0], "attitude_sd_deg": sd[1]}
    table = checked(source, FirstPoseTable, found)
    if table.position_cam_m is None:
        raise InputError(source, "position_cam_m", "expected a pose")
    return table


def _numbers(text: str) -> list[float] | None:
    """Numbers between blanks or commas; None for any other text."""
    try:
        return [float(word) for word in text.replace(",", " ").split()]
    except ValueError:
        return None


def _from_numbers(values: list[float], source: Path) -> dict[str, Any]:
    if len(values) != 7:
        expected = f"expected the numbers {_NUMBERS} of T_cam_model, got {len(values)}"
        raise InputError(source, "pose", expected)
    return {"position_cam_m": values[:3], "quaternion_cam_model_xyzw": values[3:]}


def _from_file(path: Path) -> dict[str, Any]:
    if not path.is_file():
        expected = f"expected the numbers {_NUMBERS} of T_cam_model, or a file with them"
        raise InputError(path, "file", expected)
    try:
        text = read_bytes(path, _MAX_BYTES).decode("utf-8")
    except InputError:
        raise
    except ValueError as error:
        raise InputError(path, "file", "expected a text file of one pose") from error
    if text.lstrip().startswith(("{", "[")):
        return _from_json(path, text)
    lines = [line for line in text.splitlines() if line.strip() and not line.startswith("#")]
    if len(lines) != 1:
        raise InputError(path, "lines", f"expected one pose, got {len(lines)} lines")
    values = _numbers(lines[0]) or []
    # A TUM line begins with its time, which is that of the first frame whatever it says.
    return _from_numbers(values[1:] if len(values) == 8 else values, path)


def _from_json(path: Path, text: str) -> dict[str, Any]:
    try:
        found = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise InputError(path, "file", "expected valid JSON") from error
    if not isinstance(found, dict):
        raise InputError(path, "file", "expected the keys of a first pose")
    if not all(key.isdecimal() for key in found):
        return found
    # A scene_gt.json, cut down to one frame.
    _, poses = read_scene_poses(path)
    if len(poses) != 1:
        raise InputError(path, "frames", f"expected one pose, got {len(poses)}")
    return {
        "position_cam_m": poses[0, :3, 3].tolist(),
        "quaternion_cam_model_xyzw": xyzw_from_rotation(poses[0, :3, :3]).tolist(),
    }
