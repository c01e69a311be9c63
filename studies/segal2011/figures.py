"""Percentiles of errors over time, drawn as the paper draws them."""

from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter

from pcnav.core.arrays import FloatArray
from pcnav.report.figures import CATEGORIES, add_legend, style_axes, svg_bytes

from ..folder import StudyFigure

_WIDTH_IN, _ROW_IN = 5.8, 2.1
_LOG_FROM = 60.0
"""Curves that span this factor ask for a logarithmic axis."""


@dataclass(frozen=True)
class Panel:
    """One pair of axes."""

    title: str
    label: str
    """Quantity and unit."""
    curves: dict[str, FloatArray]
    """(n,) by name."""


def panels_figure(
    key: str, title: str, caption: str, time_s: FloatArray, panels: list[Panel], columns: int = 2
) -> StudyFigure:
    """Panels side by side over one time axis; errors of several decades on logarithmic axes."""
    rows = -(-len(panels) // columns)
    figure = Figure(figsize=(_WIDTH_IN, 0.5 + _ROW_IN * rows), layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.subplots(rows, columns, sharex=True, squeeze=False)
    for axes, panel in zip(grid.ravel(), panels, strict=False):
        style_axes(axes)
        for colour, (name, values) in zip(CATEGORIES, panel.curves.items(), strict=False):
            axes.plot(time_s, values, color=colour, linewidth=1.0, label=name)
        axes.set_ylabel(panel.label)
        axes.set_title(panel.title, fontsize=9, loc="left")
        axes.set_xlim(float(time_s[0]), float(time_s[-1]))
    for axes in grid.ravel()[len(panels) :]:
        axes.set_visible(False)
    for axes in grid[-1]:
        axes.set_xlabel("time, s")
    _same_scale(list(grid.ravel()[: len(panels)]), panels)
    add_legend(figure, grid[0, 0], max_columns=5)
    return StudyFigure(key, title, caption, svg_bytes(figure))


def _same_scale(all_axes: list[Axes], panels: list[Panel]) -> None:
    """Panels of one quantity get one scale, so that they can be compared."""
    for label in {panel.label for panel in panels}:
        same = [axes for axes, panel in zip(all_axes, panels, strict=True) if panel.label == label]
        drawn = [panel.curves.values() for panel in panels if panel.label == label]
        values = np.concatenate([curve for curves in drawn for curve in curves])
        low, high = float(values.min()), float(values.max())
        for axes in same:
            if high > _LOG_FROM * low > 0.0:
                axes.set_yscale("log")
                axes.yaxis.set_minor_formatter(NullFormatter())
                axes.set_ylim(0.8 * low, 1.25 * high)
            else:
                axes.set_ylim(0.0, 1.05 * high)


def percentile_curves(values: FloatArray, percentiles: tuple[int, ...]) -> dict[str, FloatArray]:
    """Of (frames, runs), over the runs."""
    found = np.percentile(values, percentiles, axis=1)
    return {f"{p} %": curve for p, curve in zip(percentiles, found, strict=True)}
