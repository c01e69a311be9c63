"""Small figures of a batch: errors along one axis, one line an estimator, with their confidence.

A curve of an error over the range must not mix the range with what else changed from case to case:
only combinations of the other axes that were run at every point of the curve enter it.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.ticker import FixedLocator, LogLocator, NullLocator, StrMethodFormatter

from pcnav.batch.axes import (
    ESTIMATOR_AXIS,
    SATELLITE_AXIS,
    AxisValue,
    axis_label,
    axis_setting,
    shown_value,
)
from pcnav.batch.metrics import EvaluationWindow, Metric
from pcnav.batch.statistics import MetricValue
from pcnav.batch.tables import (
    ReadRun,
    TableLayout,
    axes_of,
    is_wide,
    metric_label,
    pivot,
    shown_unit,
    varying_axes,
)
from pcnav.report.figures import CATEGORIES, add_legend, drawing, new_figure, style_axes
from pcnav.report.page import Drawing

FACET_AXIS = SATELLITE_AXIS
"""Never pooled in a figure: errors in metres follow the size of the target."""
_HEIGHT_IN = 2.9
_MARKERS = ("o", "s", "^", "D", "v")
_LOG_FROM = 2.5
"""Values that span this factor get a logarithmic axis."""
_APART = 0.018
"""By how much of the axis the points of two estimators are drawn apart: bars stay visible."""
_LABELS_APART = 0.07
"""Of the axis: values closer than this share a label."""


@dataclass(frozen=True)
class SweepFigure:
    """A finished figure."""

    key: str
    """Name of its file, without the suffix."""
    drawing: Drawing


@dataclass(frozen=True)
class Sweep:
    """Runs that differ in one axis of numbers and are alike in all others: one figure's worth."""

    axis: str
    facet: AxisValue | None
    """The satellite; None where the batch does not tell them apart."""
    runs: pd.DataFrame
    """Of `run_table`."""

    @property
    def key(self) -> str:
        """Name of its figure's file."""
        return self.axis if self.facet is None else f"{self.axis}_{shown_value(self.facet)}"

    @property
    def pooled(self) -> dict[str, list[AxisValue]]:
        """Values of the other axes: one where they are fixed, several where runs are pooled."""
        but = (self.axis, ESTIMATOR_AXIS, FACET_AXIS)
        return {
            name: list(self.runs[name].cat.remove_unused_categories().cat.categories)
            for name in axes_of(self.runs)
            if name not in but
        }


def sweeps(runs: pd.DataFrame) -> tuple[Sweep, ...]:
    """All sweeps of a batch along axes of numbers, axis by axis."""
    facets = list(runs[FACET_AXIS].cat.categories) if FACET_AXIS in runs else [None]
    found = []
    for axis in varying_axes(runs):
        if any(isinstance(value, str) for value in runs[axis].cat.categories):
            continue
        for facet in facets:
            members = runs if facet is None else runs[runs[FACET_AXIS] == facet]
            kept = _alike(axis, members)
            if len(kept):
                found.append(Sweep(axis, facet, kept))
    return tuple(found)


def _alike(axis: str, runs: pd.DataFrame) -> pd.DataFrame:
    """The runs of the curves with the most points; none where no curve has two."""
    values = runs[list(axes_of(runs))].astype(object)
    others = [name for name in values if name not in (axis, ESTIMATOR_AXIS)]
    everyone = pd.Series(0, runs.index)
    setting = values.groupby(others, sort=False).ngroup() if others else everyone
    who = values.get(ESTIMATOR_AXIS, everyone)
    # Which points each estimator has in each setting of the other axes.
    met = values[axis].groupby([setting, who], sort=False).agg(frozenset)
    points = max(met, key=len)
    if len(points) < 2:
        return runs.iloc[:0]
    # The settings in which the most estimators have all these points, and these estimators.
    complete = met.rename_axis(["setting", "who"])[met.map(points.issubset)].index.to_frame()
    having = complete["who"].groupby("setting", sort=False).agg(frozenset)
    estimators = max(having, key=len)
    settings = having.index[having.map(estimators.issubset)]
    return runs[values[axis].isin(points) & setting.isin(settings) & who.isin(estimators)]


