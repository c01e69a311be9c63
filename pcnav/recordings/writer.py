"""Writer of our own sequence format: a BOP scene, sequence.toml and, for simulations, truth."""

import json
import math
import shutil
from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from pcnav.core.arrays import FloatArray
from pcnav.core.distortion import Distortion
from pcnav.core.errors import InputError
from pcnav.dynamics.trajectory import Trajectory
from pcnav.files.new_folder import new_folder
from pcnav.recordings.bop import DEPTH_FOLDER, depth_file_name
from pcnav.recordings.bop_scene import OBJECT_ID, SCENE_CAMERA_FILE, SCENE_GT_FILE
from pcnav.recordings.depth_form import DepthForm
from pcnav.recordings.depth_png import MAXIMUM_UNITS, RawDepth, write_depth_png
from pcnav.recordings.scan_files import ScanWriter
from pcnav.recordings.sequence import Frame, SequenceInfo
from pcnav.recordings.sequence_file import SEQUENCE_FILE, write_sequence_file
from pcnav.recordings.truth import write_truth
from pcnav.target.mesh_files.reading import companion_files

_MIN_STEP_M = 1e-4
"""Finer than the noise of any depth camera."""


def write_sequence(
    out: Path,
    info: SequenceInfo,
    depth_step_m: float,
    frames: Iterable[Frame],
    truth: Trajectory | None = None,
    overwrite: bool = False,
) -> None:
    """Write frames one by one into a folder that appears, whole, when the last is written.

    The mesh of the target is copied, so that the sequence travels whole. ``truth`` has the poses of
    the model at every frame, nan where it is not known, and maybe all blocks. An exception leaves
    nothing behind, see `new_folder`. Raises `InputError` when the folder holds anything and
    ``overwrite`` is false or when it is not a sequence, and when a depth does not fit 16 bits of
    the stored step; `ValueError` when frames do not come in increasing order or not of one lens,
    without any, and for a truth of others.
    """
    with new_folder(out, overwrite, SCENE_CAMERA_FILE) as folder:
        (folder / DEPTH_FOLDER).mkdir()
        info = replace(info, target_mesh=_copied_mesh(info.target_mesh, folder))
        numbers: list[int] = []
        lenses: set[Distortion | None] = set()
        scans = ScanWriter(folder)

        def entries() -> Iterator[tuple[int, object]]:
            for frame in frames:
                if numbers and frame.index <= numbers[-1]:
                    raise ValueError(f"frame {frame.index} after frame {numbers[-1]}")
                file = folder / DEPTH_FOLDER / depth_file_name(frame.index)
                if frame.beams is None:
                    write_depth_png(file, _units(frame, depth_step_m, out))
                else:
                    scans.write(frame, file.with_suffix(""))
                numbers.append(frame.index)
                lenses.add(frame.camera.distortion)
                yield frame.index, _camera_entry(frame, depth_step_m, info.time_zero_s)

        _write_json(folder / SCENE_CAMERA_FILE, entries())
        if not numbers:
            raise ValueError("no frame was written")
        if len(lenses) > 1:
            raise ValueError("frames of several lenses")
        write_sequence_file(folder / SEQUENCE_FILE, info, DepthForm.through(lenses.pop()))
        if truth is not None:
            poses = zip(numbers, truth.poses, strict=True)
            entries_of = ((k, [] if np.isnan(T[0, 0]) else [_pose_entry(T)]) for k, T in poses)
            _write_json(folder / SCENE_GT_FILE, entries_of)
            if truth.layout.blocks:
                write_truth(folder, truth)


def depth_step(frames: Iterable[Frame]) -> float:
    """A step, m, in whose 16 bits the depths of all frames fit."""
    far_m = max(float(frame.depth_m.max()) for frame in frames)
    steps = max(1, math.ceil(far_m / (_MIN_STEP_M * (MAXIMUM_UNITS - 1))))
    return steps * _MIN_STEP_M


def _units(frame: Frame, depth_step_m: float, out: Path) -> RawDepth:
    units = np.rint(frame.depth_m.astype(np.float64) / depth_step_m)
    if not (units.min() >= 0.0 and units.max() <= MAXIMUM_UNITS):
        reach = MAXIMUM_UNITS * depth_step_m
        expected = f"expected depths between 0 and {reach:g} m (16 bits of the stored step)"
        got = f"got {float(frame.depth_m.max()):g} m in frame {frame.index}"
        raise InputError(out, "depth_scale", f"{expected}, {got}")
    return units.astype(np.uint16)


def _copied_mesh(mesh: Path | None, folder: Path) -> Path | None:
    """The copy of a target's mesh, of all its files and the TOML beside it, in the sequence."""
    if mesh is None:
        return None
    for file in (mesh, mesh.with_suffix(".toml"), *companion_files(mesh)):
        if file.is_file():
            copy = folder / file.relative_to(mesh.parent)
            copy.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(file, copy)
    return folder / mesh.name


def _write_json(path: Path, entries: Iterable[tuple[int, object]]) -> None:
    """An object by frame number, written entry by entry: memory stays flat."""
    with path.open("w", encoding="utf-8", newline="\n") as file:
        separator = "{\n"
        for number, value in entries:
            file.write(f'{separator}  "{number}": {json.dumps(value, allow_nan=False)}')
            separator = ",\n"
        file.write("\n}\n")


def _camera_entry(frame: Frame, depth_step_m: float, time_zero_s: float) -> dict[str, object]:
    return {
        "cam_K": frame.camera.matrix.ravel().tolist(),
        "depth_scale": depth_step_m * 1000.0,
        "timestamp_s": time_zero_s + frame.time_s,
        "cam_R_w2c": frame.T_cam_world[:3, :3].ravel().tolist(),
        "cam_t_w2c": (1000.0 * frame.T_cam_world[:3, 3]).tolist(),
    }


def _pose_entry(T_cam_model: FloatArray) -> dict[str, object]:
    return {
        "cam_R_m2c": T_cam_model[:3, :3].ravel().tolist(),
        "cam_t_m2c": (1000.0 * T_cam_model[:3, 3]).tolist(),
        "obj_id": OBJECT_ID,
    }
