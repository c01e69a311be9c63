"""Recordings in the layout of the TUM RGB-D data sets.

depth.txt            timestamp filename of every depth image; or associations.txt, four words a line
depth/*.png          16 bits, 5000 units a metre unless --unit says otherwise
groundtruth.txt      optional: poses of the camera in the world (the format's own meaning)
depth_camera.toml    the camera, see `pcnav.recordings.depth_camera`; or --camera FX FY CX CY
target.tum           optional truth of ours: T_cam_model at the depth images' time stamps
"""

import re
from pathlib import Path

import numpy as np

from pcnav.config.recording import AS_IT_IS, RecordingTable
from pcnav.core.arrays import FloatArray
from pcnav.core.errors import InputError
from pcnav.dynamics.blocks import POSE_LAYOUT
from pcnav.dynamics.trajectory import Trajectory
from pcnav.files.regular_file import require_regular
from pcnav.recordings.assembling import Parts, assembled
from pcnav.recordings.depth_camera import depth_camera
from pcnav.recordings.sequence import Sequence
from pcnav.recordings.timed_poses import poses_at, read_timed_poses

DEPTH_LIST, ASSOCIATIONS = "depth.txt", "associations.txt"
GROUND_TRUTH, TARGET_TRUTH = "groundtruth.txt", "target.tum"
UNIT_M = 1.0 / 5000.0
_DEPTH = re.compile(r"(^|/)depth", re.IGNORECASE)
_MAX_BYTES = 200_000_000
"""Of a list of images."""


def is_tum_rgbd(path: Path) -> bool:
    """Whether a folder lists its depth images as the TUM data sets do."""
    return any((path / name).is_file() for name in (DEPTH_LIST, ASSOCIATIONS))


def read_tum_rgbd(
    path: Path,
    target_mesh: Path | None = None,
    skip_bad_frames: bool = False,
    table: RecordingTable = AS_IT_IS,
) -> Sequence:
    """The listed depth images; groundtruth.txt gives the poses of the camera. Raises `InputError`.

    Images outside the time that groundtruth.txt covers are left out, and that is said.
    """
    stamp_s, files = _listed(path)
    try:
        camera = depth_camera(path, table)
    except InputError as error:
        if error.field != "camera":
            raise
        own = "525 525 319.5 239.5 is the default of the TUM data sets"
        raise InputError(path, "camera", f"{error.expected}; {own}") from error
    assumed: tuple[str, ...] = ()
    T_cam_world, truth = None, path / GROUND_TRUTH
    if truth.is_file():
        T_cam_world = poses_at(read_timed_poses(truth), stamp_s)
        known = np.isfinite(T_cam_world[:, 0, 0])
        if not known.any():
            raise InputError(truth, "timestamp", "expected poses at the depth images' time stamps")
        assumed = (f"{GROUND_TRUTH} is taken for poses of the camera",)
        if not known.all():
            many = f"{int((~known).sum())} images without a pose of the camera left out"
            assumed = (*assumed, many)
        files = tuple(file for file, here in zip(files, known, strict=True) if here)
        stamp_s, T_cam_world = stamp_s[known], T_cam_world[known]
    parts = Parts(
        *(path, path, files, camera, stamp_s, T_cam_world),
        integer_unit_m=UNIT_M,
        assumed=assumed,
    )
    return assembled(parts, target_mesh, table, skip_bad_frames)


def read_tum_truth(path: Path, time_zero_s: float) -> Trajectory | None:
    """The poses of the target, times from a zero on; None without. Raises `InputError`."""
    file = path / TARGET_TRUTH
    if not file.is_file():
        return None
    poses = read_timed_poses(file)
    return Trajectory(poses.time_s - time_zero_s, POSE_LAYOUT, T_cam_target=poses.T)


def _listed(path: Path) -> tuple[FloatArray, tuple[str, ...]]:
    """Stamps (n,) and names of the depth images."""
    file = path / DEPTH_LIST if (path / DEPTH_LIST).is_file() else path / ASSOCIATIONS
    require_regular(file, _MAX_BYTES)
    try:
        lines = file.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(file, "file", f"expected a readable text ({error})") from error
    stamps, files = [], []
    for number, line in enumerate(lines, start=1):
        words = line.split("#")[0].split()
        if not words:
            continue
        pairs = list(zip(words[::2], words[1::2], strict=False))
        chosen = pairs if len(pairs) == 1 else [pair for pair in pairs if _DEPTH.search(pair[1])]
        expected = "expected timestamp filename, once or for colour and depth"
        if len(words) not in (2, 4) or len(chosen) != 1:
            raise InputError(file, f"line {number}", expected)
        try:
            stamps.append(float(chosen[0][0]))
        except ValueError as error:
            raise InputError(file, f"line {number}", expected) from error
        if Path(chosen[0][1]).is_absolute() or ".." in Path(chosen[0][1]).parts:
            raise InputError(file, f"line {number}", "expected a file in the recording's folder")
        files.append(chosen[0][1])
    if not files:
        raise InputError(file, "images", "expected at least one depth image")
    return np.array(stamps), tuple(files)
