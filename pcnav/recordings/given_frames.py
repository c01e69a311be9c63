"""The depth frames that a program hands over one by one: a recording that lies nowhere."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar, TypeAlias

from pcnav.core.camera import PinholeCamera
from pcnav.recordings.recording import RecordingKind
from pcnav.recordings.sequence import Frame, Sequence, SequenceInfo


@dataclass(frozen=True)
class GivenFrames:
    """What is known of them; they themselves only where they are kept."""

    kind: ClassVar[RecordingKind] = RecordingKind.DEPTH
    path: ClassVar[None] = None

    info: SequenceInfo
    seen_by: PinholeCamera | None = None
    """That took all of them; None before the first."""
    kept: tuple[Frame, ...] = ()

    @property
    def name(self) -> str:
        """What it is called."""
        return self.info.name

    def __len__(self) -> int:
        return len(self.kept)

    def __iter__(self) -> Iterator[Frame]:
        return iter(self.kept)

    def camera(self, index: int) -> PinholeCamera:
        """The camera that took a frame."""
        del index  # It is the same of all.
        assert self.seen_by is not None, "there was a frame"
        return self.seen_by


DepthRecording: TypeAlias = Sequence | GivenFrames
"""Depth frames, of files or of a program."""
