"""A table of a study: one value that is written as CSV, as Markdown and on the terminal."""

import csv
import io
from dataclasses import dataclass

from rich.box import SIMPLE_HEAD
from rich.markup import escape
from rich.table import Table


@dataclass(frozen=True)
class StudyTable:
    """Finished text in rows and columns."""

    key: str
    """Name of its files, without a suffix."""
    title: str
    header: tuple[str, ...]
    """Column names with units."""
    rows: tuple[tuple[str, ...], ...]
    note: str = ""
    """What has to be known to read it."""
    text_columns: int = 1
    """How many of the first columns hold words; the others hold numbers."""

    def __post_init__(self) -> None:
        if any(len(row) != len(self.header) for row in self.rows):
            raise ValueError(f"{self.key}: rows and header differ in length")

    def to_csv(self) -> str:
        """Header and rows, comma separated."""
        stream = io.StringIO()
        csv.writer(stream, lineterminator="\n").writerows([self.header, *self.rows])
        return stream.getvalue()

    def to_markdown(self) -> str:
        """Title, table and note."""
        rule = ["---"] * self.text_columns + ["---:"] * (len(self.header) - self.text_columns)
        lines = [self.header, tuple(rule), *self.rows]
        cells = [" | ".join(text.replace("|", "\\|") for text in line) for line in lines]
        table = "\n".join(f"| {row} |" for row in cells)
        return f"### {self.title}\n\n{table}\n" + (f"\n{self.note}\n" if self.note else "")

    def to_rich(self) -> Table:
        """For the terminal."""
        table = Table(box=SIMPLE_HEAD, title=escape(self.title), title_justify="left")
        table.caption, table.caption_justify = escape(self.note), "left"
        for k, name in enumerate(self.header):
            table.add_column(escape(name), justify="left" if k < self.text_columns else "right")
        for row in self.rows:
            table.add_row(*(escape(text) for text in row))
        return table
