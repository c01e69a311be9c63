"""From the records of a batch to its tables: read, group, count, write; nothing is run."""

import shlex
import sys
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from datetime import date
from functools import lru_cache
from pathlib import Path

import numpy as np
import pandas as pd

from pcnav.batch.axes import ESTIMATOR_AXIS
from pcnav.batch.figures import Drawing, figures
from pcnav.batch.metrics import METRICS, Family, Metric
from pcnav.batch.record import RunRecord
from pcnav.batch.samples import SETTLED, EvaluationWindow
from pcnav.batch.standard_tables import (
    PIVOT,
    STANDARD,
    STATISTICS,
    Measured,
    Wanted,
    asked_layout,
    default_layouts,
    default_metrics,
    statistics_layout,
)
from pcnav.batch.statistics import cell_of
from pcnav.batch.store import RunStore
from pcnav.batch.tables import (
    RUN,
    ReadRun,
    TableLayout,
    csv_text,
    metric_label,
    pivot,
    run_table,
    text_tables,
    with_numbers,
    without_empty_rows,
)
from pcnav.core.errors import InputError
from pcnav.estimators.interface import FirstPose
from pcnav.files.new_folder import new_folder
from pcnav.files.text_table import TextTable, display_unit, number
from pcnav.report.page import render

TABLES_FOLDER = "tables"
"""Inside the folder of a batch."""
INDEX_FILE = "index.html"
DOCUMENT_FILE = "index.md"
_FIGURES_FOLDER = "figures"
_NOT_EVERYONES = {Family.CONSISTENCY, Family.BOUND}
"""What only a filter has: rows without any number say nothing there."""
_OF_SOME = ("states", "model")
"""Keys of tables of what only some estimators estimate."""
_KEPT_BYTES = 200_000_000
_PANELS = 2
"""Metrics drawn side by side in a figure."""
_MAX_FAILURES = 50
"""On the page; the file of failures has all."""


@dataclass(frozen=True)
class FailedRun:
    """A run without a result."""

    run: str
    message: str
    command: str
    """Repeats it alone."""


@dataclass(frozen=True)
class TableSummary:
    """What the command line shows of a batch that was tabulated."""

    tables: tuple[TextTable, ...]
    """The first table, or the pivot asked for."""
    page: Path
    runs: int
    failures: tuple[FailedRun, ...]
    unfinished: int


def tabulate(
    store: RunStore,
    out: Path | None = None,
    *,
    wanted: Wanted = STANDARD,
    window: EvaluationWindow = SETTLED,
    overwrite: bool = False,
    on_progress: Callable[[int, int], None] = lambda done, total: None,
) -> TableSummary:
    """Write all tables, figures and the page of a batch.

    Into ``out``, or into the folder ``tables`` of the batch, whose earlier content is replaced.
    Nothing is half-written. Raises `InputError` for an unknown axis or metric, for a batch without
    a finished run, and for a folder that must not be replaced or cannot be written.
    """
    headers = list(store.headers())
    if not headers:
        raise InputError(store.folder, "runs", "expected at least one finished run, found none")
    runs = run_table([header.run for header in headers])
    measured = {name for header in headers for name in header.columns}
    layouts, drawn = _plan(runs, measured, wanted, keep_standard=out is None)
    read = kept_records(store)
    _refuse_empty(window, (read(header.run) for header in headers if not header.failure))
    failed = [read(header.run) for header in headers if header.failure]
    failures = tuple(FailedRun(str(r.run), r.failure or "", r.command) for r in failed)
    folder = store.folder / TABLES_FOLDER if out is None else out
    with new_folder(folder, overwrite or out is None, INDEX_FILE) as staging:
        parts = []
        for k, layout in enumerate(layouts):
            on_progress(k, len(layouts) + 1)
            parts += _written(staging, layout, pivot(layout, runs, read, window), window)
        on_progress(len(layouts), len(layouts) + 1)
        drawings = figures(runs, read, drawn, window)
        _write_drawings(staging, drawings)
        _write_failures(staging, failures)
        shown = {
            "parts": parts,
            "drawings": drawings,
            "failures": failures,
            "window": window.text,
            "versions": headers[0].versions,
            **_facts(store, runs),
        }
        _write_pages(staging, shown)
    return TableSummary(parts[0][1], folder / INDEX_FILE, len(runs), failures, len(store.missing))


