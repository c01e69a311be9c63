"""What a page shows of something that was clicked at."""

from dataclasses import dataclass

Rows = list[list[str]]


@dataclass(frozen=True)
class Card:
    """A title and rows of a name and what is known of it."""

    title: str
    rows: Rows
