"""The camera of depth images that come without one: a small file beside them, or options.

depth_camera.toml, depth_camera.json, camera.json, camera.toml: fx, fy, cx, cy in px (or K, nine
numbers row by row; or Open3D's intrinsic_matrix, column by column); optional width and height,
depth_scale (mm per stored unit), distortion and distortion_model, depth_is ("z" or "range").
"""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from pydantic import ConfigDict, Strict

from pcnav.config.recording import RecordingTable
from pcnav.config.table import Pixels, Positive, Table
from pcnav.core.distortion import COEFFICIENTS, DistortionModel
from pcnav.core.errors import InputError
from pcnav.files.regular_file import read_bytes
from pcnav.files.toml_file import checked, read_toml
from pcnav.recordings.depth_form import PLAIN, DepthForm, DepthIs
from pcnav.recordings.depth_image import ImageSize

CAMERA_NAMES = ("depth_camera.toml", "depth_camera.json", "camera.json", "camera.toml")
_INTRINSICS = ("fx", "fy", "cx", "cy")
_KNOWN = ("K", "cam_K", "intrinsic_matrix")
_MAX_BYTES = 100_000


class _CameraModel(Table):
    """What is read of the file; other tools add keys of their own."""

    model_config = ConfigDict(extra="ignore")

    fx: Positive
    fy: Positive
    cx: float
    cy: float
    width: Pixels | None = None
    height: Pixels | None = None
    depth_scale: Positive | None = None
    distortion: Annotated[tuple[float, ...], Strict(False)] = ()
    distortion_model: DistortionModel = DistortionModel.OPENCV
    depth_is: DepthIs = DepthIs.Z


@dataclass(frozen=True)
class DepthCamera:
    """Intrinsics and what a stored pixel means."""

    intrinsics: tuple[float, float, float, float]
    """fx, fy, cx, cy, px."""
    size: ImageSize | None = None
    """Where it is stated."""
    unit_m: float | None = None
    """Metres of a stored unit, where it is stated."""
    form: DepthForm = PLAIN


def camera_file(folder: Path) -> Path | None:
    """The file of a folder that describes the camera of its depth images; None without one."""
    for name in CAMERA_NAMES:
        path = folder / name
        # camera.toml with a table [camera] is that of a camera that takes pictures.
        if path.is_file() and (name != "camera.toml" or _says_depth_camera(path)):
            return path
    return None


def depth_camera(folder: Path, table: RecordingTable, where: Path | None = None) -> DepthCamera:
    """The camera of the images in a folder: as options say it, else as the file beside them.

    ``where`` is what an `InputError` names, else the folder. Raises `InputError` where neither is.
    """
    path = camera_file(folder)
    if path is None and table.camera_px is None:
        names = ", ".join(CAMERA_NAMES[:3])
        expected = f"expected --camera FX FY CX CY (px), or {names} beside the images"
        raise InputError(where or folder, "camera", expected)
    if path is None:
        assert table.camera_px is not None
        return DepthCamera(table.camera_px, None, table.unit_m)
    found = read_depth_camera(path)
    intrinsics = table.camera_px or found.intrinsics
    return DepthCamera(intrinsics, found.size, table.unit_m or found.unit_m, found.form)


def read_depth_camera(path: Path) -> DepthCamera:
    """Raises `InputError` for a file that says too little."""
    found = _content(path)
    for name, order in (("K", 1), ("cam_K", 1), ("intrinsic_matrix", 3)):
        if name in found:
            found |= _of_matrix(path, name, found[name], by_rows=order == 1)
    model = checked(path, _CameraModel, found)
    counts = COEFFICIENTS[model.distortion_model]
    if model.distortion and len(model.distortion) not in counts:
        said = " or ".join(map(str, counts))
        expected = f"expected {said} numbers, got {len(model.distortion)}"
        raise InputError(path, "distortion", expected)
    both = model.width is not None and model.height is not None
    return DepthCamera(
        (model.fx, model.fy, model.cx, model.cy),
        ImageSize(model.width or 0, model.height or 0) if both else None,
        None if model.depth_scale is None else model.depth_scale / 1000.0,
        DepthForm(
            depth_is=model.depth_is,
            distortion_model=model.distortion_model,
            distortion=model.distortion,
        ),
    )


def _content(path: Path) -> dict[str, Any]:
    if path.suffix == ".toml":
        found = read_toml(path)
    else:
        try:
            found = json.loads(read_bytes(path, _MAX_BYTES, "readable JSON"))
        except InputError:
            raise
        except (OSError, ValueError, RecursionError) as error:
            raise InputError(path, "file", f"expected readable JSON ({error})") from error
    if not isinstance(found, dict):
        raise InputError(path, "file", "expected one table of keys and values")
    inner = found.get("depth_camera")
    return dict(inner) if isinstance(inner, dict) else dict(found)


def _of_matrix(path: Path, name: str, value: object, *, by_rows: bool) -> dict[str, float]:
    rows = value if isinstance(value, list) else []
    numbers = [x for row in rows for x in (row if isinstance(row, list) else [row])]
    known = all(isinstance(x, int | float) and not isinstance(x, bool) for x in numbers)
    if len(numbers) != 9 or not known:
        raise InputError(path, name, "expected nine numbers")
    places = (0, 4, 2, 5) if by_rows else (0, 4, 6, 7)
    return dict(zip(_INTRINSICS, (float(numbers[k]) for k in places), strict=True))


def _says_depth_camera(path: Path) -> bool:
    try:
        found = read_toml(path)
    except InputError:
        return False
    return any(name in found for name in ("fx", *_KNOWN, "depth_camera"))
