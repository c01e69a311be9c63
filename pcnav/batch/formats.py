"""Numbers as text: the tables people read, with units in the headers, and CSV for programs."""

import csv
import io
from collections.abc import Sequence

import numpy as np

from pcnav.batch.case import shown_value
from pcnav.batch.metrics import Family, Metric
from pcnav.batch.pivot import PivotTable, Values
from pcnav.batch.row_heads import row_heads
from pcnav.batch.samples import Window
from pcnav.batch.statistics import Bounds, CellStatistics, Estimate
from pcnav.files.text_table import TextTable, display_unit, number

NONE = "-"
_UNITLESS = ("1", "")


def text_tables(table: PivotTable, window: Window) -> tuple[TextTable, ...]:
    """The tables to read: one with all metrics side by side, or one a metric where the layout
    has columns."""
    if not table.layout.columns:
        return (_side_by_side(table, window),)
    return tuple(_one_metric(table, metric, window) for metric in table.layout.metrics)


def csv_text(table: PivotTable) -> str:
    """A row a cell, every number in full, in the unit that ends its column's name.

    Beside each metric the ends of its 95 % interval, and for a measure of consistency its bounds
    and the verdict.
    """
    layout = table.layout
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    header = [*layout.rows, *layout.columns, "runs", "runs_failed"]
    for metric in layout.metrics:
        header += [metric.name, f"{metric.name}_low", f"{metric.name}_high"]
        if metric.is_consistency:
            header += [f"{metric.name}_{part}" for part in ("lower_bound", "upper_bound", "judged")]
    writer.writerow(header)
    for row, column, cell in table:
        fields = [shown_value(value) for value in (*row, *column)]
        fields += [str(cell.runs), str(cell.failed)]
        for metric in layout.metrics:
            fields += _csv_fields(metric, cell.estimates[metric.name])
        writer.writerow(fields)
    return stream.getvalue()


_TELLING = 1000.0
"""An interval whose ends lie farther apart, as a factor, tells nothing in a table."""


def is_wide(estimate: Estimate) -> bool:
    """Whether the ends of an interval lie so far apart that they tell nothing."""
    return estimate.low > 0.0 and estimate.high > _TELLING * estimate.low


def estimate_text(estimate: Estimate, scale: float = 1.0, with_bounds: bool = True) -> str:
    """A number, its 95 % interval where there is one, and the verdict on consistency."""
    if not estimate.exists:
        return NONE
    text = number(scale * estimate.value)
    if is_wide(estimate):
        text += " [wide]"
    elif np.isfinite(estimate.low):
        text += f" [{number(scale * estimate.low)}, {number(scale * estimate.high)}]"
    if estimate.bounds is not None:
        asked = f" in {_bounds_text(estimate.bounds)}:" if with_bounds else ""
        text += f"{asked} {estimate.verdict}"
    return text


def metric_label(metric: Metric, unit: str) -> str:
    """A metric in words, with a unit it is shown in."""
    return metric.title if unit in _UNITLESS else f"{metric.title}, {unit}"


def shown_unit(table: PivotTable, metric: Metric) -> tuple[float, str]:
    """Factor and unit in which a metric is shown in all of a table, by its typical size there."""
    values = [cell.estimates[metric.name].value for _, _, cell in table]
    finite = np.array([value for value in values if np.isfinite(value)])
    return display_unit(metric.unit, float(np.median(finite)) if finite.size else np.inf)


