"""The JSON files of a BOP scene, parsed into compact arrays."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, TypeVar

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError

from pcnav.core.arrays import BoolArray, FloatArray, IntArray, picked
from pcnav.core.distortion import COEFFICIENTS, DistortionModel
from pcnav.core.errors import InputError
from pcnav.core.spatial import make_transform, nearest_orthogonal, orthonormality_error
from pcnav.files.regular_file import read_bytes
from pcnav.recordings.frame_checks import ROTATION_TOLERANCE
from pcnav.recordings.time_line import MAX_STAMP_S, begins_anew, time_line

SCENE_CAMERA_FILE = "scene_camera.json"
SCENE_GT_FILE = "scene_gt.json"
OBJECT_ID = 1
"""obj_id of the target in the scenes we write."""

Content = TypeVar("Content")
_Nine = Annotated[list[float], Field(min_length=9, max_length=9)]
_Three = Annotated[list[float], Field(min_length=3, max_length=3)]
_Coefficients = Annotated[list[float], Field(min_length=4, max_length=8)]
_MAXIMUM_KEY_DIGITS = 9
_MAX_LISTED = 30
_MAX_BYTES = 200_000_000
"""Of a JSON file: some 400,000 frames."""


class _Entry(BaseModel):
    # Other producers add keys of their own, which are no concern of ours.
    model_config = ConfigDict(frozen=True, extra="ignore", allow_inf_nan=False, strict=True)


class _CameraEntry(_Entry):
    cam_K: _Nine
    depth_scale: Annotated[float, Field(gt=0.0)] | None = None
    timestamp_s: float | None = None
    cam_R_w2c: _Nine | None = None
    cam_t_w2c: _Three | None = None
    cam_dist: _Coefficients | None = None


class _PoseEntry(_Entry):
    cam_R_m2c: _Nine
    cam_t_m2c: _Three
    obj_id: int


_CAMERAS = TypeAdapter(dict[str, _CameraEntry])
_POSES = TypeAdapter(dict[str, list[_PoseEntry]])


@dataclass(frozen=True)
class SceneCamera:
    """scene_camera.json, one row per frame in order of time."""

    numbers: IntArray
    """(n,) frame numbers, which name the images."""
    time_s: FloatArray
    """(n,) strictly increasing, as stamped."""
    intrinsics: FloatArray
    """(n, 4) fx, fy, cx, cy, px."""
    depth_step_m: FloatArray
    """(n,) metres per stored unit; nan where the file does not say."""
    T_cam_world: FloatArray
    """(n, 4, 4)"""
    distortion: tuple[float, ...]
    """Of the lens, as OpenCV's model has it; empty without any."""
    assumed: tuple[str, ...]
    """What the file does not say and was assumed, and what is odd in it, in words."""
    left_out: IntArray
    """(m,) numbers of frames whose time stamp is another's."""