def kept_records(store: RunStore, max_bytes: int = _KEPT_BYTES) -> ReadRun:
    """Reads records, and keeps as many as fit: every table reads them all again."""
    # Numbers that are measured hardly shrink in a file.
    largest = max((path.stat().st_size for path in store.runs_folder.iterdir()), default=1)
    read = lru_cache(max_bytes // largest)(store.record)
    return lambda run: read(run.key)


def single_run_table(record: RunRecord, window: EvaluationWindow = SETTLED) -> TextTable:
    """The numbers of one run, metric by metric; of the percentiles none."""
    metrics = [metric for metric in METRICS.values() if metric.statistic.percent is None]
    cell = cell_of([record], metrics, window)
    rows = []
    for metric in metrics:
        found = cell.values[metric.name]
        if found.exists:
            scale, unit = display_unit(metric.unit, found.value)
            rows.append((metric_label(metric, unit), number(scale * found.value)))
    note = f"Errors over {window.text}."
    return TextTable("run", str(record.run), ("metric", "value"), tuple(rows), note)


def stacked(table: TextTable) -> TextTable:
    """The table with every number above its interval: side by side they would not fit."""
    rows = tuple(tuple(text.replace(" [", "\n[", 1) for text in row) for row in table.rows)
    return replace(table, rows=rows)


def _refuse_empty(window: EvaluationWindow, records: Iterable[RunRecord]) -> None:
    """Raise `InputError` for a window that no run reaches."""
    if window.from_s is None:
        return
    lengths = [float(np.ptp(r.numbers("time_s"))) if r.frames else 0.0 for r in records]
    if lengths and window.from_s > max(lengths):
        expected = f"expected at most {max(lengths):g} s, the longest run, got {window.from_s:g}"
        raise InputError("pcnav table", "--from", expected)


def _plan(
    runs: pd.DataFrame, measured: Measured, wanted: Wanted, keep_standard: bool
) -> tuple[tuple[TableLayout, ...], tuple[Metric, ...]]:
    """The tables to make, the one with everything last, and the metrics to draw.

    What is asked for comes first, before the tables that every batch keeps in its own folder.
    """
    standard, default = default_layouts(runs, measured), default_metrics(measured)
    if not wanted.anything:
        return (*standard, statistics_layout(runs)), default
    asked = asked_layout(wanted, runs, measured)
    drawable = [m for m in asked.metrics if m.quantity.family is Family.ERRORS]
    kept = standard if keep_standard else ()
    return (asked, *kept, statistics_layout(runs)), tuple(drawable[:_PANELS]) or default


def _written(
    staging: Path, layout: TableLayout, cells: pd.Series, window: EvaluationWindow
) -> list[tuple[str, tuple[TextTable, ...]]]:
    """Write one layout's files; its part of the page, none for the table for programs."""
    families = {metric.quantity.family for metric in layout.metrics}
    if layout.key in _OF_SOME or families <= _NOT_EVERYONES:
        cells = without_empty_rows(layout, cells)
        if cells.empty:
            return []
    if layout.key not in (STATISTICS, PIVOT):
        layout = with_numbers(layout, cells)
    path = staging / layout.key
    path.with_suffix(".csv").write_text(csv_text(layout, cells), encoding="utf-8")
    if layout.key == STATISTICS:
        return []
    tables = text_tables(layout, cells, window)
    markdown = "\n".join(each.to_markdown() for each in tables)
    path.with_suffix(".md").write_text(markdown, encoding="utf-8")
    latex = "\n".join(each.to_latex() for each in tables)
    path.with_suffix(".tex").write_text(latex, encoding="utf-8")
    return [(layout.title, tables)]


def _write_drawings(staging: Path, drawings: Sequence[Drawing]) -> None:
    if drawings:
        (staging / _FIGURES_FOLDER).mkdir()
    for drawing in drawings:
        (staging / _FIGURES_FOLDER / f"{drawing.key}.svg").write_bytes(drawing.svg)


def _write_failures(staging: Path, failures: Sequence[FailedRun]) -> None:
    if failures:
        rows = tuple((each.run, each.message, each.command) for each in failures)
        header = ("run", "message", "repeat")
        table = TextTable("failures", "Failed runs", header, rows, text_columns=3)
        (staging / "failures.csv").write_text(table.to_csv(), encoding="utf-8")
        (staging / "failures.md").write_text(table.to_markdown(), encoding="utf-8")


def _write_pages(staging: Path, shown: dict[str, object]) -> None:
    """The page for a browser, and the tables as one Markdown document for a project's own
    documentation, with the command that made them."""
    command = shlex.join([Path(sys.argv[0]).name, *sys.argv[1:]])
    for name, template in ((INDEX_FILE, "batch.html"), (DOCUMENT_FILE, "batch.md")):
        text = render(
            "pcnav.batch",
            template,
            **shown,
            command=command,
            day=date.today().isoformat(),
            max_failures=_MAX_FAILURES,
            stacked=stacked,
        )
        (staging / name).write_text(text, encoding="utf-8")


def _facts(store: RunStore, runs: pd.DataFrame) -> dict[str, object]:
    """What a batch is, apart from its numbers."""
    names = list(runs[ESTIMATOR_AXIS].cat.categories) if ESTIMATOR_AXIS in runs else []
    return {
        "title": f"Accuracy: {store.folder.name}",
        "runs": len(runs),
        "cases": runs[RUN].map(lambda run: run.case).nunique(),
        "unfinished": len(store.missing),
        "estimators": _estimators(names),
        "grid_toml": store.grid_toml,
    }


def _estimators(names: Sequence[str]) -> list[tuple[str, str, str]]:
    """Name, title and what is known of the first pose, of every estimator in a batch."""
    # They bring Open3D, which nothing else here needs.
    from pcnav.estimators.peers.icp import START_SHIFT_FRACTION, START_TURN_DEG
    from pcnav.estimators.registry import ESTIMATORS

    entries = {str(name): entry for name, entry in ESTIMATORS.items()}
    start = {
        FirstPose.NOTHING: "nothing",
        FirstPose.NEAR: f"the first pose, off by {START_TURN_DEG:g} deg and "
        f"{START_SHIFT_FRACTION:.0%} of the diameter",
        FirstPose.EXACT: "the first pose, exactly",
    }
    known = [(name, entries.get(name)) for name in names]
    return [
        (name, "", "") if entry is None else (name, entry.title, start[entry.first_pose])
        for name, entry in known
    ]
