"""Writer of our own sequence format: a BOP scene, sequence.toml and, for simulations, truth."""

import json
import shutil
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import TextIO

import numpy as np

from pcnav.core.arrays import FloatArray
from pcnav.core.errors import InputError
from pcnav.dynamics.state import NavigationState
from pcnav.files.new_folder import new_folder
from pcnav.recordings.bop import DEPTH_FOLDER, depth_file_name
from pcnav.recordings.bop_scene import OBJECT_ID, SCENE_CAMERA_FILE, SCENE_GT_FILE
from pcnav.recordings.depth_png import MAXIMUM_UNITS, write_depth_png
from pcnav.recordings.sequence import Frame, SequenceInfo
from pcnav.recordings.sequence_file import SEQUENCE_FILE, write_sequence_file
from pcnav.recordings.state_table import STATE_COLUMNS, state_row

TRUTH_FILE = "truth.csv"


class SequenceWriter:
    """Writes frames one by one into a folder that appears, whole, when the block ends.

    See `new_folder`: an exception in the block leaves nothing. Raises `InputError` on entry
    when the folder holds anything and ``overwrite`` is false, or when it is not a sequence.
    """

    def __init__(
        self, path: Path, info: SequenceInfo, depth_step_m: float, overwrite: bool = False
    ) -> None:
        self._path = path
        self._info = info
        self._depth_step_m = depth_step_m
        self._place = new_folder(path, overwrite, SCENE_CAMERA_FILE)
        self._poses: _JsonObject | None = None
        self._states: TextIO | None = None
        self._last_index = -1

    def __enter__(self) -> "SequenceWriter":
        with ExitStack() as begun:
            self._folder = begun.enter_context(self._place)
            begun.enter_context(self._tables())
            self._begun = begun.pop_all()
        return self

    def write(
        self,
        frame: Frame,
        state: NavigationState | None = None,
        T_cam_model: FloatArray | None = None,
    ) -> None:
        """Store a frame and, where known, the true state and pose: of all frames or of none.

        Raises `InputError` when a depth does not fit 16 bits of the stored step, and `ValueError`
        when frames do not come in increasing order or truth comes and goes.
        """
        if frame.index <= self._last_index:
            raise ValueError(f"frame {frame.index} after frame {self._last_index}")
        self._write_depth(frame)
        self._cameras.add(frame.index, _camera_entry(frame, self._depth_step_m))
        first = self._last_index < 0
        if first and T_cam_model is not None:
            self._poses = _JsonObject(self._open(SCENE_GT_FILE))
        if first and state is not None:
            self._states = self._open(TRUTH_FILE)
            self._states.write(",".join(STATE_COLUMNS) + "\n")
        if (T_cam_model is None) != (self._poses is None) or (state is None) != (
            self._states is None
        ):
            raise ValueError("truth is written for all frames or for none")
        if self._poses is not None and T_cam_model is not None:
            self._poses.add(frame.index, [_pose_entry(T_cam_model)])
        if self._states is not None and state is not None:
            row = state_row(frame.time_s, state).tolist()
            self._states.write(",".join(map(repr, row)) + "\n")
        self._last_index = frame.index

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._begun.__exit__(kind, error, trace)

    @contextmanager
    def _tables(self) -> Iterator[None]:
        """Open files, completed where the block ends well and closed in any case."""
        (self._folder / DEPTH_FOLDER).mkdir()
        info = replace(self._info, target_mesh=self._copied_mesh())
        write_sequence_file(self._folder / SEQUENCE_FILE, info)
        with ExitStack() as self._open_files:
            self._cameras = _JsonObject(self._open(SCENE_CAMERA_FILE))
            yield
            if self._last_index < 0:
                raise ValueError("no frame was written")
            self._cameras.end()
            if self._poses is not None:
                self._poses.end()

    def _open(self, name: str) -> TextIO:
        file = (self._folder / name).open("w", encoding="utf-8", newline="\n")
        return self._open_files.enter_context(file)

    def _write_depth(self, frame: Frame) -> None:
        units = np.rint(frame.depth_m.astype(np.float64) / self._depth_step_m)
        if not (units.min() >= 0.0 and units.max() <= MAXIMUM_UNITS):
            reach = MAXIMUM_UNITS * self._depth_step_m
            expected = f"expected depths between 0 and {reach:g} m (16 bits of the stored step)"
            got = f"got {float(frame.depth_m.max()):g} m in frame {frame.index}"
            raise InputError(self._path, "depth_scale", f"{expected}, {got}")
        name = depth_file_name(frame.index)
        write_depth_png(self._folder / DEPTH_FOLDER / name, units.astype(np.uint16))

    def _copied_mesh(self) -> Path | None:
        """The target's mesh and its TOML copied into the sequence, so that it travels whole."""
        mesh = self._info.target_mesh
        if mesh is None:
            return None
        for file in (mesh, mesh.with_suffix(".toml")):
            if file.is_file():
                shutil.copyfile(file, self._folder / file.name)
        return self._folder / mesh.name


class _JsonObject:
    """A JSON object written entry by entry."""

    def __init__(self, file: TextIO) -> None:
        self._file = file
        self._separator = "{\n"

    def add(self, key: int, value: object) -> None:
        self._file.write(f'{self._separator}  "{key}": {json.dumps(value, allow_nan=False)}')
        self._separator = ",\n"

    def end(self) -> None:
        self._file.write("\n}\n")


def _camera_entry(frame: Frame, depth_step_m: float) -> dict[str, object]:
    return {
        "cam_K": frame.camera.matrix.ravel().tolist(),
        "depth_scale": depth_step_m * 1000.0,
        "timestamp_s": frame.time_s,
        "cam_R_w2c": frame.T_cam_world[:3, :3].ravel().tolist(),
        "cam_t_w2c": (1000.0 * frame.T_cam_world[:3, 3]).tolist(),
    }


def _pose_entry(T_cam_model: FloatArray) -> dict[str, object]:
    return {
        "cam_R_m2c": T_cam_model[:3, :3].ravel().tolist(),
        "cam_t_m2c": (1000.0 * T_cam_model[:3, 3]).tolist(),
        "obj_id": OBJECT_ID,
    }