def read_scene_camera(path: Path) -> SceneCamera:
    """Read and check scene_camera.json, and put its frames in order of time.

    Raises `InputError` naming the frame and the field.
    """
    entries = _by_number(path, _read_json(path, _CAMERAS))
    if not entries:
        raise InputError(path, "frames", "expected at least one frame")
    numbers = list(entries)
    cameras = list(entries.values())
    assumed = []
    time_s = np.arange(len(numbers), dtype=np.float64)
    if _all_or_none(path, numbers, [c.timestamp_s for c in cameras], "timestamp_s"):
        time_s = np.array([c.timestamp_s for c in cameras], dtype=np.float64)
        _require_seconds(path, numbers, time_s)
    else:
        assumed.append("no timestamp_s: 0, 1, 2, ... s assumed")
    T_cam_world = np.tile(np.eye(4), (len(numbers), 1, 1))
    has_rotation = _all_or_none(path, numbers, [c.cam_R_w2c for c in cameras], "cam_R_w2c")
    has_translation = _all_or_none(path, numbers, [c.cam_t_w2c for c in cameras], "cam_t_w2c")
    if has_rotation != has_translation:
        missing = "cam_t_w2c" if has_rotation else "cam_R_w2c"
        raise InputError(path, f"{numbers[0]}.{missing}", "expected both of cam_R_w2c, cam_t_w2c")
    if has_rotation:
        R = np.array([c.cam_R_w2c for c in cameras], dtype=np.float64)
        p_mm = np.array([c.cam_t_w2c for c in cameras], dtype=np.float64)
        T_cam_world = _poses(path, numbers, R, p_mm, "cam_R_w2c")
    else:
        assumed.append("no cam_R_w2c and cam_t_w2c: a camera at rest assumed")
    depth_step_m = np.full(len(numbers), np.nan)
    if _all_or_none(path, numbers, [c.depth_scale for c in cameras], "depth_scale"):
        depth_step_m = np.array([c.depth_scale for c in cameras], dtype=np.float64) / 1000.0
    line = time_line(time_s, np.array(numbers, dtype=np.intp))
    scene = SceneCamera(
        numbers=np.array(numbers, dtype=np.intp),
        time_s=time_s,
        intrinsics=_intrinsics(path, numbers, np.array([c.cam_K for c in cameras])),
        depth_step_m=depth_step_m,
        T_cam_world=T_cam_world,
        distortion=_distortion(path, numbers, [c.cam_dist for c in cameras]),
        assumed=(*assumed, *line.remarks),
        left_out=np.zeros(0, dtype=np.intp),
    )
    left_out = np.setdiff1d(scene.numbers, scene.numbers[line.kept])
    in_order = replace(scene, left_out=np.arange(len(numbers)))
    return replace(picked(in_order, line.kept), left_out=left_out)


def read_scene_poses(path: Path, object_id: int | None = None) -> tuple[IntArray, FloatArray]:
    """Numbers (n,) of the frames of scene_gt.json that show the target, and (n, 4, 4) T_cam_model.

    The target is the object asked for; else the only one of a frame, else the one with obj_id 1.
    A frame in which that does not tell one object has none: n may be 0. Raises `InputError`, also
    where an object that was asked for is in no frame.
    """
    found, seen = {}, set()
    for number, poses in _by_number(path, _read_json(path, _POSES)).items():
        seen |= {pose.obj_id for pose in poses}
        place = _place_of([pose.obj_id for pose in poses], object_id)
        if place is not None:
            found[number] = poses[place]
    if not seen:
        raise InputError(path, "frames", "expected at least one pose")
    if object_id is not None and object_id not in seen:
        known = ", ".join(map(str, sorted(seen)[:_MAX_LISTED]))
        raise InputError(path, "--object", f"expected one of the objects {known}, got {object_id}")
    numbers = list(found)
    R = np.reshape([p.cam_R_m2c for p in found.values()], (-1, 9))
    p_mm = np.reshape([p.cam_t_m2c for p in found.values()], (-1, 3))
    T_cam_model = _poses(path, numbers, R, p_mm, "0.cam_R_m2c")
    return np.array(numbers, dtype=np.intp), T_cam_model


def object_places(path: Path, object_id: int) -> dict[int, int]:
    """By frame number, the place of an object among those of scene_gt.json, which masks are named
    after; frames that show it not, or several times, are not there. Raises `InputError`."""
    places = {}
    for number, poses in _by_number(path, _read_json(path, _POSES)).items():
        place = _place_of([pose.obj_id for pose in poses], object_id)
        if place is not None:
            places[number] = place
    return places


def _place_of(objects: list[int], object_id: int | None) -> int | None:
    """Place of the target among the objects of a frame; None where that is not clear."""
    if object_id is None and len(objects) == 1:
        return 0
    wanted = OBJECT_ID if object_id is None else object_id
    return objects.index(wanted) if objects.count(wanted) == 1 else None


