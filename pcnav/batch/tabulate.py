"""From the records of a batch to its tables: read, group, count, write; nothing is run."""

import shlex
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from datetime import date
from pathlib import Path

import numpy as np

from pcnav.batch.case import ESTIMATOR_AXIS, AxisValue, BatchRun
from pcnav.batch.document import batch_document
from pcnav.batch.figures import Drawing, figures
from pcnav.batch.formats import csv_text, metric_label, text_tables
from pcnav.batch.metrics import METRICS, Family, Metric, named_metrics
from pcnav.batch.page import BatchFacts, Failure, TablePart, batch_page, failures_table
from pcnav.batch.pivot import AxisOrder, Layout, PivotTable, pivot, without_empty_rows
from pcnav.batch.record import RunRecord
from pcnav.batch.samples import SETTLED, Window, numbers
from pcnav.batch.standard_tables import (
    DEFAULT_METRICS,
    STANDARD,
    STATISTICS,
    Wanted,
    asked_layout,
    default_layouts,
    statistics_layout,
)
from pcnav.batch.statistics import cell_statistics
from pcnav.batch.store import RunStore
from pcnav.core.errors import InputError
from pcnav.estimators.peers.interface import FirstPose
from pcnav.files.new_folder import new_folder
from pcnav.files.text_table import TextTable, display_unit, number

TABLES_FOLDER = "tables"
"""Inside the folder of a batch."""
INDEX_FILE = "index.html"
DOCUMENT_FILE = "index.md"
_FIGURES_FOLDER = "figures"
_NOT_EVERYONES = (Family.CONSISTENCY, Family.BOUND)
"""What only a filter has: rows without any number say nothing there."""
_STATES = "states"
_KEPT_BYTES = 200_000_000
_BYTES_A_NUMBER = 9
"""A column of words among fifty of numbers."""
_PANELS = 2
"""Metrics drawn side by side in a figure."""


@dataclass(frozen=True)
class TableSummary:
    """What the command line shows of a batch that was tabulated."""

    tables: tuple[TextTable, ...]
    """The first table, or the pivot asked for."""
    page: Path
    runs: int
    failures: tuple[Failure, ...]
    unfinished: int


