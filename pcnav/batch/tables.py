"""Tables of a batch: its runs grouped by some axes, the numbers of each group, and their texts.

Cases that differ only in axes a table does not show are pooled in one cell.
"""

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd

from pcnav.batch.axes import (
    ESTIMATOR_AXIS,
    AxisValue,
    GridRun,
    axis_label,
    axis_setting,
    scenario_of,
    shown_value,
)
from pcnav.batch.metrics import EvaluationWindow, Family, Metric
from pcnav.batch.record import RunRecord
from pcnav.batch.statistics import Bounds, Cell, MetricValue, cell_of
from pcnav.files.text_table import MISSING, TextTable, display_unit, number

RUN, SCENARIO = "run", "scenario"
"""Columns of a `run_table` beside the axes: the run itself, and what all estimators met."""
_MAX_AXES = 4
"""More columns of axes, most of them the same from row to row, would hide what a row is about."""
_MAX_FACTOR = 1000.0
"""An interval whose ends lie farther apart, as a factor, says nothing in a table."""

ReadRun = Callable[[GridRun], RunRecord]
"""Reads the record of a run."""


@dataclass(frozen=True)
class TableLayout:
    """What a table shows, and where."""

    key: str
    """Name of its files, without a suffix."""
    title: str
    rows: tuple[str, ...]
    """Axes; each combination of their values that was run is a row."""
    columns: tuple[str, ...]
    """Axes, likewise. Without any, the metrics stand side by side in one table; with some, each
    metric has a table of its own."""
    metrics: tuple[Metric, ...]
    shared: bool = False
    """Whether only cases enter that the estimators have in common, see `shared_runs`: rows that
    pool other cases cannot be compared."""


def run_table(runs: Sequence[GridRun]) -> pd.DataFrame:
    """A row a run: its axes, each in the order in which its values are shown, and `RUN`.

    Numbers are shown rising, words as they come in the batch.
    """
    table = pd.DataFrame([dict(run.case.settings) for run in runs], dtype=object)
    for axis in table:
        values = table[axis].unique().tolist()
        numbers = sorted(value for value in values if not isinstance(value, str))
        words = [value for value in values if isinstance(value, str)]
        table[axis] = pd.Categorical(table[axis], [*numbers, *words], ordered=True)
    table[RUN] = pd.Series(list(runs), dtype=object)
    table[SCENARIO] = [scenario_of(run.case) for run in runs]
    return table


def axes_of(runs: pd.DataFrame) -> tuple[str, ...]:
    """The axes of a `run_table`."""
    return tuple(str(name) for name in runs if name not in (RUN, SCENARIO))


def varying_axes(runs: pd.DataFrame) -> tuple[str, ...]:
    """The axes on which cases differ."""
    return tuple(axis for axis in axes_of(runs) if runs[axis].nunique() > 1)


def shared_runs(runs: pd.DataFrame) -> pd.DataFrame:
    """The runs of the estimators that met at least half of all scenarios, of those scenarios that
    all of these estimators met."""
    if ESTIMATOR_AXIS not in runs:
        return runs
    met = pd.crosstab(runs[SCENARIO], runs[ESTIMATOR_AXIS]) > 0
    usual = met.columns[met.mean() >= 0.5]
    common = met.index[met[usual].all(axis=1)]
    kept = runs[runs[ESTIMATOR_AXIS].isin(usual) & runs[SCENARIO].isin(common)]
    return kept if len(kept) else runs


def pivot(
    layout: TableLayout, runs: pd.DataFrame, read: ReadRun, window: EvaluationWindow
) -> pd.Series:
    """The `Cell` of every combination that was run, by the axes of the rows and of the columns.

    The records of one cell are read one after the other, and then forgotten.
    """
    if layout.shared:
        runs = shared_runs(runs)
    axes = [*layout.rows, *layout.columns]
    groups = runs.groupby(axes or np.zeros(len(runs)), observed=True)[RUN]
    index = groups.size().index
    if not isinstance(index, pd.MultiIndex):
        index = pd.MultiIndex.from_arrays([index], names=axes or [RUN])
    cells = [cell_of(map(read, members), layout.metrics, window) for _, members in groups]
    return pd.Series(cells, index, dtype=object)


def with_numbers(layout: TableLayout, cells: pd.Series) -> TableLayout:
    """The layout with the metrics alone that have a number in any cell; all if none has."""
    having = [m for m in layout.metrics if any(cell.values[m.name].exists for cell in cells)]
    return replace(layout, metrics=tuple(having)) if having else layout


def without_empty_rows(layout: TableLayout, cells: pd.Series) -> pd.Series:
    """Cells without the rows that have no number at all: what they estimate is not asked here."""
    known = cells.map(lambda cell: any(value.exists for value in cell.values.values()))
    return cells[known.groupby(list(layout.rows), observed=True).transform("any")]