def _require_seconds(path: Path, numbers: list[int], time_s: FloatArray) -> None:
    small = np.abs(time_s) < MAX_STAMP_S
    expected = "expected seconds; such a number counts milliseconds, microseconds or nanoseconds"
    _require(path, numbers, small, "timestamp_s", expected)
    anew = begins_anew(time_s)
    if anew is not None:
        expected = "expected the stamps of one clock, but they begin anew here"
        raise InputError(path, f"{numbers[anew]}.timestamp_s", expected)


def _read_json(path: Path, adapter: TypeAdapter[Content]) -> Content:
    try:
        return adapter.validate_json(read_bytes(path, _MAX_BYTES))
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        field = ".".join(str(part) for part in first["loc"]) or "file"
        if first["type"] == "missing":
            raise InputError(path, field, "missing; expected a value") from error
        raise InputError(path, field, first["msg"]) from error


def _by_number(path: Path, entries: dict[str, Content]) -> dict[int, Content]:
    """The entries keyed by frame number, in increasing order."""
    for key in entries:
        if not (key.isascii() and key.isdecimal() and len(key) <= _MAXIMUM_KEY_DIGITS):
            raise InputError(path, repr(key), "expected a frame number as key, such as 0 or 12")
    numbered = {int(key): entry for key, entry in entries.items()}
    if len(numbered) < len(entries):
        raise InputError(path, "frames", "expected every frame number once")
    return dict(sorted(numbered.items()))


def _all_or_none(path: Path, numbers: list[int], values: list[Content | None], field: str) -> bool:
    absent = [number for number, value in zip(numbers, values, strict=True) if value is None]
    if 0 < len(absent) < len(numbers):
        raise InputError(path, f"{absent[0]}.{field}", "missing, while other frames have it")
    return not absent


def _distortion(
    path: Path, numbers: list[int], stated: list[list[float] | None]
) -> tuple[float, ...]:
    if not _all_or_none(path, numbers, stated, "cam_dist"):
        return ()
    alike = np.array([values == stated[0] for values in stated])
    _require(path, numbers, alike, "cam_dist", "expected one lens for all frames")
    first = tuple(stated[0] or ())
    if len(first) not in COEFFICIENTS[DistortionModel.OPENCV]:
        raise InputError(path, f"{numbers[0]}.cam_dist", "expected 4, 5 or 8 numbers")
    return first


def _intrinsics(path: Path, numbers: list[int], cam_K: FloatArray) -> FloatArray:
    fx, skew, cx, k10, fy, cy = cam_K.T[:6]
    focal = (fx > 0.0) & (fy > 0.0)
    _require(path, numbers, focal, "cam_K", "expected focal lengths above 0")
    _require(path, numbers, skew == 0.0, "cam_K", "expected no skew (second number 0)")
    last = (k10 == 0.0) & (cam_K[:, 6:] == [0.0, 0.0, 1.0]).all(axis=1)
    _require(path, numbers, last, "cam_K", "expected fx 0 cx 0 fy cy 0 0 1")
    return np.stack([fx, fy, cx, cy], axis=1)


def _poses(
    path: Path, numbers: list[int], R: FloatArray, p_mm: FloatArray, field: str
) -> FloatArray:
    R = R.reshape(-1, 3, 3)
    proper = orthonormality_error(R) <= ROTATION_TOLERANCE
    expected = f"expected a rotation matrix (orthonormal to {ROTATION_TOLERANCE:g}, determinant 1)"
    _require(path, numbers, proper, field, expected)
    return make_transform(nearest_orthogonal(R), p_mm / 1000.0)


def _require(path: Path, numbers: list[int], good: BoolArray, field: str, expected: str) -> None:
    """Raise `InputError` for the first frame where ``good`` is false."""
    if not good.all():
        raise InputError(path, f"{numbers[int(np.argmin(good))]}.{field}", expected)
