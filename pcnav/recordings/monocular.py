"""Tracks of feature points seen by one camera, and the folder they are recorded in.

tracks.csv    time_s, feature, u, v: rows in order of time; a time without features is one row
              whose other fields are empty
camera.toml   [camera] width_px, height_px, focal_px (one or two numbers), centre_px,
              pixel_sigma_px
attitude.csv  optional: time_s, q_x, q_y, q_z, q_w of R_world_cam; a camera at rest without
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar

import numpy as np
import tomli_w
from pydantic import BaseModel, ConfigDict, Field

from pcnav.core.arrays import FloatArray, IntArray
from pcnav.core.camera import PinholeCamera
from pcnav.core.errors import InputError
from pcnav.files.csv_table import read_csv
from pcnav.files.new_folder import new_folder
from pcnav.files.toml_file import read_toml_model
from pcnav.recordings.attitude_file import ATTITUDE_FILE, read_attitude_file, write_attitude_file
from pcnav.recordings.recording import RecordingKind
from pcnav.recordings.track_table import checked_tracks, frame_rows, write_track_table

MONOCULAR_TRACKS_FILE = "tracks.csv"
CAMERA_FILE = "camera.toml"

MONOCULAR_COLUMNS = ("time_s", "feature", "u", "v")


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

    kind: ClassVar[RecordingKind] = RecordingKind.IMAGES

    name: str
    camera: PinholeCamera
    pixel_sigma_px: float
    """Standard deviation of each tracked coordinate."""
    frames: tuple[MonocularFrame, ...]
    """In order of time."""
    path: Path | None = None
    """The folder it is read from."""

    def __len__(self) -> int:
        return len(self.frames)

    def __iter__(self) -> Iterator[MonocularFrame]:
        return iter(self.frames)


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
    table = read_csv(folder / MONOCULAR_TRACKS_FILE, MONOCULAR_COLUMNS)
    time_s, features, pixels = checked_tracks(table, MONOCULAR_COLUMNS)
    frames = frame_rows(time_s, features)
    times_s = np.array([time_s[rows.start] for rows in frames])
    seen = tuple(
        MonocularFrame(float(t), R, features[rows], pixels[rows])
        for t, R, rows in zip(times_s, read_camera_attitudes(folder, times_s), frames, strict=True)
    )
    name = folder.resolve().name
    return MonocularTracks(name, facts.camera, facts.pixel_sigma_px, seen, folder)


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
    frames = ((frame.time_s, frame.features, frame.pixels) for frame in tracks.frames)
    write_track_table(folder / MONOCULAR_TRACKS_FILE, MONOCULAR_COLUMNS, frames)
    times_s = np.array([frame.time_s for frame in tracks.frames])
    write_camera_attitudes(folder, times_s, np.stack([f.R_cam_world for f in tracks.frames]))


def write_camera_attitudes(folder: Path, times_s: FloatArray, R_cam_world: FloatArray) -> None:
    """Write attitude.csv of times (n,) and attitudes (n, 3, 3)."""
    write_attitude_file(folder / ATTITUDE_FILE, times_s, R_cam_world)


def read_camera_attitudes(folder: Path, times_s: FloatArray) -> FloatArray:
    """(n, 3, 3) R_cam_world at times, at constant rate between those of attitude.csv.

    Without the file the camera is at rest. Raises `InputError`.
    """
    path = folder / ATTITUDE_FILE
    if not path.is_file():
        return np.broadcast_to(np.eye(3), (len(times_s), 3, 3))
    return read_attitude_file(path, times_s)
