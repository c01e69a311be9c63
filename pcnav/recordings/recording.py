"""What every recording has in common, whatever it is made of and however it is stored."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any, ClassVar, Protocol

from pcnav.config.scenario import RecordingKind as RecordingKind


class Recording(Protocol):
    """Frames in order of time; what a frame is follows from the class of the recording."""

    kind: ClassVar[RecordingKind]

    @property
    def name(self) -> str:
        """What it is called."""

    @property
    def path(self) -> Path | None:
        """The folder, table or video it is read from; None of one that is simulated in memory."""

    def __len__(self) -> int:
        """Number of frames; of a damaged video what its header says."""

    def __iter__(self) -> Iterator[Any]:
        """The frames one by one. Raises `InputError` for one that is missing or damaged."""


def truth_folder(path: Path) -> Path:
    """Where the truth of a recording lies that is read from a folder, a table or a video."""
    return path if path.is_dir() else path.parent
