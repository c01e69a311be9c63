"""Estimates over time beside the truth, as the paper draws them."""

from dataclasses import dataclass

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from pcnav.core.arrays import FloatArray
from pcnav.report.figures import ALERT, CATEGORIES, add_legend, style_axes, svg_bytes

from ..folder import StudyFigure

_WIDTH_IN, _ROW_IN = 5.8, 1.15
_COLOURS = CATEGORIES[:1] + CATEGORIES[2:]
"""Without the one that looks like the truth's."""


@dataclass(frozen=True)
class Row:
    """One quantity."""

    label: str
    truth: FloatArray
    """(n,)"""
    estimates: dict[str, FloatArray]
    """(n,) by the filter's name."""


def truth_figure(
    key: str, title: str, caption: str, time_s: FloatArray, rows: list[Row]
) -> StudyFigure:
    """Estimates (thin) over the truth (broad), one row per quantity."""
    figure = Figure(figsize=(_WIDTH_IN, 0.7 + _ROW_IN * len(rows)), layout="constrained")
    FigureCanvasAgg(figure)
    grid = list(figure.subplots(len(rows), 1, sharex=True, squeeze=False)[:, 0])
    for axes, row in zip(grid, rows, strict=True):
        style_axes(axes)
        axes.plot(time_s, row.truth, color=ALERT, linewidth=2.0, alpha=0.6, label="truth")
        for colour, (name, values) in zip(_COLOURS, row.estimates.items(), strict=False):
            axes.plot(time_s, values, color=colour, linewidth=0.8, label=name)
        late = np.concatenate([v[len(v) // 10 :] for v in (row.truth, *row.estimates.values())])
        low, high = float(late.min()), float(late.max())
        margin = 0.1 * max(high - low, 0.02 * max(abs(low), abs(high), 1e-3))
        axes.set_ylim(low - margin, high + margin)
        axes.set_ylabel(row.label)
    grid[-1].set_xlabel("time, s")
    grid[-1].set_xlim(float(time_s[0]), float(time_s[-1]))
    figure.align_ylabels(grid)
    add_legend(figure, grid[0])
    return StudyFigure(key, title, caption, svg_bytes(figure))


def decay_figure(
    key: str,
    title: str,
    caption: str,
    curves: dict[str, tuple[FloatArray, FloatArray]],
    wanted: float,
    label: str,
) -> StudyFigure:
    """Standard deviations against arc length, both logarithmic, and the one that is wanted."""
    figure = Figure(figsize=(_WIDTH_IN, 3.4), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    style_axes(axes)
    for colour, (name, (time_s, values)) in zip(CATEGORIES, curves.items(), strict=False):
        axes.loglog(time_s[1:], values[1:], color=colour, linewidth=1.1, label=name)
    axes.axhline(wanted, color=ALERT, linewidth=1.0, linestyle="--", label="wanted")
    axes.set_xlabel("length of the arc, s")
    axes.set_ylabel(label)
    add_legend(figure, axes)
    return StudyFigure(key, title, caption, svg_bytes(figure))
