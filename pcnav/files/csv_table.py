"""Named columns of a CSV file, read in one pass without a Python object per number; written too."""

import csv
from array import array
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TextIO

import numpy as np

from pcnav.core.arrays import BoolArray, FloatArray, IntArray
from pcnav.core.errors import InputError
from pcnav.files.regular_file import require_regular


@dataclass(frozen=True)
class CsvTable:
    """The columns of a CSV file."""

    path: Path
    texts: dict[str, list[str]]
    values: dict[str, "array[float]"]
    """nan where the field is empty."""

    def words(self, column: str) -> tuple[str, ...]:
        """The column as text."""
        if column not in self.texts:
            raise InputError(self.path, "header", f"expected a column {column}")
        return tuple(self.texts[column])

    def numbers(self, names: tuple[str, ...]) -> FloatArray:
        """(n, len(names)) values, nan where the field is empty."""
        for name in names:
            if name not in self.values:
                raise InputError(self.path, "header", f"expected a column {name}")
        return np.column_stack([self.values[name] for name in names])

    def times(self) -> FloatArray:
        """(n,) the `time_s` column, which must have a finite number in every row."""
        time_s = self.numbers(("time_s",))[:, 0]
        self.require(np.isfinite(time_s), "expected a finite number", "time_s")
        return time_s

    def counts(self, column: str) -> IntArray:
        """(n,) whole numbers."""
        values = self.numbers((column,))[:, 0]
        bad = np.flatnonzero(~(np.isfinite(values) & (values == np.rint(values))))
        if bad.size:
            field = f"line {bad[0] + 2}, {column}"
            raise InputError(self.path, field, f"expected a whole number, got {values[bad[0]]}")
        return values.astype(np.intp)

    def require(self, good: BoolArray, expected: str, column: str = "") -> None:
        """Refuse the first row that is not good (n,). Raises `InputError`, which names its line."""
        if not good.all():
            line = f"line {int(np.argmin(good)) + 2}"
            raise InputError(self.path, f"{line}, {column}" if column else line, expected)

    def require_any(self) -> None:
        """Refuse a table without rows. Raises `InputError`."""
        if not any(self.values.values()) and not any(self.texts.values()):
            raise InputError(self.path, "rows", "expected at least one row")


def read_csv(
    path: Path, names: tuple[str, ...], texts: tuple[str, ...] = (), *, growing: bool = False
) -> CsvTable:
    """Columns of a CSV file, numbers but for ``texts``, read line by line; others are ignored.

    Of a file that is ``growing`` a last line that has not ended is left out. Raises `InputError`
    when the file is missing, damaged or lacks one of the columns ``names``.
    """
    table = CsvTable(
        path,
        {name: [] for name in names if name in texts},
        {name: array("d") for name in names if name not in texts},
    )
    with _opened(path) as lines:
        whole = (line for line in lines if line.endswith("\n"))
        rows = csv.reader(whole if growing else lines, strict=True)
        _fill(table, next(rows, []), enumerate(rows, start=2))
    return table


def write_csv(path: Path, columns: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
    """Write a table; numbers in full, so that they are read back as they are."""
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(columns)
        writer.writerows(rows)


def read_header(path: Path) -> tuple[str, ...]:
    """Names of the columns of a CSV file; none of an empty one. Raises `InputError`."""
    with _opened(path) as lines:
        return tuple(next(csv.reader(lines, strict=True), []))


@contextmanager
def _opened(path: Path) -> Iterator[TextIO]:
    """A CSV file, whose faults are told in one line."""
    require_regular(path)
    try:
        with path.open(encoding="utf-8", newline="") as file:
            yield file
    except OSError as error:
        raise InputError(path, "file", f"expected a readable file ({error.strerror})") from error
    except (UnicodeDecodeError, csv.Error) as error:
        raise InputError(path, "file", f"expected CSV text ({error})") from error


def _fill(table: CsvTable, header: list[str], rows: Iterable[tuple[int, list[str]]]) -> None:
    for name in (*table.texts, *table.values):
        if name not in header:
            raise InputError(table.path, "header", f"expected a column {name}")
    texts = [(column, header.index(name)) for name, column in table.texts.items()]
    values = [(name, column, header.index(name)) for name, column in table.values.items()]
    for line, row in rows:
        if len(row) != len(header):
            expected = f"expected {len(header)} fields, got {len(row)}"
            raise InputError(table.path, f"line {line}", expected)
        for texts_of, position in texts:
            texts_of.append(row[position])
        for name, numbers, position in values:
            text = row[position]
            try:
                numbers.append(float(text) if text else np.nan)
            except ValueError as error:
                field, expected = f"line {line}, {name}", f"expected a number, got {text!r}"
                raise InputError(table.path, field, expected) from error