def tabulate(
    store: RunStore,
    out: Path | None = None,
    *,
    wanted: Wanted = STANDARD,
    window: Window = SETTLED,
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
    runs = [header.run for header in headers]
    layouts, drawn = _plan(AxisOrder.of(runs), wanted, keep_standard=out is None)

    read = KeptRecords(store)
    _refuse_empty(window, [read(header.run) for header in headers if not header.failure])
    folder = store.folder / TABLES_FOLDER if out is None else out
    with new_folder(folder, overwrite or out is None, INDEX_FILE) as staging:
        parts = []
        for k, layout in enumerate(layouts):
            on_progress(k, len(layouts) + 1)
            table = pivot(layout, runs, read, window)
            parts += _written(staging, table, window)
        on_progress(len(layouts), len(layouts) + 1)
        drawings = figures(runs, read, drawn, window)
        _write_drawings(staging, drawings)
        facts = _facts(
            store, runs, [read(h.run) for h in headers if h.failure], headers[0].versions
        )
        _write_failures(staging, facts.failures)
        page = batch_page(facts, parts, drawings, window)
        (staging / INDEX_FILE).write_text(page, encoding="utf-8")
        command = shlex.join([Path(sys.argv[0]).name, *sys.argv[1:]])
        document = batch_document(facts, parts, command, date.today())
        (staging / DOCUMENT_FILE).write_text(document, encoding="utf-8")
    first = parts[0].tables
    return TableSummary(first, folder / INDEX_FILE, len(runs), facts.failures, len(store.missing))


class KeptRecords:
    """Reads records, and keeps as many of them as fit: every table reads them all again."""

    def __init__(self, store: RunStore, max_bytes: int = _KEPT_BYTES) -> None:
        self._store = store
        self._left = max_bytes
        self._kept: dict[str, RunRecord] = {}

    def __call__(self, run: BatchRun) -> RunRecord:
        """The record of a run."""
        found = self._kept.get(run.key)
        if found is not None:
            return found
        record = self._store.record(run.key)
        size = _BYTES_A_NUMBER * record.frames * len(record.columns)
        if size <= self._left:
            self._left -= size
            self._kept[run.key] = record
        return record


def run_table(record: RunRecord, window: Window = SETTLED) -> TextTable:
    """The numbers of one run, metric by metric; of the percentiles none."""
    metrics = [metric for metric in METRICS.values() if metric.statistic.percent is None]
    cell = cell_statistics([record], metrics, window)
    rows = []
    for metric in metrics:
        estimate = cell.estimates[metric.name]
        if estimate.exists:
            scale, unit = display_unit(metric.unit, estimate.value)
            rows.append((metric_label(metric, unit), number(scale * estimate.value)))
    note = f"Errors over {window.text}."
    return TextTable("run", str(record.run), ("metric", "value"), tuple(rows), note)


def _refuse_empty(window: Window, records: Sequence[RunRecord]) -> None:
    """Raise `InputError` for a window that no run reaches."""
    if window.from_s is None or not records:
        return
    longest = max(
        float(np.ptp(numbers(record, "time_s"))) if record.frames else 0.0 for record in records
    )
    if window.from_s > longest:
        expected = f"expected at most {longest:g} s, the longest run, got {window.from_s:g}"
        raise InputError("pcnav table", "--from", expected)


def _plan(
    order: AxisOrder, wanted: Wanted, keep_standard: bool
) -> tuple[tuple[Layout, ...], tuple[Metric, ...]]:
    """The tables to make, the one with everything last, and the metrics to draw.

    What is asked for comes first, before the tables that every batch keeps in its own folder.
    """
    if wanted.anything:
        asked = asked_layout(wanted, order)
        drawable = [m for m in asked.metrics if m.quantity.family is Family.ERRORS]
        drawn = tuple(drawable[:_PANELS]) or named_metrics(DEFAULT_METRICS)
        standard = default_layouts(order) if keep_standard else ()
        return (asked, *standard, statistics_layout(order)), drawn
    return (*default_layouts(order), statistics_layout(order)), named_metrics(DEFAULT_METRICS)


def _written(staging: Path, table: PivotTable, window: Window) -> list[TablePart]:
    """Write one layout's files; its part of the page, none for the table for programs."""
    layout = table.layout
    families = {metric.quantity.family for metric in layout.metrics}
    if layout.key == _STATES or families <= set(_NOT_EVERYONES):
        table = without_empty_rows(table)
        if not table.rows:
            return []
    path = staging / layout.key
    path.with_suffix(".csv").write_text(csv_text(table), encoding="utf-8")
    if layout.key == STATISTICS:
        return []
    tables = text_tables(table, window)
    markdown = "\n".join(each.to_markdown() for each in tables)
    path.with_suffix(".md").write_text(markdown, encoding="utf-8")
    latex = "\n".join(each.to_latex() for each in tables)
    path.with_suffix(".tex").write_text(latex, encoding="utf-8")
    return [TablePart(layout.title, tables)]


def _write_drawings(staging: Path, drawings: Sequence[Drawing]) -> None:
    if drawings:
        (staging / _FIGURES_FOLDER).mkdir()
    for drawing in drawings:
        (staging / _FIGURES_FOLDER / f"{drawing.key}.svg").write_bytes(drawing.svg)


def _write_failures(staging: Path, failures: Sequence[Failure]) -> None:
    if failures:
        table, path = failures_table(failures), staging / "failures"
        path.with_suffix(".csv").write_text(table.to_csv(), encoding="utf-8")
        path.with_suffix(".md").write_text(table.to_markdown(), encoding="utf-8")


def _facts(
    store: RunStore,
    runs: Sequence[BatchRun],
    failed: Sequence[RunRecord],
    versions: Mapping[str, str],
) -> BatchFacts:
    values = AxisOrder.of(runs).values
    return BatchFacts(
        name=store.folder.name,
        runs=len(runs),
        unfinished=len(store.missing),
        cases=len({run.case for run in runs}),
        estimators=_estimators(values.get(ESTIMATOR_AXIS, ())),
        failures=tuple(Failure(str(r.run), r.failure or "", r.command) for r in failed),
        versions=versions,
        grid_toml=store.grid_toml,
    )


def _estimators(names: Sequence[AxisValue]) -> tuple[tuple[str, str, str], ...]:
    """Name, title and what is told of the first pose, of every estimator in a batch."""
    # They bring Open3D, which nothing else here needs.
    from pcnav.estimators.peers.icp import START_SHIFT_FRACTION, START_TURN_DEG
    from pcnav.estimators.registry import ESTIMATORS

    known = {str(name): entry for name, entry in ESTIMATORS.items()}
    told = {
        FirstPose.NOTHING: "nothing",
        FirstPose.NEAR: f"the first pose, off by {START_TURN_DEG:g} deg and "
        f"{START_SHIFT_FRACTION:.0%} of the diameter",
        FirstPose.EXACT: "the first pose, exactly",
    }
    rows = ((str(name), known.get(str(name))) for name in names)
    return tuple(
        (name, "", "") if entry is None else (name, entry.title, told[entry.first_pose])
        for name, entry in rows
    )
