"""Numbers as people read them, and a table of them as CSV, Markdown, LaTeX or in a terminal."""

import csv
import io
import math
import re
from dataclasses import dataclass

from rich.box import SIMPLE_HEAD
from rich.markup import escape
from rich.table import Table

_LATEX = {
    "\\": r"\textbackslash{}",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    "<": r"\textless{}",
    ">": r"\textgreater{}",
    "|": r"\textbar{}",
    **{mark: f"\\{mark}" for mark in "&%$#_{}"},
}
_MAX_FLOAT = 40
"""Rows that fit on one page; a longer table has to break across pages."""
_THOUSANDTH = {"m": "mm", "m/s": "mm/s"}
MISSING = "-"
"""Where there is no number."""


@dataclass(frozen=True)
class TextTable:
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

    def to_latex(self) -> str:
        """A table for a document that loads ``booktabs``, and ``longtable`` for many rows."""
        kinds = "l" * self.text_columns + "r" * (len(self.header) - self.text_columns)
        head = f"{_latex_row(self.header)}\n\\midrule"
        body = "\n".join(_latex_row(row) for row in self.rows)
        title, label = latex_text(self.title), f"\\label{{tab:{_label(self.key)}}}"
        note = f"\n\n\\smallskip\n{latex_text(self.note)}" if self.note else ""
        if len(self.rows) > _MAX_FLOAT:
            start = f"\\begin{{longtable}}{{{kinds}}}\n\\caption{{{title}}}{label}\\\\"
            lines = [start, "\\toprule", head, "\\endhead", "\\bottomrule", "\\endfoot", body]
            return "\n".join([*lines, "\\end{longtable}"]) + note + "\n"
        table = f"\\begin{{tabular}}{{{kinds}}}\n\\toprule\n{head}\n{body}\n\\bottomrule"
        whole = f"\\begin{{table}}\n\\centering\n\\caption{{{title}}}{label}\n{table}"
        return f"{whole}\n\\end{{tabular}}{note}\n\\end{{table}}\n"

    def to_rich(self) -> Table:
        """For the terminal."""
        table = Table(box=SIMPLE_HEAD, title=escape(self.title), title_justify="left")
        table.caption, table.caption_justify = escape(self.note), "left"
        for k, name in enumerate(self.header):
            table.add_column(escape(name), justify="left" if k < self.text_columns else "right")
        for row in self.rows:
            table.add_row(*(escape(text) for text in row))
        return table


def display_unit(unit: str, typical: float) -> tuple[float, str]:
    """Factor and unit to show a quantity in: thousandths when it is below a tenth of its unit."""
    if unit in _THOUSANDTH and typical < 0.1:
        return 1e3, _THOUSANDTH[unit]
    return 1.0, unit


def number(value: float) -> str:
    """Three significant digits without an exponent where that stays readable."""
    if not math.isfinite(value):
        return MISSING
    if value == 0.0 or 1e-4 <= abs(value) < 1e6:
        decimals = 2 - math.floor(math.log10(abs(value))) if value else 0
        return f"{value:.{max(decimals, 0)}f}"
    return f"{value:.2e}"


def latex_text(text: str) -> str:
    """Text that LaTeX prints as it is."""
    return "".join(_LATEX.get(mark, mark) for mark in text)


def _latex_row(row: tuple[str, ...]) -> str:
    # A bracket at the start of a row would be read as an argument of the row before it.
    return " & ".join(f"{{{latex_text(text)}}}" for text in row) + r" \\"


def _label(key: str) -> str:
    return re.sub(r"[^a-z0-9]+", "-", key.lower()).strip("-")
