"""Figures of the tracking study, in the look of the reports."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, MaxNLocator, NullFormatter, StrMethodFormatter

from pcnav.core.arrays import FloatArray, IntArray
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
from .bars import MeanSquared

_WIDTH_IN = 5.8
_LOG_FROM = 5.0
"""A mean this many times its bound asks for a logarithmic axis."""


@dataclass(frozen=True)
class StartCurve:
    """Cold starts of one satellite."""

    name: str
    frames: IntArray
    """(locks,) frames until the lock."""
    attitude_rad: FloatArray
    """(locks,) error at it."""
    starts: int


@dataclass(frozen=True)
class BlockCurve:
    """Mean NEES per degree of freedom of one block over time, and its 95 % bounds."""

    name: str
    mean: FloatArray
    """(n,), nan where no run has an estimate; the bounds likewise."""
    lower: FloatArray
    upper: FloatArray

    @staticmethod
    def of(name: str, judged: Sequence[MeanSquared]) -> "BlockCurve":
        """The curve of the means of every frame."""
        means = np.array([(each.mean, each.lower, each.upper) for each in judged])
        return BlockCurve(name, *means.T)


def start_figures(
    curves: list[StartCurve], max_frames: int, right_rad: float
) -> tuple[StudyFigure, ...]:
    """How many frames a lock takes, and how far off it is."""
    return (_lock_figure(curves, max_frames), _error_figure(curves, right_rad))


def _lock_figure(curves: list[StartCurve], max_frames: int) -> StudyFigure:
    figure = _figure(3.0)
    axes = figure.add_subplot()
    style_axes(axes)
    width = 0.8 / len(curves)
    places = np.arange(1, max_frames + 2)
    for k, (curve, colour) in enumerate(zip(curves, CATEGORIES, strict=False)):
        locked = np.bincount(curve.frames, minlength=max_frames + 1)[1 : max_frames + 1]
        shares = np.append(locked, curve.starts - locked.sum()) / curve.starts
        offset = (k - 0.5 * (len(curves) - 1)) * width
        axes.bar(places + offset, 100.0 * shares, width, color=colour, label=curve.name)
    axes.set_xticks(places, [*(str(k) for k in places[:-1]), "not yet"])
    axes.set_xlabel("frames to lock")
    axes.set_ylabel("starts, %")
    add_legend(figure, axes)
    caption = "Locks, right or wrong, by the frame that was first called locked or ambiguous."
    return StudyFigure("start_frames", "Frames to lock", caption, svg_bytes(figure))


def _error_figure(curves: list[StartCurve], right_rad: float) -> StudyFigure:
    figure = _figure(3.0)
    axes = figure.add_subplot()
    style_axes(axes)
    for curve, colour in zip(curves, CATEGORIES, strict=False):
        degrees = np.sort(np.rad2deg(curve.attitude_rad))
        reached = 100.0 * np.arange(1, len(degrees) + 1) / curve.starts
        axes.step(degrees, reached, where="post", color=colour, linewidth=1.2, label=curve.name)
    axes.axvline(float(np.rad2deg(right_rad)), color=ALERT, linewidth=1.0, linestyle="--")
    axes.set_xscale("log")
    axes.xaxis.set_major_locator(LogLocator(numticks=8))
    axes.xaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.set_ylim(0.0, 105.0)
    axes.set_xlabel("attitude error at lock, deg")
    axes.set_ylabel("starts below, %")
    add_legend(figure, axes)
    caption = "Dashed: 5 degrees, beyond which a lock is wrong."
    return StudyFigure("start_errors", "How far off the locks are", caption, svg_bytes(figure))


def coasting_figure(
    key: str,
    title: str,
    caption: str,
    time_s: FloatArray,
    pose_error: FloatArray,
    pose_sd: FloatArray,
    dark_s: tuple[float, float],
) -> StudyFigure:
    """Errors (n, 6) of a pose with three stated deviations (n, 6), m and rad; nan leaves gaps."""
    degrees = float(np.rad2deg(1.0))
    scales = ((1e3, "mm"),) * 3 + ((degrees, "deg"),) * 3
    figure = _figure(0.7 + 0.95 * len(scales))
    rows = list(figure.subplots(len(scales), 1, sharex=True, squeeze=False)[:, 0])
    for k, (axes, (scale, unit)) in enumerate(zip(rows, scales, strict=True)):
        style_axes(axes)
        error, bound = scale * pose_error[:, k], 3.0 * scale * pose_sd[:, k]
        axes.axvspan(*dark_s, color=GRID, linewidth=0)
        axes.fill_between(time_s, -bound, bound, color=BAND, linewidth=0, label="3 sd stated")
        axes.plot(time_s, error, color=LINE, linewidth=0.9, label="error")
        axes.axhline(0.0, color=MUTED, linewidth=0.6)
        shown = np.concatenate([np.abs(error), bound])[np.isfinite(np.tile(error, 2))]
        if shown.size:
            axes.set_ylim(-1.1 * float(shown.max()), 1.1 * float(shown.max()))
        axes.yaxis.set_major_locator(MaxNLocator(nbins=3, symmetric=True))
        axes.set_ylabel(f"{'xyz'[k % 3]}, {unit}")
    rows[-1].set_xlabel("time, s")
    rows[-1].set_xlim(float(time_s[0]), float(time_s[-1]))
    figure.align_ylabels(rows)
    add_legend(figure, rows[0])
    return StudyFigure(key, title, caption, svg_bytes(figure))


def block_figure(
    key: str, title: str, caption: str, time_s: FloatArray, curves: list[BlockCurve]
) -> StudyFigure:
    """One row per block, sharing the time axis; a row that leaves its band far is logarithmic."""
    figure = _figure(0.8 + 0.95 * len(curves))
    rows = list(figure.subplots(len(curves), 1, sharex=True, squeeze=False)[:, 0])
    for axes, curve in zip(rows, curves, strict=True):
        style_axes(axes)
        axes.fill_between(
            time_s, curve.lower, curve.upper, color=BAND, linewidth=0, label="95 % bounds"
        )
        axes.plot(time_s, curve.mean, color=LINE, linewidth=0.9, label="mean over the runs")
        axes.axhline(1.0, color=MUTED, linewidth=0.6)
        known = np.isfinite(curve.mean)
        if known.any() and curve.mean[known].max() > _LOG_FROM * np.nanmax(curve.upper):
            axes.set_yscale("log")
            axes.yaxis.set_major_locator(LogLocator(numticks=4))
            axes.yaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
            axes.yaxis.set_minor_formatter(NullFormatter())
        else:
            axes.set_ylim(bottom=0.0)
            axes.yaxis.set_major_locator(MaxNLocator(nbins=3))
        axes.set_ylabel(curve.name)
    rows[-1].set_xlabel("time, s")
    rows[-1].set_xlim(float(time_s[0]), float(time_s[-1]))
    figure.align_ylabels(rows)
    add_legend(figure, rows[0])
    return StudyFigure(key, title, caption, svg_bytes(figure))


def _figure(height_in: float) -> Figure:
    figure = Figure(figsize=(_WIDTH_IN, height_in), layout="constrained")
    FigureCanvasAgg(figure)
    return figure
