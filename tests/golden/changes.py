"""What has changed on purpose since the golden data were recorded, in one place.

A change of a name, a word or a number that is meant is written down here, with its reason; the data
themselves are recorded anew (`python -m tests.golden --update`) only when a reader of the history
would want to see every number change.
"""

from collections.abc import Mapping
from dataclasses import dataclass

TOLERANCE = 1e-9
"""Relative. Of a column over time it is also relative to the column's largest magnitude, so that
rounding does not count where a state passes through zero."""


@dataclass(frozen=True)
class Explained:
    """A difference that is meant, and how far it may go."""

    reason: str
    relative: float = TOLERANCE
    """Largest relative difference; with ``math.inf`` anything may differ, come or go."""
    absolute: float = 0.0
    """Differences up to this do not count, in the unit of the column."""


RENAMED: Mapping[str, str] = {}
"""Old name to new name of files, of columns and of keys (or of parts between their dots)."""

REWORDED: Mapping[str, str] = {}
"""Old words to new words in cells and in what is printed."""

EXPLAINED: Mapping[str, Explained] = {}
"""Changes that are meant, by a pattern of case/output/file/column; the first that fits counts."""
