"""Where the stories come from: runs that are finished, or one that goes on."""

from dataclasses import dataclass
from typing import Protocol

from pcnav.viewer.story import Story


@dataclass(frozen=True)
class Edition:
    """The stories as of now."""

    stories: tuple[Story, ...]
    number: int
    """Grows with every change."""
    is_live: bool
    """Whether more frames are to come."""


class Source(Protocol):
    """Gives the newest edition at any time, to any thread."""

    @property
    def edition(self) -> Edition: ...


class FinishedRuns:
    """Runs that do not change."""

    def __init__(self, stories: tuple[Story, ...]) -> None:
        self._edition = Edition(stories, 0, is_live=False)

    @property
    def edition(self) -> Edition:
        """Always the same."""
        return self._edition
