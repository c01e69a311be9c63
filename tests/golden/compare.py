"""Number by number: what was recorded against what the code writes today."""

import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from fnmatch import fnmatchcase

from tests.golden.changes import EXPLAINED, RENAMED, REWORDED, Explained
from tests.golden.contents import MEAN, RMS, TEXT, TIME, Contents, Table, number

_NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")


@dataclass(frozen=True)
class Difference:
    """A column that differs by more than it may."""

    place: str
    """case/output/file/column, by today's names."""
    what: str


@dataclass(frozen=True)
class Comparison:
    """Of one case."""

    differences: tuple[Difference, ...]
    largest: float
    """Relative, of all that is within its tolerance; 0 when every digit is the same."""

    def __str__(self) -> str:
        if not self.differences:
            return "same" if self.largest == 0.0 else f"same to {self.largest:.0e}"
        lines = (f"    {difference.place}: {difference.what}" for difference in self.differences)
        return "\n".join((f"{len(self.differences)} columns differ", *lines))


def compare(
    case: str,
    recorded: Contents,
    today: Contents,
    renamed: Mapping[str, str] = RENAMED,
    reworded: Mapping[str, str] = REWORDED,
    explained: Mapping[str, Explained] = EXPLAINED,
) -> Comparison:
    """Compare every cell of a case's tables."""
    differences: list[Difference] = []
    largest = 0.0
    before = {_new_name(name, renamed): table for name, table in recorded.items()}
    for name in sorted(before.keys() | today.keys()):
        old, new = before.get(name, {}), today.get(name, {})
        floors = _floors(old)
        old = {
            _new_name(column, renamed): [_new_words(text, reworded) for text in cells]
            for column, cells in old.items()
        }
        floors = {_new_name(column, renamed): floor for column, floor in floors.items()}
        whole = _table_difference(old, new)
        if whole:
            place = f"{case}/{name}"
            if not math.isinf(_allowed(f"{place}/*", explained).relative):
                differences.append(Difference(place, whole))
            continue
        for column in (*old, *(column for column in new if column not in old)):
            place = f"{case}/{name}/{column}"
            allowed = _allowed(place, explained)
            if math.isinf(allowed.relative):
                continue
            found = _column_difference(column, old, new, allowed, floors.get(column, 0.0))
            if found.what:
                differences.append(Difference(place, found.what))
            else:
                largest = max(largest, found.largest)
    return Comparison(tuple(differences), largest)


def _floors(table: Table) -> dict[str, float]:
    """Magnitudes of columns that the tolerance is relative to besides that of each number."""
    # What is told over time has one unit a column; the rows of other tables may be of any.
    if next(iter(table), None) == TIME:
        return {
            column: max(map(abs, _numbers(cells)), default=0.0) for column, cells in table.items()
        }
    # The mean of numbers of both signs may be much smaller than what it is the mean of.
    sizes = {column: table.get(column.removesuffix(MEAN) + RMS, []) for column in table}
    return {column: max(_numbers(cells), default=0.0) for column, cells in sizes.items()}


def _new_name(name: str, renamed: Mapping[str, str]) -> str:
    """Today's name of a file, column or key: of the whole, of its beginning, or of its parts."""
    folder, slash, last = name.rpartition("/")
    if slash:
        return _new_name(folder, renamed) + slash + _new_name(last, renamed)
    for old, new in renamed.items():
        if name == old or name.startswith(f"{old}."):
            return new + name.removeprefix(old)
    return ".".join(renamed.get(part, part) for part in name.split("."))


def _new_words(text: str, reworded: Mapping[str, str]) -> str:
    for old, new in reworded.items():
        # Not as a pattern: new words may hold a backslash.
        text = new.join(re.split(rf"(?<!\w){re.escape(old)}(?!\w)", text))
    return text


def _allowed(place: str, explained: Mapping[str, Explained]) -> Explained:
    fitting = (allowed for pattern, allowed in explained.items() if fnmatchcase(place, pattern))
    return next(fitting, Explained("nothing may change"))


def _table_difference(old: Table, new: Table) -> str:
    """What differs about a table as a whole, in words."""
    if not new:
        return "gone"
    if not old:
        return "new"
    before, after = (len(next(iter(table.values()))) for table in (old, new))
    # Of printed text the first line that differs tells more than how many there are.
    return f"{after} rows, were {before}" if before != after and TEXT not in old else ""


@dataclass(frozen=True)
class _Found:
    """In a column."""

    what: str
    """Words for a difference beyond what is allowed."""
    largest: float
    """Relative difference."""


def _column_difference(
    column: str, old: Table, new: Table, allowed: Explained, magnitude: float
) -> _Found:
    if column not in new or column not in old:
        return _Found("gone" if column in old else "new", math.inf)
    floor = allowed.absolute + allowed.relative * magnitude
    rows = list(zip(old[column], new[column], strict=False))
    cells = [_cell_difference(a, b, allowed.relative, floor) for a, b in rows]
    beyond = [row for row, (_, is_within) in enumerate(cells) if not is_within]
    largest = max((size for size, _ in cells), default=0.0)
    if beyond:
        first = "{!r} -> {!r}".format(*rows[beyond[0]])
        by = "words" if math.isinf(largest) else f"{largest:.1e}"
        where = f"in {len(beyond)} of {len(rows)} rows" if len(rows) > 1 else ""
        return _Found(f"{by} {where}; row {beyond[0] + 1}: {first}", largest)
    if len(old[column]) != len(new[column]):
        return _Found(f"{len(new[column])} lines, were {len(old[column])}", math.inf)
    return _Found("", largest)


def _numbers(cells: Iterable[str]) -> Iterable[float]:
    return (value for value in map(number, cells) if value is not None)


def _cell_difference(a: str, b: str, relative: float, floor: float) -> tuple[float, bool]:
    """The largest relative difference of the numbers in two cells, and whether it may be.

    A cell may hold several numbers among words; the words must be the same.
    """
    if a == b:
        return 0.0, True
    if _NUMBER.split(a) != _NUMBER.split(b):
        return math.inf, False
    largest, is_within = 0.0, True
    for left, right in zip(_NUMBER.findall(a), _NUMBER.findall(b), strict=True):
        x, y = float(left), float(right)
        gap, scale = abs(x - y), max(abs(x), abs(y))
        is_within &= gap <= relative * scale + floor
        largest = max(largest, gap / scale if scale else 0.0)
    return largest, is_within
