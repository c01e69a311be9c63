"""Images of one camera: a folder of numbered pictures, or a video, with the camera's intrinsics.

camera.toml          [camera], see `pcnav.recordings.monocular_tracks`; beside a video, NAME.toml
                     or camera.toml
*.png, *.jpg         in the order of their names; or images/
times.csv            optional: time_s, one row per image; else frame_rate_hz of camera.toml, for a
                     video its own rate
camera_attitude.csv  optional, see `pcnav.recordings.attitudes`
truth.csv            optional, see `pcnav.recordings.truth`
"""

import logging
import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar, NamedTuple, Protocol, TypeAlias

import numpy as np
import numpy.typing as npt
from PIL import Image

from pcnav.core._extras import opencv
from pcnav.core.arrays import FloatArray
from pcnav.core.camera import PinholeCamera
from pcnav.core.errors import InputError
from pcnav.dynamics.trajectory import Trajectory
from pcnav.files.csv_table import read_csv, write_csv
from pcnav.files.decoding import decoding
from pcnav.files.new_folder import new_folder
from pcnav.files.regular_file import require_regular
from pcnav.recordings.attitudes import read_camera_attitudes, write_camera_attitudes
from pcnav.recordings.depth_png import MAX_IMAGE_BYTES, require_few_pixels
from pcnav.recordings.monocular_tracks import (
    CAMERA_FILE,
    CameraFacts,
    read_camera_file,
    write_camera_file,
)
from pcnav.recordings.recording import RecordingKind
from pcnav.recordings.tracks import TRACKS_FILE
from pcnav.recordings.truth import write_truth

GreyImage: TypeAlias = npt.NDArray[np.uint8]
"""(height, width) grey levels."""

TIMES_FILE = "times.csv"
IMAGE_FOLDER = "images"

_IMAGE_SUFFIXES = {".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff"}
_VIDEO_SUFFIXES = {".mp4", ".avi", ".mov", ".mkv", ".m4v", ".webm"}
_MAX_FRAMES = 10_000_000
_LOG = logging.getLogger("pcnav")


class ImageFrame(NamedTuple):
    """A picture."""

    time_s: float
    R_cam_world: FloatArray
    """(3, 3)"""
    grey: GreyImage


class Images(Protocol):
    """A recording of images, on disk or in memory."""

    @property
    def name(self) -> str: ...
    @property
    def path(self) -> Path | None: ...
    @property
    def camera(self) -> PinholeCamera: ...
    def __len__(self) -> int: ...
    def __iter__(self) -> Iterator[ImageFrame]: ...


@dataclass(frozen=True)
class ImageSequence:
    """Images in order of time; a picture is read when it is asked for."""

    kind: ClassVar[RecordingKind] = RecordingKind.IMAGES

    name: str
    path: Path
    """The folder, or the video."""
    files: tuple[Path, ...]
    """Empty for a video."""
    facts: CameraFacts
    times_s: FloatArray
    """(n,)"""
    R_cam_world: FloatArray
    """(n, 3, 3)"""

    @property
    def camera(self) -> PinholeCamera:
        """Intrinsics; the images as `read` gives them have no distortion."""
        return self.facts.camera

    def __len__(self) -> int:
        return len(self.times_s)

    def __iter__(self) -> Iterator[ImageFrame]:
        pictures = _pictures(self.files, self.camera) if self.files else _shots(self)
        for time_s, R, image in zip(
            self.times_s.tolist(), self.R_cam_world, pictures, strict=False
        ):
            yield ImageFrame(time_s, R, _undistorted(image, self.facts))


def is_image_sequence(path: Path) -> bool:
    """Whether a path is a video or a folder of images with camera.toml and without tracks."""
    if path.is_file():
        return path.suffix.lower() in _VIDEO_SUFFIXES
    if (path / TRACKS_FILE).exists() or not (path / CAMERA_FILE).is_file():
        return False
    return bool(_image_files(path))


def open_images(path: Path) -> ImageSequence:
    """Open a folder of images or a video.

    Raises `InputError` for missing files, a wrong camera file, times that do not fit the images,
    and a video that cannot be read or OpenCV missing for one.
    """
    return _open_video(path) if path.is_file() else _open_folder(path)


def write_images(
    out: Path,
    facts: CameraFacts,
    images: Iterable[ImageFrame],
    truth: Trajectory | None = None,
    overwrite: bool = False,
) -> int:
    """Write a folder of images; how many it holds.

    The folder appears, whole, at the end. Raises `InputError` for one that must not be replaced.
    """
    with new_folder(out, overwrite, CAMERA_FILE) as folder:
        (folder / IMAGE_FOLDER).mkdir()
        times_s, attitudes = [], []
        for k, frame in enumerate(images):
            name = f"{k:06d}.png"
            Image.fromarray(frame.grey).save(folder / IMAGE_FOLDER / name, compress_level=1)
            times_s.append(frame.time_s)
            attitudes.append(frame.R_cam_world)
        write_camera_file(folder / CAMERA_FILE, facts)
        write_csv(folder / TIMES_FILE, ("time_s",), [[time_s] for time_s in times_s])
        R_cam_world = np.reshape(attitudes, (-1, 3, 3))
        write_camera_attitudes(folder, np.array(times_s), R_cam_world)
        write_truth(folder, truth)
    return len(times_s)


