"""Drawings of the study: points and their paths, truth against estimate, errors over time."""

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from pcnav.core.arrays import FloatArray
from pcnav.recordings.monocular import MonocularTracks
from pcnav.report.figures import ALERT, CATEGORIES, INK, LINE, add_legend, style_axes, svg_bytes

from ..folder import StudyFigure
from . import paper
from .scene import Truth

_WIDTH_IN = 5.8
_POINT = "#ca8a04"


def _figure(height_in: float) -> Figure:
    figure = Figure(figsize=(_WIDTH_IN, height_in), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def feature_figure(tracks: MonocularTracks) -> StudyFigure:
    """Fig. 5: the points seen at the first frame."""
    figure = _figure(4.2)
    axes = figure.add_subplot()
    style_axes(axes)
    pixels = tracks.frames[0].pixels
    axes.plot(pixels[:, 0], pixels[:, 1], "o", color=_POINT, markersize=4, label="point")
    _image_axes(axes, pixels)
    title, caption = "Fig. 5: features", "Points of the hull that face the camera, first frame."
    return StudyFigure("fig_5", title, caption, svg_bytes(figure))


def path_figure(truth: Truth) -> StudyFigure:
    """Fig. 6: the paths of the points in space."""
    figure = _figure(3.2)
    grid = figure.subplots(1, 2)
    p = truth.points[:12] @ np.swapaxes(truth.R_world_body, 1, 2)
    for axes, (i, j) in zip(grid, ((0, 1), (0, 2)), strict=True):
        style_axes(axes)
        axes.plot(p[:, :, i], p[:, :, j], color=LINE, linewidth=0.8)
        axes.plot(p[-1, :, i], p[-1, :, j], "o", color=_POINT, markersize=3)
        axes.set_xlabel(f"{'xyz'[i]}, m")
        axes.set_ylabel(f"{'xyz'[j]}, m")
        axes.set_aspect("equal", adjustable="datalim")
    caption = "A dozen points about the mass centre, camera axes, seen along z and along y."
    return StudyFigure("fig_6", "Fig. 6: paths in space", caption, svg_bytes(figure))


def track_figure(tracks: MonocularTracks) -> StudyFigure:
    """Fig. 7: the paths of the points in the image."""
    figure = _figure(4.2)
    axes = figure.add_subplot()
    style_axes(axes)
    paths: dict[int, list[FloatArray]] = {}
    for frame in tracks.frames:
        for feature, pixels in zip(frame.features.tolist(), frame.pixels, strict=True):
            paths.setdefault(feature, []).append(pixels)
    everything = np.concatenate([frame.pixels for frame in tracks.frames])
    for path in paths.values():
        along = np.array(path)
        axes.plot(along[:, 0], along[:, 1], color=LINE, linewidth=0.7)
        axes.plot(along[-1, 0], along[-1, 1], "o", color=_POINT, markersize=3)
    _image_axes(axes, everything)
    caption = "Where each point was seen; the dot is where it was seen last."
    return StudyFigure("fig_7", "Fig. 7: paths in the image", caption, svg_bytes(figure))


def comparison_figure(
    key: str,
    title: str,
    caption: str,
    truth: tuple[FloatArray, FloatArray],
    estimate: tuple[FloatArray, FloatArray],
    labels: Sequence[str],
) -> StudyFigure:
    """Components (n, k) of truth and estimate, each with its times (n,)."""
    figure = _figure(0.7 + 1.1 * len(labels))
    rows = list(figure.subplots(len(labels), 1, sharex=True, squeeze=False)[:, 0])
    for k, (axes, label) in enumerate(zip(rows, labels, strict=True)):
        style_axes(axes)
        axes.plot(truth[0], truth[1][:, k], color=LINE, linewidth=1.0, label="truth")
        at, values = estimate
        axes.plot(at, values[:, k], ".--", color=ALERT, linewidth=0.8, markersize=3, label="images")
        axes.set_ylabel(label)
    rows[-1].set_xlabel("time, s")
    rows[-1].set_xlim(float(truth[0][0]), float(truth[0][-1]))
    figure.align_ylabels(rows)
    add_legend(figure, rows[0])
    return StudyFigure(key, title, caption, svg_bytes(figure))


def curves_figure(
    key: str,
    title: str,
    caption: str,
    panels: Mapping[str, Mapping[str, tuple[FloatArray, FloatArray]]],
    label: str,
) -> StudyFigure:
    """Curves (times, values) by panel and name, on logarithmic axes of one scale."""
    figure = _figure(0.6 + 1.9 * len(panels))
    rows = list(figure.subplots(len(panels), 1, sharex=True, sharey=True, squeeze=False)[:, 0])
    for axes, (name, curves) in zip(rows, panels.items(), strict=True):
        style_axes(axes)
        for colour, (which, (times_s, values)) in zip(CATEGORIES, curves.items(), strict=False):
            axes.plot(times_s, values, ".-", color=colour, linewidth=0.9, markersize=2, label=which)
        axes.set_yscale("log")
        axes.set_ylabel(label)
        axes.set_title(name, fontsize=9, loc="left", color=INK)
    rows[-1].set_xlabel("time, s")
    add_legend(figure, rows[0])
    return StudyFigure(key, title, caption, svg_bytes(figure))


def _image_axes(axes: Axes, pixels: FloatArray) -> None:
    middle = np.array([paper.CAMERA.cx, paper.CAMERA.cy])
    half = 1.1 * float(np.abs(pixels - middle).max())
    axes.set_xlim(middle[0] - half, middle[0] + half)
    # Image rows count downwards.
    axes.set_ylim(middle[1] + half, middle[1] - half)
    axes.set_aspect("equal")
    axes.set_xlabel("u, px")
    axes.set_ylabel("v, px")
