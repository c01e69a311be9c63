"""Images of one camera as a recording of the tracks of their features."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar

from pcnav.config.image_motion import FeatureTrackerTable
from pcnav.core.camera import PinholeCamera
from pcnav.perception.feature_tracking import track_features
from pcnav.recordings.images import Images
from pcnav.recordings.monocular_tracks import write_monocular_files
from pcnav.recordings.recording import RecordingKind
from pcnav.recordings.tracks import MonocularTracks, TrackFrame


@dataclass(frozen=True)
class TrackedImages:
    """Images whose features are followed as the frames are asked for, which is once."""

    kind: ClassVar[RecordingKind] = RecordingKind.IMAGES

    images: Images
    settings: FeatureTrackerTable
    _frames: list[TrackFrame] = field(default_factory=list)

    @property
    def name(self) -> str:
        """That of the images."""
        return self.images.name

    @property
    def path(self) -> Path | None:
        """The folder of the images, or the video; None of images in memory."""
        return self.images.path

    @property
    def camera(self) -> PinholeCamera:
        """Intrinsics, without distortion."""
        return self.images.camera

    @property
    def pixel_sigma_px(self) -> float:
        """Standard deviation of each tracked coordinate."""
        return self.settings.pixel_sigma_px

    def __len__(self) -> int:
        return len(self.images)

    def __iter__(self) -> Iterator[TrackFrame]:
        for frame in track_features(self.images, self.camera, self.settings):
            self._frames.append(frame)
            yield frame

    def write(self, folder: Path) -> None:
        """Leave the tracks found in a folder, which is then a recording itself."""
        frames = tuple(self._frames)
        tracks = MonocularTracks(self.name, self.camera, self.pixel_sigma_px, frames)
        write_monocular_files(folder, tracks)
