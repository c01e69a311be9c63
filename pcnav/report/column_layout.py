"""The layout of panels in one column, from the sizes of their texts.

Matplotlib's constrained layout draws all tick labels of a figure several times to find how much
room they take, which is most of the time of a report. Here it follows from the number of their
characters.
"""

from collections.abc import Sequence

from matplotlib.axes import Axes
from matplotlib.figure import Figure

_POINTS = 72.0
"""To an inch."""
_TICK_PT, _LABEL_PT = 8.0, 8.5
"""Size of the text at ticks, and of the names of axes; as `pcnav.report.figures.style_axes` has."""
_DIGIT, _LETTER, _LINE = 0.637, 0.58, 1.2
"""Width of a digit and mean width of a letter of DejaVu Sans, and the height of a line, in sizes of
the text."""
_NARROW = {".": 0.318, ",": 0.318, "\N{MINUS SIGN}": 0.838}
_TICK_PAD_PT, _LABEL_PAD_PT, _EDGE_PT = 7.0, 3.0, 4.0
"""From axes to text, from text to the name of the axis, and at the edges of the figure."""
_BETWEEN_PT, _RIGHT_PT = 10.0, 12.0
"""Between panels, whose outermost tick labels stand out; to the right of them, likewise."""
_LEGEND_LINE_PT, _LEGEND_PT = 12.0, 12.0
"""Height of a line of a legend, and what is about all of them."""


def laid_out_in_column(figure: Figure, column: Sequence[Axes], legend_lines: int) -> bool:
    """Lay out panels, the upper first, that share their abscissae, have no titles and stand below
    a legend of so many lines.

    Whether that can be done: not where the name of an axis is longer than it, or where its numbers
    have a factor, which stands above it.
    """
    width_pt, height_pt = (_POINTS * size for size in figure.get_size_inches().tolist())
    top = _LEGEND_PT + _LEGEND_LINE_PT * legend_lines
    bottom = _EDGE_PT + (_LABEL_PT + _TICK_PT) * _LINE + _TICK_PAD_PT + _LABEL_PAD_PT
    n = len(column)
    panel_pt = (height_pt - top - bottom - (n - 1) * _BETWEEN_PT) / n
    longest = max(len(axes.get_ylabel()) for axes in column)
    if longest * _LETTER * _LABEL_PT > panel_pt + _BETWEEN_PT:
        return False
    engine = figure.get_layout_engine()
    figure.set_layout_engine(None)
    place = {
        "bottom": bottom / height_pt,
        "top": 1.0 - top / height_pt,
        "hspace": _BETWEEN_PT / panel_pt,
        "right": 1.0 - _RIGHT_PT / width_pt,
    }
    # How many ticks there are follows from the height of the panels.
    figure.subplots_adjust(**place)
    ticks_pt = max(_tick_width_pt(axes) for axes in column)
    if any(axes.yaxis.get_major_formatter().get_offset() for axes in column):
        figure.set_layout_engine(engine)
        return False
    to_label_pt = _TICK_PAD_PT + ticks_pt + _LABEL_PAD_PT
    left_pt = _EDGE_PT + _LABEL_PT * _LINE + to_label_pt
    figure.subplots_adjust(left=left_pt / width_pt, **place)
    panel_width_pt = width_pt - left_pt - _RIGHT_PT
    for axes in column:
        axes.yaxis.set_label_coords(-to_label_pt / panel_width_pt, 0.5)
    return True


def _tick_width_pt(axes: Axes) -> float:
    """Of the longest label at the ticks of the vertical axis that are shown."""
    axis = axes.yaxis
    low, high = sorted(axes.get_ylim())
    shown = [tick for tick in axis.get_majorticklocs().tolist() if low <= tick <= high]
    texts = axis.get_major_formatter().format_ticks(shown)
    return _TICK_PT * max(
        (sum(_NARROW.get(letter, _DIGIT) for letter in text) for text in texts), default=0.0
    )
