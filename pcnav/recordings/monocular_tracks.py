"""A recording of feature tracks of one camera as a folder, and the file that describes a camera.

tracks.csv           time_s, feature, u, v, see `pcnav.recordings.tracks`
camera.toml          [camera] width_px, height_px, focal_px (one or two numbers), centre_px,
                     pixel_sigma_px
camera_attitude.csv  optional, see `pcnav.recordings.attitudes`; a camera at rest without
truth.csv            optional, see `pcnav.recordings.truth`
"""

from pathlib import Path

import tomli_w

from pcnav.config.table import Pixels, Positive, Table
from pcnav.core.camera import PinholeCamera
from pcnav.core.errors import InputError
from pcnav.dynamics.trajectory import Trajectory
from pcnav.files.csv_table import read_csv
from pcnav.files.new_folder import new_folder
from pcnav.files.toml_file import read_toml_model
from pcnav.recordings.attitudes import read_camera_attitudes, write_camera_attitudes
from pcnav.recordings.tracks import (
    TRACKS_FILE,
    MonocularTracks,
    TrackFrame,
    attitudes_of,
    frames_of,
    tracks_folder,
    write_track_table,
)
from pcnav.recordings.truth import write_truth

CAMERA_FILE = "camera.toml"

_COLUMNS = ("time_s", "feature", "u", "v")


class CameraFacts(Table):
    """[camera] of camera.toml."""

    width_px: Pixels
    height_px: Pixels
    focal_px: Positive | tuple[Positive, Positive]
    centre_px: tuple[float, float] | None = None
    """None takes the middle of the image."""
    pixel_sigma_px: Positive = 0.1
    """Standard deviation of each tracked coordinate."""
    distortion: tuple[float, float, float, float, float] | None = None
    """k1, k2, p1, p2, k3 (Brown) of the images; tracks are stored without distortion."""
    frame_rate_hz: Positive | None = None
    """Of images whose times are not recorded."""

    @staticmethod
    def of(camera: PinholeCamera, pixel_sigma_px: float) -> "CameraFacts":
        """Of a camera without distortion."""
        return CameraFacts(
            width_px=camera.width,
            height_px=camera.height,
            focal_px=(camera.fx, camera.fy),
            centre_px=(camera.cx, camera.cy),
            pixel_sigma_px=pixel_sigma_px,
        )

    @property
    def camera(self) -> PinholeCamera:
        """Its intrinsics."""
        focal = self.focal_px if isinstance(self.focal_px, tuple) else (self.focal_px,) * 2
        middle = (0.5 * (self.width_px - 1), 0.5 * (self.height_px - 1))
        centre = self.centre_px or middle
        return PinholeCamera(self.width_px, self.height_px, *focal, *centre)


class _CameraFile(Table):
    camera: CameraFacts


def is_monocular_recording(path: Path) -> bool:
    """Whether a path is a folder with tracks.csv and camera.toml, or that tracks.csv."""
    folder = tracks_folder(path)
    return folder is not None and (folder / CAMERA_FILE).is_file()


def read_camera_file(path: Path) -> CameraFacts:
    """Intrinsics and noise. Raises `InputError`."""
    return read_toml_model(path, _CameraFile).camera


def write_camera_file(path: Path, facts: CameraFacts) -> None:
    """Write camera.toml."""
    stated = _CameraFile(camera=facts).model_dump(exclude_none=True)
    path.write_text(tomli_w.dumps(stated), encoding="utf-8")


def read_monocular_tracks(path: Path) -> MonocularTracks:
    """Read a recording from its folder or its tracks.csv.

    Raises `InputError`, which names the file and line, for missing files and columns, numbers that
    are not finite, times out of order and a feature twice at a time.
    """
    folder = tracks_folder(path)
    if folder is None:
        raise InputError(path, "folder", f"expected a folder with {TRACKS_FILE}, or that file")
    facts = read_camera_file(folder / CAMERA_FILE)
    times_s, seen = frames_of(read_csv(folder / TRACKS_FILE, _COLUMNS), _COLUMNS)
    attitudes = read_camera_attitudes(folder, times_s)
    frames = tuple(
        TrackFrame(time_s, R, *features)
        for time_s, R, features in zip(times_s.tolist(), attitudes, seen, strict=True)
    )
    name = folder.resolve().name
    return MonocularTracks(name, facts.camera, facts.pixel_sigma_px, frames, folder)


def write_monocular_tracks(
    out: Path, tracks: MonocularTracks, truth: Trajectory | None = None, overwrite: bool = False
) -> None:
    """Write a recording; the folder appears, whole, at the end.

    Raises `InputError` for a folder that must not be replaced.
    """
    with new_folder(out, overwrite, TRACKS_FILE) as folder:
        write_monocular_files(folder, tracks)
        write_truth(folder, truth)


def write_monocular_files(folder: Path, tracks: MonocularTracks) -> None:
    """Write the three files of a recording into an existing folder."""
    write_camera_file(folder / CAMERA_FILE, CameraFacts.of(tracks.camera, tracks.pixel_sigma_px))
    write_track_table(folder, _COLUMNS, tracks)
    write_camera_attitudes(folder, *attitudes_of(tracks))
