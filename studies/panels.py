"""Figures of the studies: panels of curves over one axis, in the style of the reports."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum, auto
from itertools import cycle

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import LogLocator, MaxNLocator, NullFormatter, StrMethodFormatter

from pcnav.core.arrays import FloatArray
from pcnav.core.statistics import MeanSquared, finite
from pcnav.report.envelope import envelope
from pcnav.report.figures import (
    ALERT,
    BAND,
    CATEGORIES,
    GRID,
    INK,
    LINE,
    MUTED,
    add_legend,
    new_figure,
    style_axes,
    svg_bytes,
)

from .folder import StudyFigure

_ROW_IN = 1.15
_LEGEND_LETTERS = 90
"""In one line of a legend."""
_TRUTH = "#cbd5e1"
"""Of broad lines that others are drawn over."""
_LOG_FROM = 20.0
"""A curve that many times its band, or its own least value, asks for a logarithmic axis."""
_SETTLED_FROM = 0.1
"""Share of a curve after which its start-up transient is over."""


class Scale(Enum):
    """How far the vertical axis of a panel reaches."""

    ABOUT_ZERO = auto()
    """As far down as up; levels are drawn on both sides."""
    FROM_ZERO = auto()
    """From zero, or logarithmic where the curves leave their band or span decades."""
    LOG = auto()
    SETTLED = auto()
    """Over what happens after the first tenth; a start-up transient may leave the axes."""


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


def curves_of(values: Mapping[str, FloatArray]) -> list[Curve]:
    """Plain lines by name."""
    return [Curve(name, each) for name, each in values.items()]


def percentiles_of(values: FloatArray, percentiles: Sequence[float]) -> list[Curve]:
    """Percentiles over the runs of values (n, runs)."""
    found = np.percentile(values, percentiles, axis=1)
    return curves_of({f"{p:g} %": curve for p, curve in zip(percentiles, found, strict=True)})


def error_panel(
    label: str,
    error: FloatArray,
    sd: FloatArray | None = None,
    printed: float | None = None,
    settled_from: int | None = None,
) -> Panel:
    """Errors (n,) about zero, in a band of three stated deviations (n,).

    ``printed`` is the largest error that a paper states, drawn on both sides. From the frame
    ``settled_from`` on errors and typical band fill the axis, so that a start-up transient does
    not flatten the rest.
    """
    limits = None
    if settled_from is not None:
        reach = [np.abs(error[settled_from:]), np.array([0.0 if printed is None else printed])]
        if sd is not None:
            reach.append(np.array([3.0 * np.nanmedian(sd[settled_from:])]))
        top = 1.1 * float(finite(np.concatenate(reach)).max(initial=0.0))
        limits = (-top, top) if top > 0.0 else None
    return Panel(
        label,
        [Curve("error", error, colour=LINE)],
        Scale.ABOUT_ZERO,
        bands={} if sd is None else {"3 sd stated": (-3.0 * sd, 3.0 * sd)},
        levels={} if printed is None else {"printed": printed},
        limits=limits,
    )


def mean_squared_panel(label: str, judged: MeanSquared) -> Panel:
    """Means of squared normalised errors (n,) over the runs, against their 95 % bounds."""
    return Panel(
        label,
        [Curve("mean over the runs", judged.mean, colour=LINE)],
        Scale.FROM_ZERO,
        bands={"95 % bounds": (judged.lower, judged.upper)},
        base=1.0,
    )


def component_panels(
    labels: Sequence[str],
    truth: FloatArray,
    estimates: Mapping[str, FloatArray],
    at: FloatArray | None = None,
    style: str = "-",
) -> list[Panel]:
    """A panel for every component of a truth (n, k) and of estimates by name.

    The estimates are (m, k) at ``at`` (m,), or at the times of the truth.
    """
    return [
        Panel(
            label,
            [
                Curve("truth", truth[:, k], colour=_TRUTH, width=2.0),
                *(Curve(name, values[:, k], at, style) for name, values in estimates.items()),
            ],
        )
        for k, label in enumerate(labels)
    ]


def panels_figure(
    key: str,
    at: FloatArray,
    panels: Sequence[Panel],
    *,
    columns: int = 1,
    row_in: float = _ROW_IN,
    at_label: str = "time, s",
    log_at: bool = False,
    dark: Sequence[tuple[float, float]] = (),
    marked: Sequence[float] = (),
) -> StudyFigure:
    """Panels in rows of so many columns, over the same abscissae (n,) for all.

    The text of the study has title and caption.

    Spans of ``dark`` are shaded: nothing is seen there. Dashed lines stand where ``marked``.
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
        _draw(axes, at, panel)
        same = [each for each in panels if panel.label and each.label == panel.label] or [panel]
        _limit(axes, panel, same)
        if log_at:
            axes.set_xscale("log")
            axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
            _plain_numbers(axes)
        elif len(at) > 1:
            axes.set_xlim(float(at[0]), float(at[-1]))
    for axes in grid.ravel()[len(panels) :]:
        axes.set_visible(False)
    for axes in grid[-1]:
        axes.set_xlabel(at_label)
    figure.align_ylabels(drawn)
    # One legend for all: the first panel names what only others show.
    named = {curve.name for curve in panels[0].curves}
    for panel in panels[1:]:
        for curve, colour in _coloured(panel):
            if curve.name not in named:
                drawn[0].plot([], [], curve.style, color=colour, label=curve.name)
                named.add(curve.name)
    longest = max(1, *(len(name) for name in named))
    add_legend(figure, drawn[0], max_columns=min(5, max(2, _LEGEND_LETTERS // longest)))
    return StudyFigure(key, svg_bytes(figure))


def bars_figure(
    key: str,
    groups: Mapping[str, FloatArray],
    names: Sequence[str],
    labels: tuple[str, str],
) -> StudyFigure:
    """Bars (n,) of every group side by side, over their names (n,); labels of both axes."""
    figure = new_figure(3.0)
    axes = figure.add_subplot()
    style_axes(axes)
    width, places = 0.8 / len(groups), np.arange(len(names))
    for k, (colour, (name, values)) in enumerate(zip(CATEGORIES, groups.items(), strict=False)):
        offset = (k - 0.5 * (len(groups) - 1)) * width
        axes.bar(places + offset, values, width, color=colour, label=name)
    axes.set_xticks(places, names)
    axes.set_xlabel(labels[0])
    axes.set_ylabel(labels[1])
    add_legend(figure, axes)
    return StudyFigure(key, svg_bytes(figure))


def _draw(axes: Axes, at: FloatArray, panel: Panel) -> None:
    for name, (low, high) in panel.bands.items():
        shown = envelope(high)
        axes.fill_between(at[shown], low[shown], high[shown], color=BAND, linewidth=0, label=name)
    for curve, colour in _coloured(panel):
        x = at if curve.at is None else curve.at
        shown = envelope(curve.values)
        axes.plot(
            x[shown],
            curve.values[shown],
            curve.style,
            color=colour,
            linewidth=curve.width,
            markersize=3,
            drawstyle="steps-post" if curve.steps else "default",
            label=curve.name,
        )
    for name, level in panel.levels.items():
        axes.axhline(level, color=ALERT, linewidth=1.0, linestyle="--", label=name)
        if panel.scale is Scale.ABOUT_ZERO:
            axes.axhline(-level, color=ALERT, linewidth=1.0, linestyle="--")
    if panel.base is not None:
        axes.axhline(panel.base, color=MUTED, linewidth=0.6)
    axes.set_ylabel(panel.label)
    axes.set_title(panel.title, fontsize=9, loc="left", color=INK)


def _coloured(panel: Panel) -> list[tuple[Curve, str]]:
    palette = cycle((*CATEGORIES, INK))
    return [(curve, curve.colour or next(palette)) for curve in panel.curves]


def _limit(axes: Axes, panel: Panel, same: Sequence[Panel]) -> None:
    """Limits that hold for all panels of the same label."""
    curves = [curve.values for each in same for curve in each.curves]
    bounds = [bound for each in same for pair in each.bands.values() for bound in pair]
    levels = [np.array(list(each.levels.values())) for each in same]
    everything, drawn, band = (
        finite(np.concatenate([*parts, np.zeros(0)]))
        for parts in ([*curves, *bounds, *levels], curves, bounds)
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
    elif panel.scale is Scale.SETTLED:
        late = finite(
            np.concatenate([values[int(_SETTLED_FROM * len(values)) :] for values in curves])
        )
        low, high = float(late.min()), float(late.max())
        margin = 0.1 * max(high - low, 0.02 * max(abs(low), abs(high), 1e-3))
        axes.set_ylim(low - margin, high + margin)
    else:
        least = band.max() if band.size else drawn.min()
        if panel.scale is Scale.LOG or drawn.max() > _LOG_FROM * least > 0.0:
            axes.set_yscale("log")
            axes.yaxis.set_major_locator(LogLocator(numticks=5))
            _plain_numbers(axes)
            positive = everything[everything > 0.0]
            axes.set_ylim(0.8 * float(positive.min()), 1.25 * float(positive.max()))
        else:
            axes.set_ylim(0.0, 1.05 * float(everything.max()))


def _plain_numbers(axes: Axes) -> None:
    """Powers of ten on logarithmic axes as people write them."""
    for axis in (axes.xaxis, axes.yaxis):
        if axis.get_scale() == "log":
            axis.set_major_formatter(StrMethodFormatter("{x:g}"))
            axis.set_minor_formatter(NullFormatter())
