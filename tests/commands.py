"""What a command line answers."""

from collections.abc import Callable
from typing import NamedTuple


class Answer(NamedTuple):
    """What a command said."""

    code: int
    out: str
    err: str

    @property
    def error_lines(self) -> list[str]:
        """Lines on stderr but those that tell how a run goes."""
        return [line for line in self.err.splitlines() if not line.startswith("INFO: frame ")]


PATIENCE_S = 300.0
"""What a test waits for another process at most: machines may be busy."""

Pcnav = Callable[..., Answer]
"""Calls the entry point with arguments."""
