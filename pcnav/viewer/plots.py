"""The plots beside the scene, of one browser: one group at a time, with a cursor at its frame."""

from collections.abc import Callable
from dataclasses import dataclass
from html import escape
from itertools import zip_longest

import numpy as np
import viser
from viser import uplot

from pcnav.core.arrays import BoolArray, FloatArray
from pcnav.viewer.curves import Chart, ChartGroup, groups_of
from pcnav.viewer.loaded_run import LoadedRun
from pcnav.viewer.palette import RUNS, TRUTH, Rgb, coloured, hex_of, rgba_of

_HEIGHT_OF_ALL_PX = 610
_FRAME_PX = 24
"""About each plot."""
_MAX_HEIGHT_PX = 190
_BOUND: Rgb = (255, 110, 90)
_KNOWN: Rgb = (70, 220, 110)
_CURSOR: Rgb = (255, 255, 255)
_TEXT, _GRID = "#c8ccd4", "rgba(255,255,255,0.09)"
_TICK_PX = 26
"""The numbers of an axis are at least so far apart."""
_UNIT_SCALE = "unit"
"""A vertical scale from 0 to 1 of the whole plot: of the cursor and of what is shaded."""


_Row = list[tuple[Chart, Rgb]]
"""What one plot shows: a chart of each run, in the run's colour."""


