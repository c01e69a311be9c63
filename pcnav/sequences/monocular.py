"""Tracks of feature points seen by one camera, and the folder they are recorded in.

tracks.csv    time_s, feature, u, v: rows in order of time; a time without features is one row
              whose other fields are empty
camera.toml   [camera] width_px, height_px, focal_px (one or two numbers), centre_px,
              pixel_sigma_px
attitude.csv  optional: time_s, q_x, q_y, q_z, q_w of R_world_cam; a camera at rest without
"""

import csv
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import tomli_w
from pydantic import BaseModel, ConfigDict, Field
from scipy.spatial.transform import Rotation, Slerp

from pcnav.arrays import BoolArray, FloatArray, IntArray
from pcnav.camera import PinholeCamera
from pcnav.config import read_toml_model
from pcnav.csv_table import CsvTable, read_csv
from pcnav.errors import InputError
from pcnav.new_folder import new_folder
from pcnav.spatial import xyzw_from_rotation

MONOCULAR_TRACKS_FILE = "tracks.csv"
CAMERA_FILE = "camera.toml"
CAMERA_ATTITUDE_FILE = "attitude.csv"

MONOCULAR_COLUMNS = ("time_s", "feature", "u", "v")
_ATTITUDE_COLUMNS = ("time_s", "q_x", "q_y", "q_z", "q_w")
_NORM_TOLERANCE = 1e-6
_TIME_TOLERANCE_S = 1e-9


@dataclass(frozen=True)
class MonocularFrame:
    """The features seen at one time; none in a blackout."""

    time_s: float
    R_cam_world: FloatArray
    """(3, 3) attitude of the camera, as the chaser knows it."""
    features: IntArray
    """(n,) numbers of the features seen, each at most once."""
    pixels: FloatArray
    """(n, 2) u, v."""


@dataclass(frozen=True)
class MonocularTracks:
    """A recording."""

    name: str
    camera: PinholeCamera
    pixel_sigma_px: float
    """Standard deviation of each tracked coordinate."""
    frames: tuple[MonocularFrame, ...]
    """In order of time."""


