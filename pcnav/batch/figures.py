"""Small figures of a batch: errors along one axis, one line an estimator, with their confidence."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import FixedLocator, LogLocator, NullLocator, StrMethodFormatter

from pcnav.batch.case import ESTIMATOR_AXIS, AxisValue, BatchRun, shown_value
from pcnav.batch.formats import is_wide, metric_label, shown_unit
from pcnav.batch.metrics import Metric
from pcnav.batch.pivot import AxisOrder, Layout, PivotTable, ReadRun, Values, pivot
from pcnav.batch.row_heads import axis_label, axis_setting
from pcnav.batch.samples import Window
from pcnav.batch.statistics import Estimate
from pcnav.batch.sweeps import Sweep, sweeps
from pcnav.report.figures import CATEGORIES, add_legend, new_figure, style_axes, svg_bytes

_HEIGHT_IN = 2.9
_MARKERS = ("o", "s", "^", "D", "v")
_LOG_FROM = 2.5
"""Values that span this factor get a logarithmic axis."""
_APART = 0.018
"""By how much of the axis the points of two estimators are drawn apart, so that bars stay told."""
_LABELS_APART = 0.07
"""Of the axis: values closer than this share a label."""


@dataclass(frozen=True)
class Drawing:
    """A finished figure."""

    key: str
    """Name of its file, without the suffix."""
    title: str
    caption: str
    svg: bytes


def figures(
    runs: Sequence[BatchRun], read: ReadRun, metrics: Sequence[Metric], window: Window
) -> tuple[Drawing, ...]:
    """A figure for every sweep of a batch."""
    estimators = AxisOrder.of(runs).values.get(ESTIMATOR_AXIS, ())
    return tuple(
        _figure(sweep, _table(sweep, read, metrics, window), estimators, window)
        for sweep in sweeps(runs)
    )


def _table(sweep: Sweep, read: ReadRun, metrics: Sequence[Metric], window: Window) -> PivotTable:
    has_estimators = any(name == ESTIMATOR_AXIS for name, _ in sweep.runs[0].case.axes)
    columns = (ESTIMATOR_AXIS,) if has_estimators else ()
    layout = Layout(sweep.key, sweep.key, (sweep.axis,), columns, tuple(metrics))
    return pivot(layout, sweep.runs, read, window)


def _figure(
    sweep: Sweep, table: PivotTable, estimators: Sequence[AxisValue], window: Window
) -> Drawing:
    metrics = table.layout.metrics
    figure = new_figure(_HEIGHT_IN)
    panels: list[Axes] = list(figure.subplots(1, len(metrics), squeeze=False)[0])
    for axes, metric in zip(panels, metrics, strict=True):
        style_axes(axes)
        _draw(axes, table, metric, estimators)
        axes.set_xlabel(axis_label(sweep.axis))
    add_legend(figure, panels[0])
    title = axis_label(sweep.axis).partition(",")[0]
    title = f"Error against {title}"
    if sweep.facet is not None:
        title += f": {shown_value(sweep.facet)}"
    return Drawing(sweep.key, title, _caption(sweep, table, window), svg_bytes(figure))


def _draw(axes: Axes, table: PivotTable, metric: Metric, estimators: Sequence[AxisValue]) -> None:
    scale, unit = shown_unit(table, metric)
    places = np.array([float(row[0]) for row in table.rows])
    logarithmic = bool(places.min() > 0.0 and places.max() >= _LOG_FROM * places.min())
    coordinate = np.log(places) if logarithmic else places
    span = float(np.ptp(coordinate))
    for k, column in enumerate(table.columns):
        shifted = coordinate + _APART * span * (k - 0.5 * (len(table.columns) - 1))
        x = np.exp(shifted) if logarithmic else shifted
        value, low, high = scale * _series(table, metric, column)
        bars = np.nan_to_num(np.stack([value - low, high - value]))
        # The same colour and mark in all figures of a batch.
        place = estimators.index(column[0]) if column else 0
        axes.errorbar(
            x,
            value,
            np.maximum(bars, 0.0),
            color=CATEGORIES[place % len(CATEGORIES)],
            marker=_MARKERS[place % len(_MARKERS)],
            linestyle="-" if place < len(CATEGORIES) else "--",
            markersize=3.5,
            linewidth=1.1,
            elinewidth=0.9,
            capsize=2,
            label=shown_value(column[0]) if column else metric.title,
        )
    _scale_horizontal(axes, places, coordinate, logarithmic)
    _scale_vertical(axes)
    axes.set_ylabel(metric_label(metric, unit))


def _series(table: PivotTable, metric: Metric, column: Values) -> np.ndarray:
    """(3, n) value and interval along the rows; nan where there is no number."""
    cells = [table.of(row, column) for row in table.rows]
    found = [None if cell is None else cell.estimates[metric.name] for cell in cells]
    nothing = (np.nan, np.nan, np.nan)
    # An interval that tells nothing would make the axis tell nothing either.
    rows = [nothing if e is None else _shown(e) for e in found]
    return np.array(rows, dtype=np.float64).T


def _shown(estimate: Estimate) -> tuple[float, float, float]:
    value = estimate.value
    return (value, value, value) if is_wide(estimate) else (value, estimate.low, estimate.high)


def _scale_horizontal(
    axes: Axes, places: np.ndarray, coordinate: np.ndarray, logarithmic: bool
) -> None:
    if logarithmic:
        axes.set_xscale("log")
    # The values that were run are the ones to read off, where their labels do not touch.
    shown = [0]
    for k in range(1, len(places)):
        if coordinate[k] - coordinate[shown[-1]] > _LABELS_APART * np.ptp(coordinate):
            shown.append(k)
    axes.xaxis.set_major_locator(FixedLocator(places[shown].tolist()))
    axes.xaxis.set_minor_locator(NullLocator())
    axes.xaxis.set_major_formatter(StrMethodFormatter("{x:g}"))


def _scale_vertical(axes: Axes) -> None:
    drawn = np.concatenate([np.asarray(line.get_ydata(), dtype=float) for line in axes.lines])
    known = drawn[np.isfinite(drawn)]
    if not known.size:
        return
    if known.min() <= 0.0:
        axes.set_ylim(bottom=0.0)
        return
    axes.set_yscale("log")
    if known.max() < 100.0 * known.min():
        # Two decades may hold one power of ten alone, and one of them none.
        axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0), numticks=12))
    axes.yaxis.set_minor_locator(NullLocator())
    axes.yaxis.set_major_formatter(StrMethodFormatter("{x:g}"))


def _caption(sweep: Sweep, table: PivotTable, window: Window) -> str:
    text = f"Over the {window.text}; bars are 95 % confidence intervals by drawing runs again."
    fixed = [axis_setting(name, values) for name, values in sweep.pooled if len(values) == 1]
    mixed = [axis_setting(name, values) for name, values in sweep.pooled if len(values) > 1]
    if fixed:
        text += f" At {', '.join(fixed)}."
    if mixed:
        text += f" Pooled over {', '.join(mixed)}, the same at every point."
    failed = sum(cell.failed for _, _, cell in table)
    return f"{text} {failed} failed runs are not in it." if failed else text