def _side_by_side(table: PivotTable, window: Window) -> TextTable:
    layout, heads = table.layout, row_heads(table)
    cells = [table.cells[row, ()] for row in heads.texts]
    labels, columns = [], []
    for metric in layout.metrics:
        scale, unit = shown_unit(table, metric)
        estimates = [cell.estimates[metric.name] for cell in cells]
        bounds = {each.bounds for each in estimates if each.bounds is not None}
        # Bounds that all cells share are told once.
        shared = f" in {_bounds_text(*bounds)}" if len(bounds) == 1 else ""
        labels.append(metric_label(metric, unit) + shared)
        columns.append([estimate_text(each, scale, not shared) for each in estimates])
    rows = [
        (*head, *(texts[k] for texts in columns), _runs_text(cells[k]))
        for k, head in enumerate(heads.texts.values())
    ]
    header = (*heads.header, *labels, "runs")
    note = _note(layout.metrics, window) + heads.note
    if layout.shared:
        note += " Only estimators and cases are pooled that go together: see the other tables."
    return TextTable(layout.key, layout.title, header, tuple(rows), note, len(heads.header))


def _one_metric(table: PivotTable, metric: Metric, window: Window) -> TextTable:
    layout = table.layout
    scale, unit = shown_unit(table, metric)
    heads = row_heads(table)
    rows = []
    for row, head in heads.texts.items():
        cells = (table.of(row, column) for column in table.columns)
        texts = (NONE if cell is None else _cell_text(cell, metric, scale) for cell in cells)
        rows.append((*head, *texts))
    header = (*heads.header, *map(_joined, table.columns))
    title = f"{layout.title}: {metric_label(metric, unit)}"
    note = _note((metric,), window) + heads.note
    key = f"{layout.key}_{metric.name}"
    return TextTable(key, title, header, tuple(rows), note, len(heads.header))


def _bounds_text(bounds: Bounds) -> str:
    return f"{number(bounds.lower)} to {number(bounds.upper)}"


def _cell_text(cell: CellStatistics, metric: Metric, scale: float) -> str:
    text = estimate_text(cell.estimates[metric.name], scale)
    return f"{text} ({cell.failed} of {cell.runs} failed)" if cell.failed else text


def _runs_text(cell: CellStatistics) -> str:
    return f"{cell.runs}, {cell.failed} failed" if cell.failed else str(cell.runs)


def _joined(values: Values) -> str:
    return ", ".join(map(shown_value, values))


def _csv_fields(metric: Metric, estimate: Estimate) -> list[str]:
    fields = [_csv_number(x) for x in (estimate.value, estimate.low, estimate.high)]
    if metric.is_consistency:
        bounds = estimate.bounds
        fields += ["", ""] if bounds is None else [repr(bounds.lower), repr(bounds.upper)]
        fields.append(estimate.verdict)
    return fields


def _csv_number(value: float) -> str:
    """All its digits; nothing where there is no number."""
    return repr(value) if np.isfinite(value) else ""


def _note(metrics: Sequence[Metric], window: Window) -> str:
    """What has to be known to read a table of these metrics."""
    families = {metric.quantity.family for metric in metrics}
    text = (
        "In brackets 95 % confidence intervals by drawing whole runs again, where runs differ; "
        f"wide: more than a factor of {_TELLING:g} between their ends."
    )
    if families & {Family.ERRORS, Family.CONSISTENCY, Family.BOUND}:
        text = f"Errors over {window.text}. {text}"
    if any(metric.quantity.name in ("ate_rmse_m", *_RELATIVE) for metric in metrics):
        text += " Trajectory errors are over the whole run."
    if Family.CONSISTENCY in families:
        text += (
            " Squared normalised errors per degree of freedom, and the 95 % bounds they have to "
            "lie in if the stated covariances are right: those of the NEES are as wide as if each "
            "run were one frame, because the errors of its frames hang together; the NIS counts "
            "every frame."
        )
    if Family.BOUND in families:
        text += " RMS of the error over the bound on its standard deviation, frame by frame; 1 is "
        text += "the best that can be."
    if Family.LOCKING in families:
        text += " Locking is judged over all frames of a run; the share of frames with a pose is "
        text += f"that of {window.text}."
        text += " Wrong: off by more than 10 % of the target's size or 10 deg, up to symmetry."
    return text


_RELATIVE = ("rpe_translation_rmse_m", "rpe_rotation_rmse_deg")
