"""Figures made of panels: curves with their bands over one axis, usually the time."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum, auto
from itertools import cycle

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import (
    FixedLocator,
    LogLocator,
    MaxNLocator,
    NullLocator,
    StrMethodFormatter,
)

from pcnav.core.arrays import FloatArray
from pcnav.core.statistics import finite
from pcnav.report.column_layout import laid_out_in_column
from pcnav.report.envelope import BUCKETS, envelope
from pcnav.report.figures import (
    ALERT,
    BAND,
    BOUND,
    CATEGORIES,
    GRID,
    INK,
    MUTED,
    add_legend,
    new_figure,
    style_axes,
)

ROW_IN = 1.15
_LEGEND_LETTERS = 90
"""In one line of a legend."""
_LOG_FROM = 20.0
"""A curve that many times its band, or its own least value, asks for a logarithmic axis."""
_DIPS_PERCENT = 2.0
"""Of a curve of magnitudes may leave the axis below."""
_SETTLED_FROM = 0.1
"""Share of a curve after which its start-up transient is over."""
_LABELS_APART = 0.07
"""Of the axis: abscissae closer than this share a label."""
_TRANSIENT_FROM = 2.0
"""Times the range of the rest that a start-up transient takes at least."""


class Scale(Enum):
    """How far the vertical axis of a panel reaches."""

    ABOUT_ZERO = auto()
    """As far down as up; levels are drawn on both sides."""
    FROM_ZERO = auto()
    """From zero, or logarithmic where the curves leave their band or span decades."""
    LOG = auto()
    SETTLED = auto()
    """Over what happens after the first tenth, where a start-up transient would flatten it."""
    MAGNITUDE = auto()
    """Logarithmic, over all but the lowest hundredths of each curve: where an error changes sign
    its magnitude falls to nothing."""


@dataclass(frozen=True)
class Curve:
    """A line of a panel."""

    name: str
    """In the legend."""
    values: FloatArray
    """(n,), nan leaves gaps."""
    at: FloatArray | None = None
    """(n,) its abscissae, where they are not those of the figure."""
    style: str = "-"
    """Of line and markers, as matplotlib writes it."""
    colour: str | None = None
    """The next of the palette if not given."""
    width: float = 0.9
    steps: bool = False
    """Level from each point to the next."""
    bars: tuple[FloatArray, FloatArray] | None = None
    """Ends (n,) of an interval about each value; nan without one."""


@dataclass(frozen=True)
class Panel:
    """One pair of axes; panels of one label share their scale."""

    label: str
    """Quantity and unit."""
    curves: Sequence[Curve]
    scale: Scale = Scale.SETTLED
    title: str = ""
    bands: Mapping[str, tuple[FloatArray, FloatArray]] = field(default_factory=dict)
    """Lower and upper bounds (n,) by name."""
    levels: Mapping[str, float] = field(default_factory=dict)
    """Heights of dashed lines by name."""
    base: float | None = None
    """Height of the thin line that a curve should lie on."""
    limits: tuple[float, float] | None = None
    """Of the vertical axis, where its scale does not give them."""
    edges: bool = False
    """Whether the bounds are drawn over the curves: a long noisy series would bury them."""


def panels_figure(
    at: FloatArray,
    panels: Sequence[Panel],
    *,
    columns: int = 1,
    row_in: float = ROW_IN,
    at_label: str = "time, s",
    log_at: bool = False,
    ticks: bool = False,
    dark: Sequence[tuple[float, float]] = (),
    marked: Sequence[float] = (),
) -> Figure:
    """Panels in rows of so many columns, over the same abscissae (n,) for all.

    Spans of ``dark`` are shaded: nothing is seen there. Dashed lines stand where ``marked``.
    ``ticks`` labels the abscissae themselves, as far as their labels do not touch.
    """
    rows = -(-len(panels) // columns)
    figure = new_figure(0.7 + row_in * rows)
    grid = figure.subplots(rows, columns, sharex=True, squeeze=False)
    drawn: list[Axes] = list(grid.ravel()[: len(panels)])
    for axes, panel in zip(drawn, panels, strict=True):
        style_axes(axes)
        for span in dark:
            axes.axvspan(*span, color=GRID, linewidth=0)
        for place in marked:
            axes.axvline(place, color=ALERT, linewidth=1.0, linestyle="--")
        same = [each for each in panels if panel.label and each.label == panel.label]
        draw_panel(axes, at, panel, same)
        if log_at:
            axes.set_xscale("log")
            axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
            _plain_numbers(axes)
        elif len(at) > 1 and not ticks:
            axes.set_xlim(float(at[0]), float(at[-1]))
        if ticks:
            axes.xaxis.set_major_locator(FixedLocator(_apart(at, log_at)))
            axes.xaxis.set_minor_locator(NullLocator())
            axes.xaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
    for axes in grid.ravel()[len(panels) :]:
        axes.set_visible(False)
    for axes in grid[-1]:
        axes.set_xlabel(at_label)
    # One legend for all: the first panel names what only others show.
    named = {curve.name for curve in panels[0].curves}
    for panel in panels[1:]:
        for curve, colour in _coloured(panel):
            if curve.name not in named:
                drawn[0].plot([], [], curve.style, color=colour, label=curve.name)
                named.add(curve.name)
    longest = max(1, *(len(name) for name in named))
    in_line = min(5, max(2, _LEGEND_LETTERS // longest))
    add_legend(figure, drawn[0], max_columns=in_line)
    labels = len(drawn[0].get_legend_handles_labels()[1])
    is_plain = columns == 1 and not any(panel.title for panel in panels)
    if not (is_plain and laid_out_in_column(figure, drawn, -(-labels // in_line))):
        figure.align_ylabels(drawn)
    return figure


def _apart(at: FloatArray, logarithmic: bool) -> list[float]:
    """Those of the abscissae (n,), rising, whose labels do not touch."""
    coordinate = np.log(at) if logarithmic else at
    shown = [0]
    for k in range(1, len(at)):
        if coordinate[k] - coordinate[shown[-1]] > _LABELS_APART * np.ptp(coordinate):
            shown.append(k)
    return [float(at[k]) for k in shown]


def draw_panel(axes: Axes, at: FloatArray, panel: Panel, same: Sequence[Panel] = ()) -> None:
    """Curves, bands and levels of a panel, at abscissae (n,); its limits hold ``same`` as well."""
    steps = any(curve.steps for curve in panel.curves)
    for name, (low, high) in panel.bands.items():
        shown = envelope(high)
        axes.fill_between(
            at[shown],
            low[shown],
            high[shown],
            step="post" if steps else None,
            color=BAND,
            linewidth=0,
            label=None if panel.edges else name,
        )
    for curve, colour in _coloured(panel):
        _draw_curve(axes, at if curve.at is None else curve.at, curve, colour)
    for name, (low, high) in panel.bands.items():
        if panel.edges:
            shown = envelope(high)
            axes.plot(at[shown], low[shown], color=BOUND, linewidth=0.9, label=name)
            axes.plot(at[shown], high[shown], color=BOUND, linewidth=0.9)
    for name, level in panel.levels.items():
        axes.axhline(level, color=ALERT, linewidth=1.0, linestyle="--", label=name)
        if panel.scale is Scale.ABOUT_ZERO:
            axes.axhline(-level, color=ALERT, linewidth=1.0, linestyle="--")
    if panel.base is not None:
        axes.axhline(panel.base, color=MUTED, linewidth=0.6)
    axes.set_ylabel(panel.label)
    axes.set_title(panel.title, fontsize=9, loc="left", color=INK)
    _limit(axes, panel, same or [panel])


def _draw_curve(axes: Axes, x: FloatArray, curve: Curve, colour: str) -> None:
    dots_alone = not curve.style.strip(".o")
    shown = np.arange(len(x)) if dots_alone else envelope(curve.values)
    values = curve.values[shown]
    lines = axes.plot(
        x[shown],
        values,
        curve.style,
        color=colour,
        linewidth=curve.width,
        markersize=3,
        drawstyle="steps-post" if curve.steps else "default",
        label=curve.name,
    )
    if curve.bars is not None:
        ends = np.nan_to_num(np.abs(np.stack(curve.bars)[:, shown] - values))
        axes.errorbar(
            x[shown], values, ends, fmt="none", ecolor=colour, elinewidth=curve.width, capsize=2
        )
    if dots_alone:
        # As pixels, thousands of dots cost no more than a few, and none has to be left out.
        lines[0].set_rasterized(len(x) > BUCKETS)
    else:
        # A line of one point between two gaps has no length.
        gaps = np.isnan(np.concatenate([[np.nan], values, [np.nan]]))
        alone = ~gaps[1:-1] & gaps[:-2] & gaps[2:]
        axes.plot(x[shown][alone], values[alone], ".", color=colour, markersize=3)


def _coloured(panel: Panel) -> list[tuple[Curve, str]]:
    palette = cycle((*CATEGORIES, INK))
    return [(curve, curve.colour or next(palette)) for curve in panel.curves]


def _limit(axes: Axes, panel: Panel, same: Sequence[Panel]) -> None:
    """Limits that hold for all panels of the same label."""
    curves = [curve.values for each in same for curve in each.curves]
    bounds = [bound for each in same for pair in each.bands.values() for bound in pair]
    bars = [end for each in same for curve in each.curves for end in curve.bars or ()]
    levels = [np.array(list(each.levels.values())) for each in same]
    everything, drawn, band = (
        finite(np.concatenate([*parts, np.zeros(0)]))
        for parts in ([*curves, *bounds, *bars, *levels], curves, bounds)
    )
    if panel.scale is Scale.ABOUT_ZERO:
        axes.axhline(0.0, color=MUTED, linewidth=0.6)
        axes.yaxis.set_major_locator(MaxNLocator(nbins=3, symmetric=True))
    if panel.limits is not None:
        axes.set_ylim(*panel.limits)
    elif not drawn.size:
        return
    elif panel.scale is Scale.ABOUT_ZERO:
        top = float(np.abs(everything).max()) or 1.0
        axes.set_ylim(-1.1 * top, 1.1 * top)
    elif panel.scale is Scale.MAGNITUDE and (everything > 0.0).any():
        above = [values[values > 0.0] for values in map(finite, curves)]
        ends = [float(np.percentile(each, _DIPS_PERCENT)) for each in above if each.size]
        _one_sided_log(axes, 0.7 * min(ends), 1.5 * float(everything.max()))
    elif panel.scale is Scale.SETTLED:
        late = finite(np.concatenate([_settled(values) for values in (*curves, *bounds)]))
        # A first tenth that takes no more room than the rest is no transient.
        fits = not late.size or np.ptp(everything) < _TRANSIENT_FROM * np.ptp(late)
        shown = everything if fits else late
        low, high = float(shown.min()), float(shown.max())
        margin = 0.1 * max(high - low, 0.02 * max(abs(low), abs(high), 1e-3))
        axes.set_ylim(low - margin, high + margin)
    else:
        least = band.max() if band.size else drawn.min()
        positive = everything[everything > 0.0]
        asked = panel.scale is Scale.LOG or drawn.max() > _LOG_FROM * least > 0.0
        if asked and positive.size:
            _one_sided_log(axes, 0.8 * float(positive.min()), 1.25 * float(positive.max()))
        else:
            axes.set_ylim(0.0, 1.05 * (float(everything.max()) or 1.0))


def _settled(values: FloatArray) -> FloatArray:
    """A series after the first tenth since its first value."""
    known = np.flatnonzero(np.isfinite(values))
    first = int(known[0]) if known.size else len(values)
    return values[first + int(_SETTLED_FROM * (len(values) - first)) :]


def _one_sided_log(axes: Axes, low: float, high: float) -> None:
    axes.set_yscale("log")
    # Two decades may hold one power of ten alone, and one of them none.
    subs = (1.0, 2.0, 5.0) if high < 100.0 * low else (1.0,)
    axes.yaxis.set_major_locator(LogLocator(subs=subs, numticks=6))
    _plain_numbers(axes)
    axes.set_ylim(low, high)


def _plain_numbers(axes: Axes) -> None:
    """Powers of ten on logarithmic axes as people write them."""
    for axis in (axes.xaxis, axes.yaxis):
        if axis.get_scale() == "log":
            axis.set_major_formatter(StrMethodFormatter("{x:g}"))
            # Nothing is written at the minor ticks, and they take half the time of a figure.
            axis.set_minor_locator(NullLocator())
