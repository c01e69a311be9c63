"""How far a study has come, told in one count over all of its parts."""

from collections.abc import Callable

OnProgress = Callable[[int, int], None]
"""Told how many units of work are done, and of how many."""


class Progress:
    """Counts units of work; a unit is about as long everywhere in a study."""

    def __init__(self, total: int, on_progress: OnProgress) -> None:
        self._total, self._done, self._on_progress = total, 0.0, on_progress

    def add(self, units: float) -> None:
        """So much more is done."""
        self._done += units
        self._on_progress(min(round(self._done), self._total), self._total)
