"""Reader of BOP scenes, with or without the additions of our own format."""

import logging
from pathlib import Path

import numpy as np

from pcnav.core.camera import PinholeCamera
from pcnav.core.errors import InputError
from pcnav.recordings.bop_scene import SCENE_CAMERA_FILE, read_scene_camera
from pcnav.recordings.depth_png import depth_png_size, read_depth_png
from pcnav.recordings.sequence import Frame, Sequence, SequenceInfo
from pcnav.recordings.sequence_file import SEQUENCE_FILE, read_sequence_file

DEPTH_FOLDER = "depth"
DEFAULT_RANGE_SIGMA_M = 0.005
"""Assumed where a recording does not state its noise: a structured-light camera at 2 m."""

_LOG = logging.getLogger("pcnav")


def depth_file_name(number: int) -> str:
    """File name of a frame's depth image in a BOP scene."""
    return f"{number:06d}.png"


class BopSequence(Sequence):
    """A BOP scene folder; sequence.toml is read where there is one.

    Without sequence.toml the sequence is a laboratory recording of `DEFAULT_RANGE_SIGMA_M`; what
    the files leave out is said in one warning. ``target_mesh`` replaces the mesh that
    sequence.toml names. Everything but the pixels is checked here. Raises `InputError`.
    """

    def __init__(self, path: Path, target_mesh: Path | None = None) -> None:
        if not path.is_dir():
            raise InputError(path, "folder", f"expected a folder with {SCENE_CAMERA_FILE}")
        self._path = path
        self._scene = read_scene_camera(path / SCENE_CAMERA_FILE)
        assumed = list(self._scene.assumed)
        self._invalid_depth: int | None = None
        if (path / SEQUENCE_FILE).exists():
            info, self._invalid_depth = read_sequence_file(path / SEQUENCE_FILE, target_mesh)
            self._info = info
        else:
            self._info = SequenceInfo(path.absolute().name, 0.0, DEFAULT_RANGE_SIGMA_M, target_mesh)
            noise = f"range noise of {DEFAULT_RANGE_SIGMA_M:g} m"
            assumed.append(f"no {SEQUENCE_FILE}: a laboratory and {noise} assumed")
        self._require_images()
        self._size = depth_png_size(self._image_path(0))
        if assumed:
            _LOG.warning("%s: %s", path, "; ".join(assumed))

    @property
    def path(self) -> Path:
        """The folder it is read from."""
        return self._path

    @property
    def info(self) -> SequenceInfo:
        """What holds for the whole sequence."""
        return self._info

    def __len__(self) -> int:
        return len(self._scene.numbers)

    def frame(self, index: int) -> Frame:
        """Read one frame. Raises `InputError` when its file is missing or damaged."""
        if not 0 <= index < len(self):
            raise IndexError(f"frame {index} of {len(self)}")
        units = read_depth_png(self._image_path(index), self._size)
        depth_m = units * np.float32(self._scene.depth_step_m[index])
        if self._invalid_depth is not None:
            depth_m[units == self._invalid_depth] = 0.0
        fx, fy, cx, cy = self._scene.intrinsics[index].tolist()
        return Frame(
            index=index,
            time_s=float(self._scene.time_s[index]),
            depth_m=depth_m,
            camera=PinholeCamera(self._size.width, self._size.height, fx, fy, cx, cy),
            T_cam_world=self._scene.T_cam_world[index],
        )

    def _image_path(self, index: int) -> Path:
        return self._path / DEPTH_FOLDER / depth_file_name(int(self._scene.numbers[index]))

    def _require_images(self) -> None:
        folder = self._path / DEPTH_FOLDER
        if not folder.is_dir():
            raise InputError(folder, "folder", "expected a folder with the depth images")
        present = {file.name for file in folder.iterdir()}
        for number in self._scene.numbers.tolist():
            if depth_file_name(number) not in present:
                expected = f"expected the depth image of frame {number} of {SCENE_CAMERA_FILE}"
                raise InputError(folder / depth_file_name(number), "file", expected)
