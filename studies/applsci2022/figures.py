"""Drawings of the study: points and their paths, in the image and in space."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes

from pcnav.core.arrays import FloatArray
from pcnav.recordings.tracks import MonocularTracks
from pcnav.report.figures import LINE, new_figure, style_axes, svg_bytes

from ..folder import StudyFigure
from . import paper
from .scene import Truth

_POINT = "#ca8a04"


def feature_figure(tracks: MonocularTracks) -> StudyFigure:
    """Fig. 5: the points seen at the first frame."""
    return _in_the_image("fig_5", list(tracks.frames[0].pixels[:, None]))


def track_figure(tracks: MonocularTracks) -> StudyFigure:
    """Fig. 7: the paths of the points in the image."""
    paths: dict[int, list[FloatArray]] = {}
    for frame in tracks.frames:
        for feature, pixels in zip(frame.features.tolist(), frame.pixels, strict=True):
            paths.setdefault(feature, []).append(pixels)
    return _in_the_image("fig_7", [np.array(path) for path in paths.values()])


def path_figure(truth: Truth) -> StudyFigure:
    """Fig. 6: the paths of the points in space."""
    figure = new_figure(3.2)
    p = truth.points[:12] @ np.swapaxes(truth.R_world_body, 1, 2)
    for axes, (i, j) in zip(figure.subplots(1, 2), ((0, 1), (0, 2)), strict=True):
        _draw(axes, np.swapaxes(p[..., [i, j]], 0, 1), (f"{'xyz'[i]}, m", f"{'xyz'[j]}, m"))
        axes.set_aspect("equal", adjustable="datalim")
    return StudyFigure("fig_6", svg_bytes(figure))


def _in_the_image(key: str, paths: Sequence[FloatArray]) -> StudyFigure:
    figure = new_figure(4.2)
    axes = figure.add_subplot()
    _draw(axes, paths, ("u, px", "v, px"))
    middle = np.array([paper.CAMERA.cx, paper.CAMERA.cy])
    half = 1.1 * float(np.abs(np.concatenate(paths) - middle).max())
    axes.set_xlim(middle[0] - half, middle[0] + half)
    # Image rows count downwards.
    axes.set_ylim(middle[1] + half, middle[1] - half)
    axes.set_aspect("equal")
    return StudyFigure(key, svg_bytes(figure))


def _draw(axes: Axes, paths: Sequence[FloatArray] | FloatArray, labels: tuple[str, str]) -> None:
    """Paths (n, 2), each with a dot at its end."""
    style_axes(axes)
    for path in paths:
        axes.plot(path[:, 0], path[:, 1], color=LINE, linewidth=0.8)
        axes.plot(path[-1, 0], path[-1, 1], "o", color=_POINT, markersize=3)
    axes.set_xlabel(labels[0])
    axes.set_ylabel(labels[1])