def csv_text(layout: TableLayout, cells: pd.Series) -> str:
    """A row a cell, every number in full, in the unit that ends its column's name.

    Beside each metric the ends of its 95 % interval, and for a measure of consistency its bounds
    and the verdict.
    """
    places = cells.index.to_frame(index=False).map(shown_value)
    rows = [_csv_row(cell, layout.metrics) for cell in cells]
    text: str = pd.concat([places, pd.DataFrame(rows)], axis=1).to_csv(index=False)
    return text


def _csv_row(cell: Cell, metrics: Sequence[Metric]) -> dict[str, object]:
    row: dict[str, object] = {"runs": cell.runs, "runs_failed": cell.failed}
    for metric in metrics:
        found, name = cell.values[metric.name], metric.name
        row |= {name: found.value, f"{name}_low": found.low, f"{name}_high": found.high}
        if metric.is_consistency:
            bounds = found.bounds or Bounds(np.nan, np.nan)
            row |= {f"{name}_lower_bound": bounds.lower, f"{name}_upper_bound": bounds.upper}
            row[f"{name}_judged"] = found.verdict
    return row


def text_tables(
    layout: TableLayout, cells: pd.Series, window: EvaluationWindow
) -> tuple[TextTable, ...]:
    """The tables to read: one with all metrics side by side, or one a metric where the layout
    has columns."""
    if not layout.columns:
        return (_side_by_side(layout, cells, window),)
    return tuple(_one_metric(layout, metric, cells, window) for metric in layout.metrics)


def _side_by_side(layout: TableLayout, cells: pd.Series, window: EvaluationWindow) -> TextTable:
    labels = row_labels(layout.rows, cells.index)
    columns = {}
    for metric in layout.metrics:
        scale, unit = shown_unit(metric, cells)
        values = [cell.values[metric.name] for cell in cells]
        bounds = {each.bounds for each in values if each.bounds is not None}
        # Bounds that all cells share stand in the header.
        shared = f" in {_bounds_text(*bounds)}" if len(bounds) == 1 else ""
        texts = [value_text(each, scale, not shared) for each in values]
        columns[metric_label(metric, unit) + shared] = texts
    columns["runs"] = [_runs_text(cell) for cell in cells]
    note = _note(layout.metrics, window) + labels.note
    if layout.shared:
        note += " Only estimators and cases are pooled that go together: see the other tables."
    return _text_table(layout.key, layout.title, labels, pd.DataFrame(columns, cells.index), note)


def _one_metric(
    layout: TableLayout, metric: Metric, cells: pd.Series, window: EvaluationWindow
) -> TextTable:
    scale, unit = shown_unit(metric, cells)
    texts = cells.map(lambda cell: _cell_text(cell, metric, scale))
    wide = texts.to_frame().T
    if layout.rows:
        levels = list(range(len(layout.rows), cells.index.nlevels))
        wide = texts.unstack(levels, fill_value=MISSING).sort_index(axis=1)
    wide.columns = pd.Index([", ".join(map(shown_value, _place(names))) for names in wide.columns])
    labels = row_labels(layout.rows, wide.index)
    return _text_table(
        f"{layout.key}_{metric.name}",
        f"{layout.title}: {metric_label(metric, unit)}",
        labels,
        wide,
        _note((metric,), window) + labels.note,
    )


def _text_table(
    key: str, title: str, labels: "RowLabels", texts: pd.DataFrame, note: str
) -> TextTable:
    """The one way from a frame of texts to a table: rows as their labels are to be read."""
    ordered = texts.iloc[labels.order]
    rows = zip(labels.texts, ordered.itertuples(index=False, name=None), strict=True)
    header = (*labels.header, *map(str, texts.columns))
    body = tuple((*label, *row) for label, row in rows)
    return TextTable(key, title, header, body, note, len(labels.header))


@dataclass(frozen=True)
class RowLabels:
    """The first columns of a table."""

    header: tuple[str, ...]
    order: list[int]
    """In which the rows are to be read."""
    texts: list[tuple[str, ...]]
    """Of each row, in that order."""
    note: str
    """What has to be known beside them; empty or a sentence after a blank."""


