"""The one page of a batch: what was run, tables, figures, failures and how to repeat them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from pcnav.batch.figures import Drawing
from pcnav.batch.samples import Window
from pcnav.files.text_table import TextTable
from pcnav.report import page

_MAX_FAILURES = 50
"""Told on the page; the file of failures has all."""


@dataclass(frozen=True)
class Failure:
    """A run without a result."""

    run: str
    message: str
    command: str
    """Repeats it alone."""


@dataclass(frozen=True)
class BatchFacts:
    """What a batch is, apart from its numbers."""

    name: str
    """Of its folder."""
    runs: int
    unfinished: int
    cases: int
    estimators: tuple[tuple[str, str, str], ...]
    """Name, title, and what each is told of the first pose."""
    failures: tuple[Failure, ...]
    versions: Mapping[str, str]
    grid_toml: str


@dataclass(frozen=True)
class TablePart:
    """A part of the page: the tables of one layout."""

    title: str
    tables: tuple[TextTable, ...]


def batch_page(
    facts: BatchFacts, parts: Sequence[TablePart], drawings: Sequence[Drawing], window: Window
) -> str:
    """The whole document, with everything it shows inside it."""
    body = [page.heading(f"Accuracy: {facts.name}", _lead(facts)), page.cards(_cards(facts))]
    body.append(page.section("How to read it", *_reading(facts, window)))
    first, *others = parts
    body.append(_part(first))
    if drawings:
        drawn = [page.image(d.title, d.caption, "image/svg+xml", d.svg) for d in drawings]
        # An empty place keeps a figure alone from filling the page.
        alone = [page.stack([])] if len(drawn) == 1 else []
        body.append(page.section("Errors along the axes", page.grid([*drawn, *alone])))
    body += [_part(part) for part in others]
    body.append(page.section("Failures", *_failures(facts)))
    made = [page.preformatted(facts.grid_toml), page.settings({"versions": dict(facts.versions)})]
    body.append(page.section("The grid as run", *made))
    return page.page(f"Accuracy: {facts.name}", body)


def failures_table(failures: Sequence[Failure]) -> TextTable:
    """Every failed run with its message and what repeats it."""
    rows = tuple((each.run, each.message, each.command) for each in failures)
    return TextTable("failures", "Failed runs", ("run", "message", "repeat"), rows, text_columns=3)


def _lead(facts: BatchFacts) -> str:
    text = f"{facts.runs} runs of {facts.cases} cases"
    if facts.unfinished:
        text += f"; {facts.unfinished} more runs of the grid are not finished"
    return text


def _cards(facts: BatchFacts) -> list[tuple[str, str]]:
    cards = [
        ("runs", str(facts.runs)),
        ("failed", str(len(facts.failures))),
        ("cases", str(facts.cases)),
    ]
    if len(facts.estimators) > 1:
        cards.append(("estimators", str(len(facts.estimators))))
    if facts.unfinished:
        cards.append(("runs not finished", str(facts.unfinished)))
    return [*cards, ("version of pcnav", facts.versions.get("pcnav", "unknown"))]


def _reading(facts: BatchFacts, window: Window) -> list[str]:
    pieces = [page.paragraph(text) for text in _method(window)]
    if facts.estimators:
        header = ("estimator", "what it is", "is told of the pose")
        pieces.append(page.table(header, facts.estimators, text_columns=3))
    return pieces


def _method(window: Window) -> tuple[str, ...]:
    return (
        f"Errors are pooled over the frames of the {window.text} and over the runs of a cell; the "
        "time to lock and what happens before are numbers of their own.",
        "A frame without a pose has no error and a failed run has none either: read an error "
        "beside the share of frames with a pose and the number of failed runs.",
        "Confidence intervals are 95 %. They draw whole runs again, within their case where a cell "
        "pools several, because the frames of one run are not independent, and take Student's t "
        "for so many runs. A maximum has none, because no draw can exceed it, nor has a number in "
        "which all runs agree.",
    )


def _part(part: TablePart) -> str:
    pieces = []
    for table in part.tables:
        rows = stacked(table).rows
        title = [page.subheading(table.title)] if table.title != part.title else []
        pieces += [*title, page.table(table.header, rows, table.text_columns)]
    note = part.tables[-1].note if part.tables else ""
    return page.section(part.title, *pieces, *([page.paragraph(note)] if note else []))


def stacked(table: TextTable) -> TextTable:
    """The table with every number above its interval: side by side they would not fit."""
    rows = tuple(tuple(text.replace(" [", "\n[", 1) for text in row) for row in table.rows)
    return replace(table, rows=rows)


def _failures(facts: BatchFacts) -> list[str]:
    if not facts.failures:
        return [page.paragraph("None: every run that was finished has a result.")]
    pieces = []
    for failure in facts.failures[:_MAX_FAILURES]:
        pieces += [page.paragraph(f"{failure.run}: {failure.message}")]
        pieces += [page.preformatted(failure.command)]
    if len(facts.failures) > _MAX_FAILURES:
        more = len(facts.failures) - _MAX_FAILURES
        pieces.append(page.paragraph(f"{more} more are in failures.csv."))
    return [page.stack(pieces)]
