"""Figures of the studies: errors over time with the printed bounds, in the style of the reports."""

from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from pcnav.core.arrays import FloatArray
from pcnav.report.envelope import envelope
from pcnav.report.figures import (
    ALERT,
    BAND,
    CATEGORIES,
    LINE,
    MUTED,
    add_legend,
    style_axes,
    svg_bytes,
)

from .folder import StudyFigure

_WIDTH_IN = 5.8
_LOG_FROM = 20.0
"""A curve this many times its band asks for a logarithmic axis."""


@dataclass(frozen=True)
class Series:
    """One row of a figure."""

    label: str
    """Quantity and unit."""
    values: FloatArray
    """(n,)"""
    printed: float | None
    """Largest error the paper states, drawn on both sides."""
    sd: FloatArray | None = None
    """(n,) as the filter states it; three of it are drawn as a band."""
    dots: bool = False
    """Drawn as dots: for values that jump from frame to frame."""


def series_figure(
    key: str,
    title: str,
    caption: str,
    time_s: FloatArray,
    series: list[Series],
    settled_from_s: float | None = None,
) -> StudyFigure:
    """Rows that share the time axis.

    The vertical axes span what happens from ``settled_from_s`` on, so that a start-up transient
    does not flatten the rest.
    """
    figure = _figure(0.7 + 1.15 * len(series))
    rows = list(figure.subplots(len(series), 1, sharex=True, squeeze=False)[:, 0])
    for axes, each in zip(rows, series, strict=True):
        style_axes(axes)
        _draw(axes, time_s, each)
        _limit(axes, time_s, each, settled_from_s)
        axes.set_ylabel(each.label)
    rows[-1].set_xlabel("time, s")
    rows[-1].set_xlim(float(time_s[0]), float(time_s[-1]))
    figure.align_ylabels(rows)
    add_legend(figure, rows[0])
    return StudyFigure(key, title, caption, svg_bytes(figure))


def band_figure(
    key: str,
    title: str,
    caption: str,
    time_s: FloatArray,
    curves: dict[str, FloatArray],
    band: tuple[float, float],
    label: str,
) -> StudyFigure:
    """Curves over time against a band they should stay in."""
    figure = _figure(3.0)
    axes = figure.add_subplot()
    style_axes(axes)
    axes.axhspan(*band, color=BAND, linewidth=0, label="95 % bounds")
    for colour, (name, values) in zip(CATEGORIES, curves.items(), strict=False):
        axes.plot(time_s, values, color=colour, linewidth=0.9, label=name)
    if max(float(np.nanmax(values)) for values in curves.values()) > _LOG_FROM * band[1]:
        axes.set_yscale("log")
    else:
        axes.set_ylim(bottom=0.0)
    axes.set_xlim(float(time_s[0]), float(time_s[-1]))
    axes.set_xlabel("time, s")
    axes.set_ylabel(label)
    add_legend(figure, axes)
    return StudyFigure(key, title, caption, svg_bytes(figure))


def _draw(axes: Axes, time_s: FloatArray, series: Series) -> None:
    if series.sd is not None:
        at = envelope(series.sd)
        bound = 3.0 * series.sd[at]
        axes.fill_between(time_s[at], -bound, bound, color=BAND, linewidth=0, label="3 sd stated")
    at = np.arange(len(time_s)) if series.dots else envelope(series.values)
    style = "." if series.dots else "-"
    axes.plot(
        time_s[at],
        series.values[at],
        style,
        color=LINE,
        linewidth=0.8,
        markersize=2.5,
        label="error",
    )
    axes.axhline(0.0, color=MUTED, linewidth=0.6)
    if series.printed is not None:
        for sign in (-1.0, 1.0):
            label = "printed" if sign > 0.0 else None
            level = sign * series.printed
            axes.axhline(level, color=ALERT, linewidth=1.0, linestyle="--", label=label)


def _limit(axes: Axes, time_s: FloatArray, series: Series, settled_from_s: float | None) -> None:
    settled = time_s >= (time_s[0] if settled_from_s is None else settled_from_s)
    largest = float(np.abs(series.values[settled]).max())
    if series.sd is not None:
        largest = max(largest, 3.0 * float(np.median(series.sd[settled])))
    if series.printed is not None:
        largest = max(largest, series.printed)
    axes.set_ylim(-1.1 * largest, 1.1 * largest)


def _figure(height_in: float) -> Figure:
    figure = Figure(figsize=(_WIDTH_IN, height_in), layout="constrained")
    FigureCanvasAgg(figure)
    return figure