def figures(
    runs: pd.DataFrame, read: ReadRun, metrics: Sequence[Metric], window: EvaluationWindow
) -> tuple[SweepFigure, ...]:
    """A figure for every sweep of a batch."""
    return tuple(_figure(sweep, read, metrics, window) for sweep in sweeps(runs))


def _figure(
    sweep: Sweep, read: ReadRun, metrics: Sequence[Metric], window: EvaluationWindow
) -> SweepFigure:
    who = (ESTIMATOR_AXIS,) if ESTIMATOR_AXIS in sweep.runs else ()
    layout = TableLayout(sweep.key, sweep.key, (sweep.axis,), who, tuple(metrics))
    cells = pivot(layout, sweep.runs, read, window)
    figure = new_figure(_HEIGHT_IN)
    panels: list[Axes] = list(figure.subplots(1, len(metrics), squeeze=False)[0])
    for axes, metric in zip(panels, metrics, strict=True):
        style_axes(axes)
        _draw(axes, cells, metric, _estimators(sweep.runs))
        axes.set_xlabel(axis_label(sweep.axis))
    add_legend(figure, panels[0])
    title = f"Error against {axis_label(sweep.axis).partition(',')[0]}"
    if sweep.facet is not None:
        title += f": {shown_value(sweep.facet)}"
    failed = sum(cell.failed for cell in cells)
    return SweepFigure(sweep.key, drawing(title, _caption(sweep, failed, window), figure))


def _estimators(runs: pd.DataFrame) -> list[AxisValue]:
    """All of the batch, in order: the same colour and mark in all its figures."""
    return list(runs[ESTIMATOR_AXIS].cat.categories) if ESTIMATOR_AXIS in runs else []


def _draw(axes: Axes, cells: pd.Series, metric: Metric, estimators: list[AxisValue]) -> None:
    scale, unit = shown_unit(metric, cells)
    found = cells.map(lambda cell: _shown(cell.values[metric.name]))
    lines = found.unstack(1) if estimators else found.to_frame(metric.title)
    places = lines.index.get_level_values(0).to_numpy(dtype=float)
    logarithmic = bool(places.min() > 0.0 and places.max() >= _LOG_FROM * places.min())
    coordinate = np.log(places) if logarithmic else places
    span = float(np.ptp(coordinate))
    for k, name in enumerate(lines.columns.tolist()):
        shifted = coordinate + _APART * span * (k - 0.5 * (lines.shape[1] - 1))
        known = [each if isinstance(each, tuple) else (np.nan,) * 3 for each in lines[name]]
        value, low, high = scale * np.array(known).T
        bars = np.nan_to_num(np.stack([value - low, high - value]))
        place = estimators.index(name) if estimators else 0
        axes.errorbar(
            np.exp(shifted) if logarithmic else shifted,
            value,
            np.maximum(bars, 0.0),
            color=CATEGORIES[place % len(CATEGORIES)],
            marker=_MARKERS[place % len(_MARKERS)],
            linestyle="-" if place < len(CATEGORIES) else "--",
            markersize=3.5,
            linewidth=1.1,
            elinewidth=0.9,
            capsize=2,
            label=shown_value(name),
        )
    _scale_horizontal(axes, places, coordinate, logarithmic)
    _scale_vertical(axes)
    axes.set_ylabel(metric_label(metric, unit))


def _shown(found: MetricValue) -> tuple[float, float, float]:
    """Value and interval; an interval that tells nothing would make the axis tell nothing."""
    value = found.value
    return (value, value, value) if is_wide(found) else (value, found.low, found.high)


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


def _caption(sweep: Sweep, failed: int, window: EvaluationWindow) -> str:
    text = f"Over {window.text}; bars are 95 % confidence intervals by drawing runs again."
    fixed = [axis_setting(name, each) for name, each in sweep.pooled.items() if len(each) == 1]
    mixed = [axis_setting(name, each) for name, each in sweep.pooled.items() if len(each) > 1]
    if fixed:
        text += f" At {', '.join(fixed)}."
    if mixed:
        text += f" Pooled over {', '.join(mixed)}, the same at every point."
    return f"{text} {failed} failed runs are not in it." if failed else text
