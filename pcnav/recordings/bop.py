"""Reader of BOP scenes, with or without the additions of our own format."""

import logging
from pathlib import Path

from pcnav.core.errors import InputError
from pcnav.recordings.bop_scene import SCENE_CAMERA_FILE, read_scene_camera
from pcnav.recordings.depth_png import depth_png_size
from pcnav.recordings.sequence import Sequence, SequenceInfo
from pcnav.recordings.sequence_file import SEQUENCE_FILE, read_sequence_file

DEPTH_FOLDER = "depth"
DEFAULT_RANGE_SIGMA_M = 0.005
"""Assumed where a recording does not state its noise: a structured-light camera at 2 m."""

_LOG = logging.getLogger("pcnav")


def depth_file_name(number: int) -> str:
    """File name of a frame's depth image in a BOP scene."""
    return f"{number:06d}.png"


def read_bop(path: Path, target_mesh: Path | None = None) -> Sequence:
    """A BOP scene folder; sequence.toml is read where there is one.

    Without sequence.toml the sequence is a laboratory recording of `DEFAULT_RANGE_SIGMA_M`; what
    the files leave out is said in one warning. ``target_mesh`` replaces the mesh that
    sequence.toml names. Everything but the pixels is checked here. Raises `InputError`.
    """
    if not path.is_dir():
        raise InputError(path, "folder", f"expected a folder with {SCENE_CAMERA_FILE}")
    scene = read_scene_camera(path / SCENE_CAMERA_FILE)
    assumed, invalid_units = list(scene.assumed), None
    if (path / SEQUENCE_FILE).exists():
        info, invalid_units = read_sequence_file(path / SEQUENCE_FILE, target_mesh)
    else:
        info = SequenceInfo(path.absolute().name, 0.0, DEFAULT_RANGE_SIGMA_M, target_mesh)
        noise = f"range noise of {DEFAULT_RANGE_SIGMA_M:g} m"
        assumed.append(f"no {SEQUENCE_FILE}: a laboratory and {noise} assumed")
    images, numbers = path / DEPTH_FOLDER, scene.numbers.tolist()
    files = tuple(depth_file_name(number) for number in numbers)
    _require_images(images, numbers, files)
    if assumed:
        _LOG.warning("%s: %s", path, "; ".join(assumed))
    return Sequence(
        path=path,
        info=info,
        images=images,
        files=files,
        size=depth_png_size(images / files[0]),
        times_s=scene.time_s,
        intrinsics=scene.intrinsics,
        depth_step_m=scene.depth_step_m,
        T_cam_world=scene.T_cam_world,
        invalid_units=invalid_units,
    )


def _require_images(folder: Path, numbers: list[int], files: tuple[str, ...]) -> None:
    if not folder.is_dir():
        raise InputError(folder, "folder", "expected a folder with the depth images")
    present = {file.name for file in folder.iterdir()}
    for number, file in zip(numbers, files, strict=True):
        if file not in present:
            expected = f"expected the depth image of frame {number} of {SCENE_CAMERA_FILE}"
            raise InputError(folder / file, "file", expected)
