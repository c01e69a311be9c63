"""Tables of the studies: records become cells, claims become a verdict."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from numbers import Integral, Real
from typing import TypeVar

import numpy as np

from pcnav.core.arrays import BoolArray
from pcnav.core.statistics import NONE, MeanSquared
from pcnav.files.text_table import TextTable, number

Record = TypeVar("Record")


def cell(value: object) -> str:
    """A value as a table shows it.

    Text as it is, counts in full, other numbers to three digits, yes or no, several values with
    strokes between them; ``-`` for None, nan and an empty text.
    """
    if isinstance(value, bool | np.bool_):
        return "yes" if value else "no"
    if isinstance(value, Integral):
        return str(int(value))
    if isinstance(value, Real):
        return number(float(value))
    if isinstance(value, np.ndarray) and value.ndim == 0:
        return cell(value.item())
    if isinstance(value, tuple | list | np.ndarray):
        return " / ".join(cell(each) for each in value)
    return NONE if value is None or value == "" else str(value)


def table(
    key: str, header: Sequence[str], rows: Iterable[Sequence[object]], text_columns: int = 1
) -> TextTable:
    """A table of rows of values, titled by the text of the study.

    One without rows says so in its only row.
    """
    texts = tuple(tuple(cell(value) for value in row) for row in rows)
    empty = ("none", *[NONE] * (len(header) - 1))
    return TextTable(key, "", tuple(header), texts or (empty,), text_columns=text_columns)


def table_of(
    key: str,
    records: Iterable[Record],
    columns: Mapping[str, Callable[[Record], object]],
    text_columns: int = 1,
) -> TextTable:
    """A table with a row for every record; each column is a heading, with unit, and its value."""
    rows = ([value(record) for value in columns.values()] for record in records)
    return table(key, tuple(columns), rows, text_columns)


def marked_frames(marked: Callable[[Record], BoolArray]) -> dict[str, Callable[[Record], object]]:
    """Columns that say how many frames of a run are marked, the first and the last of them."""
    return {
        "frames": lambda each: np.count_nonzero(marked(each)),
        "first": lambda each: np.flatnonzero(marked(each))[0],
        "last": lambda each: np.flatnonzero(marked(each))[-1],
    }


@dataclass(frozen=True)
class Claim:
    """One line of a verdict: what was expected, what was found, and whether that will do."""

    source: str
    """Chapter or figure that it is of."""
    quantity: str
    expected: object
    ours: object
    """Both as cells of a table."""
    met: bool


def at_most(source: str, quantity: str, values: Sequence[float], bound: float) -> Claim:
    """Numbers that must not exceed a bound; the largest is shown, nan does not meet it."""
    met = all(value <= bound for value in values)
    return Claim(source, quantity, f"<= {bound:g}", _largest(values), met)


def below(source: str, quantity: str, values: Sequence[float], bound: float) -> Claim:
    """Numbers that must stay below a bound, likewise."""
    met = all(value < bound for value in values)
    return Claim(source, quantity, f"< {bound:g}", _largest(values), met)


def _largest(values: Sequence[float]) -> float | None:
    return max((value for value in values if np.isfinite(value)), default=None)


def never(source: str, quantity: str, count: int) -> Claim:
    """Something that must not happen."""
    return Claim(source, quantity, 0, count, count == 0)


def always(source: str, quantity: str, are_so: Sequence[bool]) -> Claim:
    """Something that must be so in every run."""
    return Claim(source, quantity, "all", f"{sum(are_so)} of {len(are_so)}", all(are_so))


def inside(source: str, quantity: str, judged: MeanSquared) -> Claim:
    """A mean of squared normalised errors that must be inside its bounds."""
    return Claim(source, quantity, judged.bounds, judged.mean, judged.verdict == "inside")


def as_printed(source: str, quantity: str, printed: float, ours: float) -> Claim:
    """A number that must be no larger than the printed one."""
    return Claim(source, quantity, printed, ours, bool(ours <= printed))


def verdict(claims: Sequence[Claim], source: str, expected: str) -> TextTable:
    """The table of all claims, whose first and third columns are called as given."""
    return table_of(
        "verdict",
        claims,
        {
            source: lambda claim: claim.source,
            "quantity": lambda claim: claim.quantity,
            expected: lambda claim: claim.expected,
            "ours": lambda claim: claim.ours,
            "met": lambda claim: claim.met,
        },
        text_columns=2,
    )
