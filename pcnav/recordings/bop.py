"""Reader of BOP scenes, with or without the additions of our own format."""

import logging
from pathlib import Path

from pcnav.core.errors import InputError
from pcnav.recordings.bop_scene import SCENE_CAMERA_FILE, read_scene_camera
from pcnav.recordings.depth_form import PLAIN
from pcnav.recordings.depth_png import depth_png_size
from pcnav.recordings.sequence import Sequence, SequenceInfo
from pcnav.recordings.sequence_file import SEQUENCE_FILE, read_sequence_file

DEPTH_FOLDER = "depth"

_LOG = logging.getLogger("pcnav")


def depth_file_name(number: int) -> str:
    """File name of a frame's depth image in a BOP scene."""
    return f"{number:06d}.png"


def read_bop(path: Path, target_mesh: Path | None = None) -> Sequence:
    """A BOP scene folder; sequence.toml is read where there is one.

    Without sequence.toml the sequence is a laboratory recording of unknown noise; what the files
    leave out is said in one warning. ``target_mesh`` replaces the mesh that
    sequence.toml names. Everything but the pixels is checked here. Raises `InputError`.
    """
    if not path.is_dir():
        raise InputError(path, "folder", f"expected a folder with {SCENE_CAMERA_FILE}")
    scene = read_scene_camera(path / SCENE_CAMERA_FILE)
    assumed, form = list(scene.assumed), PLAIN
    if (path / SEQUENCE_FILE).exists():
        info, form = read_sequence_file(path / SEQUENCE_FILE, target_mesh)
    else:
        info = SequenceInfo(path.absolute().name, 0.0, None, target_mesh)
        assumed.append(f"no {SEQUENCE_FILE}: a laboratory assumed")
    if info.range_sigma_m is None:
        assumed.append("no range_sigma_m: the range noise is unknown")
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
        form=form,
    )


def _require_images(folder: Path, numbers: list[int], files: tuple[str, ...]) -> None:
    if not folder.is_dir():
        raise InputError(folder, "folder", "expected a folder with the depth images")
    present = {file.name for file in folder.iterdir()}
    for number, file in zip(numbers, files, strict=True):
        if file not in present:
            expected = f"expected the depth image of frame {number} of {SCENE_CAMERA_FILE}"
            raise InputError(folder / file, "file", expected)
