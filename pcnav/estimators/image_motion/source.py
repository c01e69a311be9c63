"""Images of one camera, or tracks of them, as a source of frames for a chain of attitudes."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from pcnav.config.pipeline_file import Pipeline
from pcnav.core.camera import PinholeCamera
from pcnav.core.errors import InputError
from pcnav.estimators.image_motion.chain import ChainFrame, ImageMotionChain
from pcnav.perception.feature_tracking import track_features
from pcnav.recordings.images import is_image_sequence, open_images
from pcnav.recordings.monocular_tracks import (
    CAMERA_FILE,
    is_monocular_recording,
    read_monocular_tracks,
)
from pcnav.recordings.tracks import TRACKS_FILE, MonocularTracks, TrackFrame

OnFrame = Callable[[ChainFrame, int, int], None]
"""Told what became of every frame, how many frames are done, and of how many."""


@dataclass(frozen=True)
class ImageSource:
    """Frames of a recording, whichever kind it is."""

    name: str
    place: Path
    """What the run was made from: a folder or a video."""
    folder: Path
    """Where its truth would be."""
    camera: PinholeCamera
    pixel_sigma_px: float
    frames: Iterator[TrackFrame]
    count: int
    is_images: bool


def is_seen_by_one_camera(path: Path) -> bool:
    """Whether a path is a recording that `run_images` takes."""
    return is_monocular_recording(path) or is_image_sequence(path)


def open_source(recording: Path, pipeline: Pipeline) -> ImageSource:
    """A folder of images, a video or a folder of tracks. Raises `InputError`."""
    if is_image_sequence(recording):
        images = open_images(recording)
        table = pipeline.feature_tracker
        return ImageSource(
            name=images.name,
            place=recording,
            folder=recording.parent if recording.is_file() else recording,
            camera=images.camera,
            pixel_sigma_px=table.pixel_sigma_px,
            frames=track_features(images, images.camera, table),
            count=len(images.times_s),
            is_images=True,
        )
    if recording.is_dir() and not (recording / CAMERA_FILE).is_file():
        raise InputError(recording / CAMERA_FILE, "file", "expected the camera of the recording")
    if not is_monocular_recording(recording) and recording.name != TRACKS_FILE:
        expected = f"expected {TRACKS_FILE}, images or a video, with {CAMERA_FILE}"
        raise InputError(recording, "recording", expected)
    tracks = read_monocular_tracks(recording)
    folder = recording.parent if recording.is_file() else recording
    frames, count = iter(tracks.frames), len(tracks.frames)
    sigma_px = tracks.pixel_sigma_px
    return ImageSource(tracks.name, folder, folder, tracks.camera, sigma_px, frames, count, False)


def chain_of(
    source: ImageSource, pipeline: Pipeline, on_frame: OnFrame | None
) -> tuple[MonocularTracks, list[ChainFrame]]:
    """All frames, and what became of each."""
    chain = ImageMotionChain(source.camera, source.pixel_sigma_px, pipeline.image_motion)
    frames: list[TrackFrame] = []
    chained: list[ChainFrame] = []
    for frame in source.frames:
        frames.append(frame)
        chained.append(chain.step(frame))
        if on_frame is not None:
            # A damaged video may end before, or after, what its header says.
            on_frame(chained[-1], len(frames), max(source.count, len(frames)))
    if not frames:
        raise InputError(source.place, "file", "expected at least one frame that can be read")
    tracks = MonocularTracks(source.name, source.camera, source.pixel_sigma_px, tuple(frames))
    return tracks, chained
