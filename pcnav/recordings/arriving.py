"""Frames that are answered as they arrive, wherever they come from."""

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Protocol

from pcnav.core.errors import InputError
from pcnav.recordings.given_frames import DepthRecording
from pcnav.recordings.intake import SkippedFrame
from pcnav.recordings.sequence import Frame

END_FILE = "END"
"""An empty file of this name in a folder says that no frame comes after those that are there."""


@dataclass(frozen=True)
class Arrival:
    """One frame, ready to be answered."""

    frame: Frame
    """As the settings leave it; blind where it could not be read."""
    came_s: float
    """`time.monotonic` of when all of it was there."""
    was_there: bool = False
    """Whether it was there before anybody looked."""


class Arriving(Protocol):
    """Where frames come from."""

    @property
    def recording(self) -> DepthRecording | None:
        """What is known of the frames so far; None before the first is ready."""

    @property
    def why_not(self) -> InputError | None:
        """What is missed, where nothing can be read yet."""

    @property
    def has_ended(self) -> bool:
        """Whether no frame comes any more; those that have come may still be waiting."""

    @property
    def skipped(self) -> tuple[SkippedFrame, ...]:
        """Frames that could not be read, and so were coasted over."""

    @property
    def remarks(self) -> tuple[str, ...]:
        """What is to be said of the frames, a sentence each."""

    def look(self) -> bool:
        """Take notice of what has come; whether a frame is ready. Does not wait.

        Raises `InputError` for what no waiting mends.
        """

    def take(self) -> Arrival:
        """The next frame that is ready, in order of time."""


@contextmanager
def unheard() -> Iterator[None]:
    """What a reader says of a recording was said when it was first opened."""
    logger = logging.getLogger("pcnav")
    before, logger.disabled = logger.disabled, True
    try:
        yield
    finally:
        logger.disabled = before
