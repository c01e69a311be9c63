"""Small figures of a batch: errors along one axis, one line an estimator, with their confidence.

A curve of an error over the range must not mix the range with what else changed from case to case:
only combinations of the other axes that were run at every point of the curve enter it.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

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
from pcnav.core.arrays import FloatArray
from pcnav.report.figures import CATEGORIES, drawing
from pcnav.report.page import Drawing
from pcnav.report.panels import Curve, Panel, Scale, panels_figure

FACET_AXIS = SATELLITE_AXIS
"""Never pooled in a figure: errors in metres follow the size of the target."""
_HEIGHT_IN = 2.2
_MARKERS = ("o", "s", "^", "D", "v")
_LOG_FROM = 2.5
"""Values that span this factor get a logarithmic axis."""
_APART = 0.018
"""By how much of the axis the points of two estimators are drawn apart: bars stay visible."""


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
    # All of the batch, in order: the same colour and mark in all its figures.
    estimators = list(sweep.runs[ESTIMATOR_AXIS].cat.categories) if who else []
    at = np.unique(cells.index.get_level_values(0).to_numpy(dtype=float))
    log_at = bool(at[0] > 0.0 and at[-1] >= _LOG_FROM * at[0])
    figure = panels_figure(
        at,
        [_panel(at, log_at, cells, metric, estimators) for metric in metrics],
        columns=len(metrics),
        row_in=_HEIGHT_IN,
        at_label=axis_label(sweep.axis),
        log_at=log_at,
        ticks=True,
    )
    title = f"Error against {axis_label(sweep.axis).partition(',')[0]}"
    if sweep.facet is not None:
        title += f": {shown_value(sweep.facet)}"
    failed = sum(cell.failed for cell in cells)
    return SweepFigure(sweep.key, drawing(title, _caption(sweep, failed, window), figure))


def _panel(
    at: FloatArray, log_at: bool, cells: pd.Series, metric: Metric, estimators: list[AxisValue]
) -> Panel:
    """A line an estimator, over the values (n,) of the axis."""
    scale, unit = shown_unit(metric, cells)
    found = cells.map(lambda cell: cell.values[metric.name])
    lines = found.unstack(1) if estimators else found.to_frame(metric.title)
    coordinate = np.log(at) if log_at else at
    curves, shown = [], []
    for k, name in enumerate(lines.columns.tolist()):
        shift = _APART * np.ptp(coordinate) * (k - 0.5 * (lines.shape[1] - 1))
        values, low, high = scale * np.array([_numbers(each) for each in lines[name]]).T
        place = estimators.index(name) if estimators else 0
        curves.append(
            Curve(
                shown_value(name),
                values,
                np.exp(coordinate + shift) if log_at else coordinate + shift,
                _MARKERS[place % len(_MARKERS)] + ("-" if place < len(CATEGORIES) else "--"),
                CATEGORIES[place % len(CATEGORIES)],
                bars=(low, high),
            )
        )
        shown += [values, low, high]
    is_positive = bool(np.nanmin(np.concatenate(shown), initial=np.inf) > 0.0)
    vertical = Scale.LOG if is_positive else Scale.FROM_ZERO
    return Panel(metric_label(metric, unit), curves, vertical)


def _numbers(found: object) -> tuple[float, float, float]:
    """Value and interval, nan where there is none or where it says nothing."""
    if not isinstance(found, MetricValue):
        return (np.nan, np.nan, np.nan)
    wide = is_wide(found)
    return (found.value, np.nan if wide else found.low, np.nan if wide else found.high)


def _caption(sweep: Sweep, failed: int, window: EvaluationWindow) -> str:
    text = f"Over {window.text}; bars are 95 % confidence intervals by drawing runs again."
    fixed = [axis_setting(name, each) for name, each in sweep.pooled.items() if len(each) == 1]
    mixed = [axis_setting(name, each) for name, each in sweep.pooled.items() if len(each) > 1]
    if fixed:
        text += f" At {', '.join(fixed)}."
    if mixed:
        text += f" Pooled over {', '.join(mixed)}, the same at every point."
    return f"{text} {failed} failed runs are not in it." if failed else text