def _image_files(folder: Path) -> tuple[Path, ...]:
    for place in (folder, folder / IMAGE_FOLDER):
        if place.is_dir():
            names = sorted(p for p in place.iterdir() if p.suffix.lower() in _IMAGE_SUFFIXES)
            if names:
                return tuple(names)
    return ()


def _open_folder(folder: Path) -> ImageSequence:
    files = _image_files(folder)
    if not files:
        raise InputError(folder, "images", "expected PNG or JPEG images in it or in images/")
    facts = read_camera_file(folder / CAMERA_FILE)
    times_s = _times(folder, len(files), facts)
    R = read_camera_attitudes(folder, times_s)
    return ImageSequence(folder.resolve().name, folder, files, facts, times_s, R)


def _times(folder: Path, count: int, facts: CameraFacts) -> FloatArray:
    path = folder / TIMES_FILE
    if path.is_file():
        times_s = read_csv(path, ("time_s",)).times()
        if len(times_s) != count:
            raise InputError(path, "rows", f"expected one for each of {count} images")
        if np.any(np.diff(times_s) <= 0.0):
            raise InputError(path, "time_s", "expected times that increase")
        return times_s
    if facts.frame_rate_hz is None:
        _LOG.warning(
            "%s: neither times.csv nor frame_rate_hz: images are taken as 1 s apart", folder
        )
    return np.arange(count) / (facts.frame_rate_hz or 1.0)


def _open_video(path: Path) -> ImageSequence:
    own, shared = path.with_suffix(".toml"), path.parent / CAMERA_FILE
    beside = own if own.is_file() else shared
    if not beside.is_file():
        expected = f"expected {own.name} or {shared.name} beside a video, with its camera"
        raise InputError(path, "camera", f"{expected}: a video is images, and holds no depth")
    facts = read_camera_file(beside)
    cv2 = opencv("reading videos")
    video = cv2.VideoCapture(str(path))
    try:
        if not video.isOpened():
            raise InputError(path, "file", "expected a video that OpenCV can read")
        count = int(video.get(cv2.CAP_PROP_FRAME_COUNT))
        rate = facts.frame_rate_hz or float(video.get(cv2.CAP_PROP_FPS))
    finally:
        video.release()
    if not (0 < count <= _MAX_FRAMES and 0.0 < rate < math.inf):
        expected = f"expected a video with frames, at most {_MAX_FRAMES:,}, and a frame rate"
        raise InputError(path, "file", expected)
    times_s = np.arange(count) / rate
    R = read_camera_attitudes(path.parent, times_s)
    return ImageSequence(path.stem, path, (), facts, times_s, R)


def _pictures(files: tuple[Path, ...], camera: PinholeCamera) -> Iterator[GreyImage]:
    for path in files:
        require_regular(path, MAX_IMAGE_BYTES)
        with decoding(path, "an undamaged image"), Image.open(path) as opened:
            require_few_pixels(path, opened)
            grey = _eight_bits(opened)
        yield _sized(path, grey, camera)


def _eight_bits(opened: Image.Image) -> GreyImage:
    if opened.mode.startswith("I"):
        # 16-bit grey: the lower byte is below what the tracker tells apart.
        deep = np.asarray(opened).astype(np.float64)
        return np.clip(deep / 257.0, 0.0, 255.0).astype(np.uint8)
    return np.asarray(opened.convert("L"), dtype=np.uint8)


def _shots(sequence: ImageSequence) -> Iterator[GreyImage]:
    cv2 = opencv("reading videos")
    video = cv2.VideoCapture(str(sequence.path))
    try:
        while True:
            there, shot = video.read()
            if not there:
                return
            grey = shot if shot.ndim == 2 else cv2.cvtColor(shot, cv2.COLOR_BGR2GRAY)
            yield _sized(sequence.path, np.asarray(grey, dtype=np.uint8), sequence.camera)
    finally:
        video.release()


def _sized(path: Path, grey: GreyImage, camera: PinholeCamera) -> GreyImage:
    height, width = grey.shape
    if (width, height) != (camera.width, camera.height):
        expected = f"expected {camera.width} x {camera.height} px as the camera file says"
        raise InputError(path, "image size", f"{expected}, got {width} x {height}")
    return grey


def _undistorted(image: GreyImage, facts: CameraFacts) -> GreyImage:
    if facts.distortion is None:
        return image
    cv2 = opencv("images with lens distortion")
    return np.asarray(
        cv2.undistort(image, facts.camera.matrix, np.array(facts.distortion)), dtype=np.uint8
    )
