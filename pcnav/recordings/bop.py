"""Reader of BOP scenes, with or without the additions of our own format."""

import logging
import math
import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from pcnav.config.length_unit import LengthUnit
from pcnav.config.recording import AS_IT_IS, RecordingTable
from pcnav.core.errors import InputError
from pcnav.recordings.bop_models import model_of
from pcnav.recordings.bop_scene import SCENE_CAMERA_FILE, SceneCamera, read_scene_camera
from pcnav.recordings.depth_form import PLAIN
from pcnav.recordings.depth_image import SUFFIXES, ImageSize, first_size, image_of
from pcnav.recordings.scan_files import SCAN_FILE, ScanTable, read_scan_table, scan_of
from pcnav.recordings.sequence import Sequence, SequenceInfo
from pcnav.recordings.sequence_file import SEQUENCE_FILE, read_sequence_file, stated_time_zero
from pcnav.recordings.time_line import zero_of

DEPTH_FOLDER = "depth"

_LOG = logging.getLogger("pcnav")


def depth_file_name(number: int) -> str:
    """File name of a frame's depth image in the scenes we write."""
    return f"{_stem(number)}.png"


def read_bop(
    path: Path,
    target_mesh: Path | None = None,
    skip_bad_frames: bool = False,
    table: RecordingTable = AS_IT_IS,
) -> Sequence:
    """A BOP scene folder; sequence.toml is read where there is one.

    Without sequence.toml the sequence is a laboratory recording of unknown noise; what the files
    leave out is said in one warning. ``target_mesh`` replaces the mesh that
    sequence.toml names. Everything but the pixels is checked here. With ``skip_bad_frames`` images
    may be missing, but for one. Raises `InputError`.
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
    if info.target_mesh is None:
        info = _with_model(path, info, table.object)
    if not form.distortion:
        form = replace(form, distortion=scene.distortion)
    if info.range_sigma_m is None:
        assumed.append("no range_sigma_m: the range noise is unknown")
    zero_s = time_zero(path, scene)
    if zero_s != 0.0:
        _LOG.info("%s: time 0 is the time stamp %.17g s", path, zero_s)
    info = replace(info, time_zero_s=zero_s)
    assumed += _doubt_of_zero(info, float(scene.time_s[0]))
    images, numbers = path / DEPTH_FOLDER, scene.numbers.tolist()
    table_of_scans = path / SCAN_FILE
    scans = read_scan_table(table_of_scans) if table_of_scans.is_file() else None
    files = _images(images, numbers, skip_bad_frames, scan_of if scans else image_of)
    if assumed:
        _LOG.warning("%s: %s", path, "; ".join(assumed))
    if scans is not None:
        return _of_scans(path, info, scene, files, scans)
    return Sequence(
        path=path,
        info=info,
        images=images,
        files=files,
        size=first_size(images, files, skip_bad_frames),
        times_s=scene.time_s - zero_s,
        intrinsics=scene.intrinsics,
        depth_step_m=scene.depth_step_m,
        T_cam_world=scene.T_cam_world,
        form=form,
        object_id=table.object,
    )


def _of_scans(
    path: Path, info: SequenceInfo, scene: SceneCamera, files: tuple[str, ...], scans: ScanTable
) -> Sequence:
    """Scans: cam_K says nothing, the grid is that of their table."""
    camera = scans.camera
    return Sequence(
        path=path,
        info=replace(info, scan_s=scans.lasts_s, row_readout_s=0.0),
        images=path / DEPTH_FOLDER,
        files=files,
        size=ImageSize(camera.width, camera.height),
        times_s=scene.time_s - info.time_zero_s,
        intrinsics=np.tile([camera.fx, camera.fy, camera.cx, camera.cy], (len(files), 1)),
        depth_step_m=scene.depth_step_m,
        T_cam_world=scene.T_cam_world,
        read_scan=scans.read,
    )


def _with_model(path: Path, info: SequenceInfo, object_id: int | None) -> SequenceInfo:
    """With the model that the data set has of the target, in its millimetres."""
    model = model_of(path, object_id)
    if model is None:
        return info
    _LOG.info("%s: the target is %s of the data set, in millimetres", path, model.name)
    return replace(info, target_mesh=model, mesh_unit=LengthUnit.MILLIMETRE)


def time_zero(path: Path, scene: SceneCamera) -> float:
    """The time stamp that is time 0 of a scene's frames and truth. Raises `InputError`."""
    return zero_of(float(scene.time_s[0]), stated_time_zero(path / SEQUENCE_FILE))


def _doubt_of_zero(info: SequenceInfo, first_s: float) -> list[str]:
    """What is said where the Hill frame would have turned more than once before the first frame."""
    turned = abs(info.mean_motion_rad_s * (first_s - info.time_zero_s))
    if turned <= 2.0 * math.pi:
        return []
    return [
        f"the first frame is {first_s - info.time_zero_s:.6g} s after time 0, more than a "
        f"revolution: [sequence] time_zero_s says which stamp is time 0"
    ]


def _stem(number: int) -> str:
    return f"{number:06d}"


def _images(
    folder: Path,
    numbers: list[int],
    may_be_missing: bool,
    find: Callable[[Path, str, set[str]], str | None],
) -> tuple[str, ...]:
    """Names of the depth images of frames. Raises `InputError` for one that is not there."""
    if not folder.is_dir():
        raise InputError(folder, "folder", "expected a folder with the depth images")
    present = set(os.listdir(folder))  # noqa: PTH208 (paths of many thousand files take long)
    files = []
    for number in numbers:
        file = find(folder, _stem(number), present)
        if file is None and may_be_missing:
            file = depth_file_name(number)
        elif file is None:
            expected = f"expected the depth image of frame {number} of {SCENE_CAMERA_FILE}"
            kinds = ", ".join(SUFFIXES)
            raise InputError(folder / depth_file_name(number), "file", f"{expected} ({kinds})")
        files.append(file)
    return tuple(files)
