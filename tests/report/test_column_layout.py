"""Panels in a column: drawn, their texts take no more room than they were given."""

from itertools import combinations

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from pcnav.report.panels import Curve, Panel, Scale, panels_figure


def drawn_boxes(figure: Figure) -> list[tuple[float, float, float, float]]:
    """Left, bottom, right and top of each axes with its texts, and of the legend; in inches."""
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    renderer = canvas.get_renderer()
    parts = [*figure.axes, *figure.legends]
    boxes = [part.get_tightbbox(renderer) for part in parts]
    return [tuple(np.array(box.extents) / figure.dpi) for box in boxes if box is not None]


def small_and_large(scale: float) -> list[Panel]:
    at = np.linspace(0.0, 1.0, 50)
    return [
        Panel("x, mm", [Curve("estimate", scale * at), Curve("truth", -scale * at)]),
        Panel("attitude, deg", [Curve("estimate", 1e-3 * scale * (at - 0.5))], Scale.ABOUT_ZERO),
        Panel("z", [Curve("estimate", np.exp(scale * at))], Scale.LOG),
    ]


@pytest.mark.parametrize("scale", [1e-4, 0.3, 5.0, -12.0])
def test_texts_stay_inside_and_apart(scale: float) -> None:
    figure = panels_figure(np.arange(50.0), small_and_large(scale))
    width, height = figure.get_size_inches()
    boxes = drawn_boxes(figure)
    assert len(boxes) == 4
    for left, bottom, right, top in boxes:
        assert left > 0.0 and bottom > 0.0 and right < width and top < height
    for one, other in combinations(boxes, 2):
        # The tick labels at the ends of neighbouring axes may come as near as a line is high.
        assert one[1] > other[3] - 0.05 or other[1] > one[3] - 0.05


def test_names_of_axes_stand_below_each_other_and_off_the_ticks() -> None:
    figure = panels_figure(np.arange(50.0), small_and_large(5.0))
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    renderer = canvas.get_renderer()
    names = [axes.yaxis.label.get_window_extent(renderer) for axes in figure.axes]
    assert np.ptp([name.x1 for name in names]) < 0.5
    for axes, name in zip(figure.axes, names, strict=True):
        low, high = axes.get_ylim()
        ticks = [
            label.get_window_extent(renderer)
            for label in axes.get_yticklabels()
            if low <= label.get_position()[1] <= high
        ]
        assert name.x1 < min(tick.x0 for tick in ticks)


def test_numbers_with_a_factor_are_left_to_matplotlib() -> None:
    tiny = [Panel("x", [Curve("a", 1e-7 * np.arange(50.0))])] * 2
    assert panels_figure(np.arange(50.0), tiny).get_layout_engine() is not None


def test_a_name_longer_than_its_axes_is_left_to_matplotlib() -> None:
    curve = Curve("a", np.arange(50.0))
    plain = panels_figure(np.arange(50.0), [Panel("x", [curve])] * 2)
    long = panels_figure(
        np.arange(50.0), [Panel("a quantity with a name of many words, m", [curve])] * 2
    )
    assert plain.get_layout_engine() is None
    assert long.get_layout_engine() is not None
