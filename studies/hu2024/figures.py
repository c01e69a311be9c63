"""Figures 5 to 11 of Hu 2024, in the look of the reports."""

from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator, NullFormatter, StrMethodFormatter

from pcnav.core.arrays import FloatArray
from pcnav.report.figures import (
    ALERT,
    BAND,
    CATEGORIES,
    GRID,
    LINE,
    MUTED,
    add_legend,
    style_axes,
    svg_bytes,
)

from ..folder import StudyFigure
from . import paper

_WIDTH_IN = 5.8


@dataclass(frozen=True)
class Errors:
    """A quantity's errors of the two filters."""

    key: str
    title: str
    labels: tuple[str, ...]
    """Per component, with unit."""
    unique: FloatArray
    """(n, k) with the unique axes."""
    sd: FloatArray
    """(n, k) as that filter states them."""
    free: FloatArray
    """(n, k) without."""


def errors_figure(time_s: FloatArray, free_time_s: FloatArray, errors: Errors) -> StudyFigure:
    """Left: with the unique axes, inside three stated deviations. Right: without, on its scale."""
    rows = len(errors.labels)
    figure = Figure(figsize=(_WIDTH_IN, 0.7 + 1.15 * rows), layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.subplots(rows, 2, sharex=True, squeeze=False)
    for k, label in enumerate(errors.labels):
        left, right = grid[k]
        for axes in (left, right):
            style_axes(axes)
            for start, end in paper.blackouts_s():
                axes.axvspan(start, end, color=GRID, linewidth=0)
        bound = 3.0 * errors.sd[:, k]
        left.fill_between(time_s, -bound, bound, color=BAND, linewidth=0, label="3 sd stated")
        left.plot(time_s, errors.unique[:, k], color=LINE, linewidth=0.8, label="unique axes")
        right.plot(
            free_time_s, errors.free[:, k], color=ALERT, linewidth=0.9, label="axes as they come"
        )
        _limit(left, errors.unique[:, k], bound)
        _limit(right, errors.free[:, k], np.zeros(0))
        left.set_ylabel(label)
    for axes in grid[-1]:
        axes.set_xlabel("time, s")
        axes.set_xlim(float(time_s[0]), float(time_s[-1]))
    # One legend for both columns.
    grid[0, 0].plot([], [], color=ALERT, linewidth=0.9, label="axes as they come")
    add_legend(figure, grid[0, 0])
    caption = "Truth minus estimate. Grey: nothing is seen."
    return StudyFigure(errors.key, errors.title, caption, svg_bytes(figure))


def _limit(axes: Axes, values: FloatArray, bound: FloatArray) -> None:
    axes.axhline(0.0, color=MUTED, linewidth=0.6)
    shown = np.abs(np.concatenate([values, bound]))
    shown = shown[np.isfinite(shown)]
    if shown.size and shown.max() > 0.0:
        axes.set_ylim(-1.1 * float(shown.max()), 1.1 * float(shown.max()))
    axes.yaxis.set_major_locator(MaxNLocator(nbins=3, symmetric=True))


def rmse_figure(
    key: str, title: str, caption: str, time_s: FloatArray, curves: dict[str, FloatArray]
) -> StudyFigure:
    """RMSE (deg) over the length of the arc, both logarithmic."""
    figure = Figure(figsize=(_WIDTH_IN, 3.2), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    style_axes(axes)
    for colour, (name, values) in zip(CATEGORIES, curves.items(), strict=False):
        axes.plot(time_s, values, color=colour, marker=".", linewidth=1.1, label=name)
    axes.set_yscale("log")
    axes.set_xscale("log")
    axes.set_xticks(time_s, [f"{t:g}" for t in time_s])
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.yaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
    axes.set_xlabel("length of the arc, s")
    axes.set_ylabel("RMSE, deg")
    add_legend(figure, axes)
    return StudyFigure(key, title, caption, svg_bytes(figure))


def nees_figure(
    key: str,
    title: str,
    caption: str,
    time_s: FloatArray,
    mean: FloatArray,
    bounds: tuple[FloatArray, FloatArray],
) -> StudyFigure:
    """Mean NEES per degree of freedom (n,) against its 95 % bounds."""
    figure = Figure(figsize=(_WIDTH_IN, 2.8), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    style_axes(axes)
    for start, end in paper.blackouts_s():
        axes.axvspan(start, end, color=GRID, linewidth=0)
    axes.fill_between(time_s, *bounds, color=BAND, linewidth=0, label="95 % bounds")
    axes.plot(time_s, mean, color=LINE, linewidth=1.0, label="mean over the runs")
    axes.axhline(1.0, color=MUTED, linewidth=0.6)
    axes.set_xlim(float(time_s[0]), float(time_s[-1]))
    axes.set_ylim(bottom=0.0)
    axes.set_xlabel("time, s")
    axes.set_ylabel("NEES over dof")
    add_legend(figure, axes)
    return StudyFigure(key, title, caption, svg_bytes(figure))
