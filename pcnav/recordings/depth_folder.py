"""A folder of depth images with a camera beside them, or given: PNG, TIFF, NPY, NPZ, EXR.

depth_camera.toml     see `pcnav.recordings.depth_camera`; or --camera FX FY CX CY
*.png ...             in it or in depth/, in the order of their numbers
times.csv             optional: time_s, one row an image; else names that are time stamps
poses.tum             optional: T_world_cam of every image, at its time stamp
"""

import os
import re
from dataclasses import replace
from pathlib import Path

import numpy as np

from pcnav.config.recording import AS_IT_IS, RecordingTable
from pcnav.core.arrays import FloatArray
from pcnav.core.errors import InputError
from pcnav.files.csv_table import read_csv
from pcnav.recordings.assembling import Parts, assembled
from pcnav.recordings.bop_scene import SCENE_CAMERA_FILE
from pcnav.recordings.depth_camera import camera_file, depth_camera
from pcnav.recordings.depth_image import SUFFIXES, read_depth_image
from pcnav.recordings.images import TIMES_FILE, is_image_sequence
from pcnav.recordings.sequence import Sequence
from pcnav.recordings.sequence_file import SEQUENCE_FILE
from pcnav.recordings.timed_poses import poses_at, read_timed_poses
from pcnav.recordings.tsdf_fusion import INTRINSICS_FILE

POSES_FILE = "poses.tum"
_DEPTH_FOLDER = "depth"
_DEPTH_LIST = "depth.txt"
"""Of a TUM RGB-D recording, which is none of these."""
_NUMBERS = re.compile(r"\d+")
_DECIMAL = re.compile(r"\d+\.\d+")
_PER_SECOND = {13: 1e3, 16: 1e6, 19: 1e9}
"""Units of an epoch's stamps by the digits that they have in this century."""


def is_depth_folder(path: Path) -> bool:
    """Whether a folder, or its folder depth, holds depth images, and is no scene of our own.

    One with a sequence.toml and no camera of this kind is a scene whose cameras are missing.
    """
    of_another = any((path / name).is_file() for name in (SCENE_CAMERA_FILE, INTRINSICS_FILE))
    if not path.is_dir() or of_another or is_image_sequence(path):
        return False
    images, names = _files(path)
    has_camera = any(camera_file(folder) is not None for folder in (images, path))
    return bool(names) and (has_camera or not (path / SEQUENCE_FILE).is_file())


def read_depth_folder(
    path: Path,
    target_mesh: Path | None = None,
    skip_bad_frames: bool = False,
    table: RecordingTable = AS_IT_IS,
) -> Sequence:
    """The images of a folder, in order. Raises `InputError`."""
    images, names = _files(path)
    files = tuple(sorted(names, key=number_of))
    stems = [Path(file).stem for file in files]
    if len(set(stems)) < len(stems):
        twice = next(stem for stem in stems if stems.count(stem) > 1)
        raise InputError(images, twice, "expected one depth image of each name")
    camera = depth_camera(images if camera_file(images) else path, table, path)
    stamp_s = stamps_of(path, stems)
    parts = Parts(path, images, files, camera, stamp_s, _poses(path, stamp_s))
    return assembled(parts, target_mesh, table, skip_bad_frames)


def with_more(sequence: Sequence, names: list[str]) -> Sequence | None:
    """A recording with more images, where their names alone tell what is new: time stamps, of a
    camera at rest.

    None where they do not, or where the images come before others: the folder is to be opened anew.
    """
    files, path = sequence.files, sequence.path
    beside = (SCENE_CAMERA_FILE, INTRINSICS_FILE, TIMES_FILE, POSES_FILE, _DEPTH_LIST)
    if sequence.read_image is not read_depth_image or any((path / n).exists() for n in beside):
        return None
    new = sorted(names, key=number_of)
    stamp_s = named_stamps([Path(file).stem for file in (files[-1], *new)])
    if stamp_s is None or not (np.diff(stamp_s) > 0.0).all():
        return None
    times_s = stamp_s - sequence.info.time_zero_s
    if times_s[0] != sequence.times_s[-1]:
        return None
    n = len(new)
    return replace(
        sequence,
        files=(*files, *new),
        times_s=np.concatenate([sequence.times_s, times_s[1:]]),
        intrinsics=np.concatenate([sequence.intrinsics, np.tile(sequence.intrinsics[-1], (n, 1))]),
        depth_step_m=np.concatenate([sequence.depth_step_m, np.full(n, sequence.depth_step_m[-1])]),
        T_cam_world=np.concatenate([sequence.T_cam_world, np.tile(np.eye(4), (n, 1, 1))]),
    )


def _files(path: Path) -> tuple[Path, list[str]]:
    """The folder of the images, and their names."""
    for folder in (path / _DEPTH_FOLDER, path):
        if folder.is_dir():
            # What is hidden is somebody's file on its way, or of a file system. Of a folder that
            # is opened again with every frame of many thousands, paths would take most of the time.
            shown = (name for name in os.listdir(folder) if not name.startswith("."))  # noqa: PTH208
            names = [name for name in shown if name.lower().endswith(SUFFIXES)]
            if names:
                return folder, names
    return path, []


def number_of(name: str) -> tuple[list[int], str]:
    """What files are sorted by: the numbers in their names."""
    return [int(digits) for digits in _NUMBERS.findall(name)], name


def stamps_of(path: Path, stems: list[str]) -> FloatArray | None:
    """(n,) seconds of files with such names, by times.csv or by their names; None of neither.

    Raises `InputError` for a times.csv of another length.
    """
    table = path / TIMES_FILE
    if table.is_file():
        time_s = read_csv(table, ("time_s",)).times()
        if len(time_s) != len(stems):
            raise InputError(table, "rows", f"expected one for each of {len(stems)} images")
        return time_s
    return named_stamps(stems)


def named_stamps(stems: list[str]) -> FloatArray | None:
    """(n,) seconds, of names that are time stamps; None of any others."""
    if all(_DECIMAL.fullmatch(stem) for stem in stems):
        return np.array([float(stem) for stem in stems])
    digits = len(stems[0])
    if digits in _PER_SECOND and all(re.fullmatch(rf"\d{{{digits}}}", stem) for stem in stems):
        return np.array([int(stem) / _PER_SECOND[digits] for stem in stems])
    return None


def _poses(path: Path, stamp_s: FloatArray | None) -> FloatArray | None:
    """(n, 4, 4) T_cam_world of the images; None where they are not recorded."""
    file = path / POSES_FILE
    if not file.is_file():
        return None
    if stamp_s is None:
        raise InputError(file, "file", f"expected {TIMES_FILE}, the images' time stamps, beside it")
    found = poses_at(read_timed_poses(file), stamp_s)
    known = np.isfinite(found[:, 0, 0])
    if not known.all():
        missing = f"{stamp_s[int(np.argmin(known))]!r} s"
        raise InputError(file, "timestamp", f"expected poses about the image at {missing}")
    return found
