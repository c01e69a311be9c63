"""From the records of a batch to its tables: read, group, count, write; nothing is run."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
import pandas as pd

from pcnav.batch.figures import SweepFigure, figures
from pcnav.batch.metrics import METRICS, SETTLED, EvaluationWindow, Family, Metric
from pcnav.batch.pages import TabulatedBatch, TitledTables, document_of, page_of
from pcnav.batch.record import RunRecord
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
from pcnav.files.new_folder import new_folder
from pcnav.files.text_table import TextTable, display_unit, number

TABLES_FOLDER = "tables"
"""Inside the folder of a batch."""
INDEX_FILE = "index.html"
DOCUMENT_FILE = "index.md"
_FIGURES_FOLDER = "figures"
_NOT_EVERYONES = {Family.CONSISTENCY, Family.BOUND}
"""What only a filter has: rows without any number say nothing there."""
_OF_SOME = ("states", "model", "errors", "errors_pooled", "bop", "bop_pooled", "trajectory")
"""Keys of tables of what only some estimators estimate, and of what only some recordings tell."""
_KEPT_BYTES = 200_000_000
_PANELS = 2
"""Metrics drawn side by side in a figure."""


@dataclass(frozen=True)
class TableSummary:
    """What the command line shows of a batch that was tabulated."""

    tables: tuple[TextTable, ...]
    """The first table, or the pivot asked for."""
    page: Path
    runs: int
    failures: tuple[RunRecord, ...]
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
    failures = tuple(header for header in headers if header.failure)
    folder = store.folder / TABLES_FOLDER if out is None else out
    with new_folder(folder, overwrite or out is None, INDEX_FILE) as staging:
        tables = []
        for k, layout in enumerate(layouts):
            on_progress(k, len(layouts) + 1)
            tables += _written(staging, layout, pivot(layout, runs, read, window), window)
        on_progress(len(layouts), len(layouts) + 1)
        drawings = figures(runs, read, drawn, window)
        _write_drawings(staging, drawings)
        _write_failures(staging, failures)
        batch = TabulatedBatch(store, headers, tables, [each.drawing for each in drawings])
        (staging / INDEX_FILE).write_text(page_of(batch, window), encoding="utf-8")
        (staging / DOCUMENT_FILE).write_text(document_of(batch), encoding="utf-8")
    return TableSummary(
        tables[0].tables, folder / INDEX_FILE, len(runs), failures, len(store.missing)
    )


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
) -> list[TitledTables]:
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
    return [TitledTables(layout.title, tables)]


def _write_drawings(staging: Path, drawings: Sequence[SweepFigure]) -> None:
    if drawings:
        (staging / _FIGURES_FOLDER).mkdir()
    for each in drawings:
        (staging / _FIGURES_FOLDER / f"{each.key}.svg").write_bytes(each.drawing.svg)


def _write_failures(staging: Path, failures: Sequence[RunRecord]) -> None:
    if failures:
        rows = tuple((str(each.run), each.failure or "", each.command) for each in failures)
        header = ("run", "message", "repeat")
        table = TextTable("failures", "Failed runs", header, rows, text_columns=3)
        (staging / "failures.csv").write_text(table.to_csv(), encoding="utf-8")
        (staging / "failures.md").write_text(table.to_markdown(), encoding="utf-8")