class PlotsPanel:
    """The plots of one or two runs in a tab of the browser's panel."""

    def __init__(
        self,
        gui: viser.GuiApi,
        tab: viser.GuiTabHandle,
        runs: tuple[LoadedRun, ...],
        time_s: float,
        on_choice: Callable[[], None],
    ) -> None:
        self._gui, self._tab, self._runs = gui, tab, runs
        with tab:
            self._choice = gui.add_dropdown("plots", tuple(groups_of(runs[0])))
            self._key = gui.add_html("")
        self._plots: list[_Plot] = []
        self._time_s = time_s
        self._choice.on_update(lambda _: on_choice())
        self.draw_choice()

    def go_on(self, runs: tuple[LoadedRun, ...], time_s: float) -> None:
        """Draw the chosen group of later states of the same runs."""
        self._runs, self._time_s = runs, time_s
        rows = self._rows()
        fits = len(rows) == len(self._plots)
        if not (fits and all(map(_Plot.takes, self._plots, rows, [time_s] * len(rows)))):
            self.draw_choice()

    def move_cursor(self, time_s: float) -> None:
        """Move the line that marks the frame."""
        if time_s == self._time_s:
            return
        self._time_s = time_s
        for plot in self._plots:
            plot.move_cursor(time_s)

    def draw_choice(self) -> None:
        """Draw the chosen group, in place of what is there."""
        rows = self._rows()
        for plot in self._plots:
            plot.remove()
        self._plots = []
        height = min(_HEIGHT_OF_ALL_PX // max(len(rows), 1) - _FRAME_PX, _MAX_HEIGHT_PX)
        with self._tab:
            for k, row in enumerate(rows):
                last = k == len(rows) - 1
                self._plots.append(_Plot(self._gui, row, height, self._time_s, last=last))

    def _rows(self) -> list[_Row]:
        """The plots from top to bottom: the charts of each and the colours of their runs."""
        name = self._choice.value
        makers = [groups_of(loaded).get(name) for loaded in self._runs]
        drawn = zip(makers, RUNS, strict=False)
        groups = [(make(), colour) for make, colour in drawn if make is not None]
        self._key.content = _key(self._runs, [group for group, _ in groups])
        if not len(self._runs[0]):
            return []
        charts = [[(chart, colour) for chart in group.charts] for group, colour in groups]
        return [[each for each in row if each is not None] for row in zip_longest(*charts)]


class _Plot:
    """One uPlot chart."""

    def __init__(
        self, gui: viser.GuiApi, row: _Row, height: int, time_s: float, *, last: bool
    ) -> None:
        self._height = height
        self._drawing = drawing = _drawing_of(row, height)
        self._handle = gui.add_uplot(
            data=drawing.with_cursor(time_s),
            series=tuple(drawing.series),
            bands=tuple(drawing.bands),
            scales=drawing.scales,
            axes=(
                _axis("time, s" if last else None, 36 if last else 20),
                _value_axis(drawing.label, drawing.ticks),
            ),
            legend={"show": False},
            cursor={"drag": {"x": True, "y": False}},
            height=height,
            padding=(8, 12, 0, 0),
        )

    def takes(self, row: _Row, time_s: float) -> bool:
        """Show later data in the same lines; whether they fit, else the plot is to be removed."""
        before, drawing = self._drawing, _drawing_of(row, self._height)
        self._drawing = drawing
        if (drawing.label, drawing.ticks, drawing.series) != (
            before.label,
            before.ticks,
            before.series,
        ):
            return False
        self._handle.scales = drawing.scales
        self.move_cursor(time_s)
        return True

    def move_cursor(self, time_s: float) -> None:
        """Move the line that marks the frame."""
        self._handle.data = self._drawing.with_cursor(time_s)

    def remove(self) -> None:
        """Take it off the page."""
        self._handle.remove()


@dataclass(frozen=True)
class _Drawing:
    """What one plot draws: time and series of all runs on the times of all of them.

    Its cursor is a line of the data: three rows at the same time take it from the foot of the
    plot to its top and back. All other series are carried over to these rows by interpolation.
    """

    label: str
    columns: list[FloatArray]
    """Time first."""
    series: list[uplot.Series]
    bands: list[uplot.Band]
    scales: dict[str, uplot.Scale]
    ticks: list[float]
    """Of a logarithmic axis; empty for a linear one."""

    def with_cursor(self, time_s: float) -> tuple[FloatArray, ...]:
        """The data of all series with the cursor at a time."""
        x, *others = self.columns
        time_s = min(max(time_s, float(x[0])), float(x[-1]))
        at = int(np.searchsorted(x, time_s, side="right"))
        data = [np.insert(x, at, (time_s, time_s, time_s))]
        for values in others:
            there = float(np.interp(time_s, x, values))
            data.append(np.insert(values, at, (there, there, there)))
        # Below the foot of the plot, where it is not seen.
        cursor = np.full(len(x) + 3, -0.1)
        cursor[at + 1] = 1.0
        return (*data, cursor)


def _drawing_of(row: _Row, height: int) -> _Drawing:
    times = [chart.time_s[chart.shown()] for chart, _ in row]
    x = np.unique(np.concatenate([*times, *(_edges(chart) for chart, _ in row)]))
    columns, series, bands = [x], [uplot.Series()], list[uplot.Band]()

    def add(values: FloatArray, line: uplot.Series) -> None:
        columns.append(values)
        series.append(line)

    for chart, colour in row:
        at = chart.shown()
        time_s = chart.time_s[at]
        if chart.lacks.any():
            add(_steps(x, chart.time_s, chart.lacks), _shade(_BOUND))
        if chart.known is not None and chart.known.any():
            add(_steps(x, time_s, chart.known[at]), _shade(_KNOWN))
        if chart.high is not None and chart.low is not None:
            edge = _line(rgba_of(colour, 0.55), 1)
            add(_carried(x, time_s, chart.high[at]), edge)
            add(_carried(x, time_s, chart.low[at]), edge)
            both = (len(series) - 2, len(series) - 1)
            bands.append({"series": both, "fill": rgba_of(colour, 0.16)})
        line = _dots(colour) if chart.is_dots else _line(hex_of(colour), 1.6)
        add(_carried(x, time_s, chart.values[at]), line)
    first = row[0][0]
    if first.bound is not None:
        add(np.full(len(x), first.bound), {**_line(hex_of(_BOUND), 1.5), "dash": (6, 4)})
    series.append(_line(hex_of(_CURSOR), 1.2, _UNIT_SCALE))
    linear = [chart.linear_to for chart, _ in row if chart.linear_to is not None]
    scales, ticks = _scales(columns, max(linear, default=None), height)
    return _Drawing(first.label, columns, series, bands, scales, ticks)


def _scales(
    columns: list[FloatArray], linear_to: float | None, height: int
) -> tuple[dict[str, uplot.Scale], list[float]]:
    """Scales by name, and the ticks of a logarithmic one."""
    first, last = float(columns[0][0]), float(columns[0][-1])
    scales: dict[str, uplot.Scale] = {
        "x": {
            "time": False,
            "range": (first, last) if last > first else (first - 0.5, last + 0.5),
        },
        _UNIT_SCALE: {"range": (0.0, 1.0)},
    }
    if linear_to is None:
        return scales, []
    scales["y"] = {"distr": 4, "asinh": linear_to}
    largest = float(max(np.abs(values).max() for values in columns[1:]))
    return scales, two_sided_ticks(linear_to, largest, height // _TICK_PX)


def _line(stroke: str, width: float, scale: str = "y") -> uplot.Series:
    return {"scale": scale, "stroke": stroke, "width": width, "points": {"show": False}}


def _dots(colour: Rgb) -> uplot.Series:
    fill = hex_of(colour)
    points: uplot.Series_Points = {"show": True, "size": 4, "fill": fill, "stroke": fill}
    return {**_line(rgba_of(colour, 0.0), 0), "points": points}


def _shade(colour: Rgb) -> uplot.Series:
    fill = rgba_of(colour, 0.13)
    return {"scale": _UNIT_SCALE, "width": 0, "fill": fill, "points": {"show": False}}


def _edges(chart: Chart) -> FloatArray:
    """Times just before and after each change between an estimate and none: shades end upright."""
    missing = ~np.isfinite(chart.values)
    changes = np.flatnonzero(missing[1:] != missing[:-1])
    before, after = chart.time_s[changes], chart.time_s[changes + 1]
    middle, apart = 0.5 * (before + after), 1e-3 * (after - before)
    return np.concatenate([middle - apart, middle + apart])


def _carried(x: FloatArray, time_s: FloatArray, values: FloatArray) -> FloatArray:
    """Values at other times, by interpolation, without nan: uPlot takes that for a number.

    Where a series is missing it keeps its nearest value; the plot shades what has no estimate.
    """
    known = np.isfinite(values)
    if not known.any():
        return np.zeros(len(x))
    return np.asarray(np.interp(x, time_s[known], values[known]))


def _steps(x: FloatArray, time_s: FloatArray, wanted: BoolArray) -> FloatArray:
    """1 at the times that are wanted, 0 elsewhere."""
    return np.round(np.interp(x, time_s, wanted.astype(np.float64)))


def _axis(label: str | None, size: int) -> uplot.Axis:
    axis: uplot.Axis = {
        "stroke": _TEXT,
        "grid": {"stroke": _GRID, "width": 1},
        "ticks": {"show": False},
        "gap": 4,
        "size": size,
        "font": "11px sans-serif",
        "labelFont": "12px sans-serif",
    }
    if label is not None:
        axis["label"] = label
        axis["labelSize"] = 16
    return axis


def _value_axis(label: str, ticks: list[float]) -> uplot.Axis:
    axis = _axis(label, 62)
    axis["scale"] = "y"
    if ticks:
        # Given as lists, uPlot takes both for the answer of the functions it would call.
        axis["splits"] = tuple(ticks)
        # viser's type knows it as a function only.
        axis["filter"] = tuple(ticks)  # type: ignore[typeddict-item]
    return axis


def two_sided_ticks(linear_to: float, largest: float, most: int) -> list[float]:
    """Numbers on an axis that is linear to a power of ten and logarithmic beyond, both ways.

    Zero and at most so many powers of ten, the largest within the data among them.
    """
    first, last = round(np.log10(linear_to)), int(np.floor(np.log10(max(largest, linear_to))))
    a_side = max((most - 1) // 2, 1)
    step = max(1, -(-(last - first + 1) // a_side))
    powers = [10.0**k for k in range(last, first - 1, -step)]
    return [*(-power for power in powers), 0.0, *reversed(powers)]


def _key(runs: tuple[LoadedRun, ...], groups: list[ChartGroup]) -> str:
    """What the lines mean, as HTML."""
    parts = []
    if groups and groups[0].charts:
        first = groups[0].charts[0]
        what = "error: truth minus estimate" if first.is_error else "estimate"
        if first.high is not None:
            what += ", band ±3σ as stated"
        parts.append(f"<b>{escape(groups[0].title)}</b>: {what}")
        if groups[0].remark:
            parts.append(f"{coloured('■', _KNOWN)} {escape(groups[0].remark)}")
        remarks = []
        if any(chart.lacks.any() for group in groups for chart in group.charts):
            remarks.append(f"{coloured('■', _BOUND)} no estimate")
        if first.linear_to is not None:
            remarks.append("log scale beyond the innermost numbers")
        if remarks:
            parts.append("&emsp;".join(remarks))
        if first.bound is not None:
            parts.append(f"{coloured('- -', _BOUND)} 95 % of frames below")
    pairs = zip(runs, RUNS, strict=False)
    names = [f"{coloured('━', colour)} {escape(loaded.name)}" for loaded, colour in pairs]
    parts.append("&emsp;".join([*names, f"{coloured('│', TRUTH)} this frame"]))
    lines = "".join(f"<div>{part}</div>" for part in parts)
    return f"<div style='font-size:12px;line-height:1.5;padding:2px 8px'>{lines}</div>"