class _CameraTable(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    width_px: Annotated[int, Field(gt=0)]
    height_px: Annotated[int, Field(gt=0)]
    focal_px: (
        Annotated[float, Field(gt=0.0)]
        | tuple[Annotated[float, Field(gt=0.0)], Annotated[float, Field(gt=0.0)]]
    )
    centre_px: tuple[float, float] | None = None
    distortion: tuple[float, float, float, float, float] | None = None
    """k1, k2, p1, p2, k3 of the images; tracks are stored without distortion."""
    pixel_sigma_px: Annotated[float, Field(gt=0.0)] = 0.1
    frame_rate_hz: Annotated[float, Field(gt=0.0)] | None = None
    """Of images whose times are not recorded."""


class _CameraFile(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")

    camera: _CameraTable


@dataclass(frozen=True)
class CameraFacts:
    """What camera.toml says."""

    camera: PinholeCamera
    pixel_sigma_px: float
    distortion: tuple[float, float, float, float, float] | None
    """k1, k2, p1, p2, k3 (Brown)."""
    frame_rate_hz: float | None


def is_monocular_recording(path: Path) -> bool:
    """Whether a path is a folder with tracks.csv and camera.toml, or that tracks.csv."""
    folder = path.parent if path.is_file() and path.name == MONOCULAR_TRACKS_FILE else path
    return (folder / MONOCULAR_TRACKS_FILE).is_file() and (folder / CAMERA_FILE).is_file()


def read_camera_file(path: Path) -> CameraFacts:
    """Intrinsics and noise. Raises `InputError`."""
    table = read_toml_model(path, _CameraFile).camera
    focal = table.focal_px
    fx, fy = focal if isinstance(focal, tuple) else (focal, focal)
    middle = (0.5 * (table.width_px - 1), 0.5 * (table.height_px - 1))
    cx, cy = table.centre_px or middle
    camera = PinholeCamera(table.width_px, table.height_px, fx, fy, cx, cy)
    return CameraFacts(camera, table.pixel_sigma_px, table.distortion, table.frame_rate_hz)


def write_camera_file(path: Path, facts: CameraFacts) -> None:
    """Write camera.toml."""
    camera = facts.camera
    table: dict[str, object] = {
        "width_px": camera.width,
        "height_px": camera.height,
        "focal_px": [camera.fx, camera.fy],
        "centre_px": [camera.cx, camera.cy],
        "pixel_sigma_px": facts.pixel_sigma_px,
    }
    if facts.distortion is not None:
        table["distortion"] = list(facts.distortion)
    if facts.frame_rate_hz is not None:
        table["frame_rate_hz"] = facts.frame_rate_hz
    path.write_text(tomli_w.dumps({"camera": table}), encoding="utf-8")


def read_monocular(path: Path) -> MonocularTracks:
    """Read a recording from its folder or its tracks.csv.

    Raises `InputError`, which names the file and line, for missing files and columns, numbers that
    are not finite, times out of order and a feature twice at a time.
    """
    folder = path.parent if path.is_file() else path
    if not (folder / MONOCULAR_TRACKS_FILE).is_file():
        expected = f"expected a folder with {MONOCULAR_TRACKS_FILE}, or that file"
        raise InputError(path, "folder", expected)
    facts = read_camera_file(folder / CAMERA_FILE)
    time_s, features, pixels = _checked(read_csv(folder / MONOCULAR_TRACKS_FILE, MONOCULAR_COLUMNS))
    starts = np.flatnonzero(np.diff(time_s, prepend=np.nan) != 0.0)
    attitudes = read_camera_attitudes(folder, time_s[starts])
    frames = []
    for start, end, R in zip(starts, [*starts[1:], len(time_s)], attitudes, strict=True):
        rows = slice(start, start if features[start] < 0 else end)
        frames.append(MonocularFrame(float(time_s[start]), R, features[rows], pixels[rows]))
    name = folder.resolve().name
    return MonocularTracks(name, facts.camera, facts.pixel_sigma_px, tuple(frames))


def write_monocular(out: Path, tracks: MonocularTracks, overwrite: bool = False) -> None:
    """Write a recording; the folder appears, whole, at the end.

    Raises `InputError` for a folder that must not be replaced.
    """
    with new_folder(out, overwrite, MONOCULAR_TRACKS_FILE) as folder:
        write_monocular_files(folder, tracks)


def write_monocular_files(folder: Path, tracks: MonocularTracks) -> None:
    """Write the three files of a recording into an existing folder."""
    facts = CameraFacts(tracks.camera, tracks.pixel_sigma_px, None, None)
    write_camera_file(folder / CAMERA_FILE, facts)
    with (folder / MONOCULAR_TRACKS_FILE).open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(MONOCULAR_COLUMNS)
        for frame in tracks.frames:
            writer.writerows(_rows(frame))
    times_s = np.array([frame.time_s for frame in tracks.frames])
    write_camera_attitudes(folder, times_s, np.stack([f.R_cam_world for f in tracks.frames]))


def write_camera_attitudes(folder: Path, times_s: FloatArray, R_cam_world: FloatArray) -> None:
    """Write attitude.csv of times (n,) and attitudes (n, 3, 3)."""
    with (folder / CAMERA_ATTITUDE_FILE).open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(_ATTITUDE_COLUMNS)
        quaternions = xyzw_from_rotation(np.swapaxes(R_cam_world, 1, 2))
        writer.writerows(np.column_stack([times_s, quaternions]).tolist())


def read_camera_attitudes(folder: Path, times_s: FloatArray) -> FloatArray:
    """(n, 3, 3) R_cam_world at times, at constant rate between those of attitude.csv.

    Without the file the camera is at rest. Raises `InputError`.
    """
    path = folder / CAMERA_ATTITUDE_FILE
    if not path.is_file():
        return np.broadcast_to(np.eye(3), (len(times_s), 3, 3))
    table = read_csv(path, _ATTITUDE_COLUMNS)
    recorded, quaternions = table.times(), table.numbers(_ATTITUDE_COLUMNS[1:])
    if not len(recorded):
        raise InputError(path, "rows", "expected at least one row")
    _require(path, np.diff(recorded, prepend=-np.inf) > 0.0, "expected times that increase")
    with np.errstate(invalid="ignore"):
        unit = np.abs(np.linalg.norm(quaternions, axis=1) - 1.0) <= _NORM_TOLERANCE
    _require(path, unit, "expected a unit quaternion in q_x to q_w")
    before = times_s[0] < recorded[0] - _TIME_TOLERANCE_S
    if before or times_s[-1] > recorded[-1] + _TIME_TOLERANCE_S:
        expected = f"expected times that cover the frames, {times_s[0]:g} to {times_s[-1]:g} s"
        raise InputError(path, "time_s", expected)
    R_world_cam = Rotation.from_quat(quaternions)
    if len(recorded) > 1:
        R_world_cam = Slerp(recorded, R_world_cam)(np.clip(times_s, recorded[0], recorded[-1]))
    matrices = np.asarray(R_world_cam.as_matrix(), dtype=np.float64)
    return np.broadcast_to(np.swapaxes(matrices, 1, 2), (len(times_s), 3, 3))


def _rows(frame: MonocularFrame) -> list[list[float | int | str]]:
    if not len(frame.features):
        return [[frame.time_s, "", "", ""]]
    pairs = zip(frame.features.tolist(), frame.pixels.tolist(), strict=True)
    return [[frame.time_s, feature, *pixels] for feature, pixels in pairs]


def _checked(table: CsvTable) -> tuple[FloatArray, IntArray, FloatArray]:
    """(n,) times, (n,) features, -1 in a time without any, and (n, 2) pixels of checked rows."""
    path, time_s = table.path, table.times()
    if not len(time_s):
        raise InputError(path, "rows", "expected at least one row")
    numbers, pixels = table.numbers(("feature",))[:, 0], table.numbers(("u", "v"))
    empty = np.isnan(numbers) & np.isnan(pixels).all(axis=1)
    whole = empty | ((numbers >= 0.0) & (numbers == np.rint(numbers)) & (numbers < 2.0**53))
    later = np.diff(time_s, prepend=-np.inf) >= 0.0
    _require(path, later, "expected times in order, this one is before the last", "time_s")
    _require(path, whole, "expected a whole number from 0 on", "feature")
    for k, name in enumerate(("u", "v")):
        _require(path, empty | np.isfinite(pixels[:, k]), "expected a finite number", name)
    features = np.where(empty, -1, np.where(empty, 0.0, numbers)).astype(np.intp)
    order = np.lexsort((features, time_s))
    same_time = np.diff(time_s[order]) == 0.0
    repeated = same_time & ((np.diff(features[order]) == 0) | (features[order][:-1] < 0))
    if repeated.any():
        row = int(order[1:][repeated].min())
        expected = f"expected each feature once at a time ({time_s[row]:g} s)"
        raise InputError(path, f"line {row + 2}, feature", expected)
    return time_s, features, pixels


def _require(path: Path, good: BoolArray, expected: str, column: str = "") -> None:
    """Refuse the first row that is not good."""
    if not good.all():
        line = f"line {int(np.argmin(good)) + 2}"
        raise InputError(path, f"{line}, {column}" if column else line, expected)