def row_labels(axes: Sequence[str], index: pd.Index) -> RowLabels:
    """A column for every axis; where there are many, one that names what is not as usual."""
    rows = [_place(values) for values in index]
    settings = [k for k, axis in enumerate(axes) if axis != ESTIMATOR_AXIS]
    if len(settings) <= _MAX_AXES:
        texts = [tuple(map(shown_value, row[: len(axes)])) for row in rows]
        return RowLabels(tuple(map(axis_label, axes)), list(range(len(rows))), texts, "")
    usual = {k: Counter(row[k] for row in rows).most_common(1)[0][0] for k in settings}
    others = [k for k, axis in enumerate(axes) if axis == ESTIMATOR_AXIS]
    unusual = [[k for k in settings if row[k] != usual[k]] for row in rows]

    def label(k: int) -> tuple[str, ...]:
        named = ", ".join(axis_setting(axes[j], [rows[k][j]]) for j in unusual[k])
        return (named or "base", *(shown_value(rows[k][j]) for j in others))

    # The base first, then what differs in one axis, axis by axis, then in several.
    order = sorted(range(len(rows)), key=lambda k: [len(unusual[k]), *unusual[k]])
    base = ", ".join(axis_setting(axes[k], [value]) for k, value in usual.items())
    return RowLabels(
        header=("case", *(axis_label(axes[k]) for k in others)),
        order=order,
        texts=[label(k) for k in order],
        note=f" What a case does not name is as in the base case: {base}.",
    )


def _place(values: Any) -> tuple[AxisValue, ...]:
    """An entry of an index; that of a single level is no tuple."""
    return values if isinstance(values, tuple) else (values,)


def is_wide(found: MetricValue) -> bool:
    """Whether the ends of an interval lie so far apart that they say nothing."""
    return found.low > 0.0 and found.high > _MAX_FACTOR * found.low


def value_text(found: MetricValue, scale: float = 1.0, with_bounds: bool = True) -> str:
    """A number, its 95 % interval where there is one, and the verdict on consistency."""
    if not found.exists:
        return MISSING
    text = number(scale * found.value)
    if is_wide(found):
        text += " [wide]"
    elif np.isfinite(found.low):
        text += f" [{number(scale * found.low)}, {number(scale * found.high)}]"
    if found.bounds is not None:
        asked = f" in {_bounds_text(found.bounds)}:" if with_bounds else ""
        text += f"{asked} {found.verdict}"
    return text


def metric_label(metric: Metric, unit: str) -> str:
    """A metric in words, with a unit it is shown in."""
    return metric.title if unit in ("1", "") else f"{metric.title}, {unit}"


def shown_unit(metric: Metric, cells: Sequence[Cell] | pd.Series) -> tuple[float, str]:
    """Factor and unit in which a metric is shown in all of a table, by its typical size there."""
    values = np.array([cell.values[metric.name].value for cell in cells])
    known = values[np.isfinite(values)]
    return display_unit(metric.unit, float(np.median(known)) if known.size else np.inf)


def _bounds_text(bounds: Bounds) -> str:
    return f"{number(bounds.lower)} to {number(bounds.upper)}"


def _cell_text(cell: Cell, metric: Metric, scale: float) -> str:
    text = value_text(cell.values[metric.name], scale)
    return f"{text} ({cell.failed} of {cell.runs} failed)" if cell.failed else text


def _runs_text(cell: Cell) -> str:
    return f"{cell.runs}, {cell.failed} failed" if cell.failed else str(cell.runs)


_NOTES = {
    Family.CONSISTENCY: " Squared normalised errors per degree of freedom, and the 95 % bounds "
    "they have to lie in if the stated covariances are right: those of the NEES are as wide as if "
    "each run were one frame, because the errors of its frames are correlated; the NIS counts "
    "every frame.",
    Family.BOUND: " RMS of the error over the least standard deviation, frame by frame, that "
    "pcnav's comparison of the frames at the true poses allows (a posterior Cramer-Rao bound of "
    "these comparisons; all rays of an exact camera and mesh would allow less).",
}
_TRAJECTORY = ("ate_rmse_m", "rpe_translation_rmse_m", "rpe_rotation_rmse_deg")


def _note(metrics: Sequence[Metric], window: EvaluationWindow) -> str:
    """What has to be known to read a table of these metrics."""
    families = {metric.quantity.family for metric in metrics}
    text = (
        "In brackets 95 % confidence intervals by drawing whole runs again, where runs differ; "
        f"wide: more than a factor of {_MAX_FACTOR:g} between their ends."
    )
    if families & {Family.ERRORS, Family.CONSISTENCY, Family.BOUND}:
        text = f"Errors over {window.text}. {text}"
    if any(metric.name in _TRAJECTORY for metric in metrics):
        text += " Trajectory errors are over the whole run."
    text += "".join(note for family, note in _NOTES.items() if family in families)
    if Family.LOCKING in families:
        text += " Locking is judged over all frames of a run; the share of frames with a pose is "
        text += f"that of {window.text}."
        text += " Wrong: off by more than 5 % of the target's diameter or 5 deg, up to symmetry."
    return text
