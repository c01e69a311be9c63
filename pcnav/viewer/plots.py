"""The plots beside the scene: what the page draws of a chosen group, and what its lines mean."""

from dataclasses import dataclass
from html import escape
from itertools import zip_longest
from typing import Any

import numpy as np

from pcnav.core.arrays import BoolArray, FloatArray, IntArray
from pcnav.viewer.curves import Chart, ChartGroup, difference_names, differences, groups_of
from pcnav.viewer.loaded_run import LoadedRun
from pcnav.viewer.palette import REJECTED_COLOUR, RUNS, Rgb, coloured, hex_of, rgba_of

_KNOWN: Rgb = (80, 130, 255)
_NO_ESTIMATE: Rgb = REJECTED_COLOUR
_DIFFERENCE = "difference: "


@dataclass(frozen=True)
class Plots:
    """A group of plots of one or two runs."""

    data: dict[str, Any]
    """As the page takes it."""
    key: str
    """HTML of what the lines mean."""


def choices(runs: tuple[LoadedRun, ...]) -> tuple[str, ...]:
    """The groups that can be chosen."""
    of_both = tuple(f"{_DIFFERENCE}{name}" for name in difference_names(runs))
    return (*groups_of(runs[0]), *of_both)


def plots_of(runs: tuple[LoadedRun, ...], name: str) -> Plots:
    """A group by its name among `choices`."""
    if name.startswith(_DIFFERENCE):
        groups = [(differences(runs, name.removeprefix(_DIFFERENCE)), RUNS[1], runs[1].name)]
    else:
        makers = [groups_of(loaded).get(name) for loaded in runs]
        shown = zip(makers, RUNS, runs, strict=False)
        groups = [(make(), colour, run.name) for make, colour, run in shown if make is not None]
    charts = [[(chart, colour, run) for chart in group.charts] for group, colour, run in groups]
    rows = [[each for each in row if each is not None] for row in zip_longest(*charts)]
    times = [chart.time_s for row in rows for chart, _, _ in row if len(chart.time_s)]
    first, last = (min(t[0] for t in times), max(t[-1] for t in times)) if times else (0.0, 1.0)
    data = {
        "span": [float(first), float(last if last > first else first + 1.0)],
        "charts": [_plot(row) for row in rows if any(len(chart.time_s) for chart, _, _ in row)],
    }
    return Plots(data, _key(runs, [group for group, _, _ in groups]))


def _plot(row: list[tuple[Chart, Rgb, str]]) -> dict[str, Any]:
    first, several = row[0][0], len(row) > 1
    linear = [chart.linear_to for chart, _, _ in row if chart.linear_to is not None]
    lines, bands, shades = [], [], []
    for chart, colour, run in row:
        if chart.estimated is not None and not chart.estimated.all():
            shades.append(_shade(chart.time_s, ~chart.estimated, _NO_ESTIMATE))
        if chart.known is not None and chart.known.any():
            shades.append(_shade(chart.time_s, chart.known, _KNOWN))
        at = with_gaps(chart.values, chart.shown())
        if chart.low is not None and chart.high is not None:
            drawn = with_gaps(chart.low + chart.high, chart.shown())
            low, high = _numbers(chart.low, drawn), _numbers(chart.high, drawn)
            times = _times(chart.time_s, drawn)
            bands.append({"fill": rgba_of(colour, 0.22), "t": times, "low": low, "high": high})
        lines.append(
            {
                "name": run if several else first.label.split(",")[0],
                "colour": hex_of(colour),
                "dots": chart.is_dots,
                "t": _times(chart.time_s, at),
                "v": _numbers(chart.values, at),
            }
        )
    return {
        "label": first.label,
        "linear": max(linear, default=None),
        "bound": first.bound,
        "lines": lines,
        "bands": bands,
        "shades": shades,
    }


def with_gaps(values: FloatArray, shown: IntArray) -> IntArray:
    """Those of the indices ``shown`` that have a value, and -1 wherever one without lies between.

    A line is broken there: nothing is drawn where there is nothing.
    """
    has = np.isfinite(values)
    kept = shown[has[shown]]
    lacking = np.concatenate([[0], np.cumsum(~has)])
    gaps = np.flatnonzero(lacking[kept[1:]] > lacking[kept[:-1]]) + 1
    return np.asarray(np.insert(kept, gaps, -1))


def _times(time_s: FloatArray, at: IntArray) -> list[float]:
    """Times of indices; that of a gap is the one before."""
    filled = np.where(at < 0, np.roll(at, 1), at)
    return [float(f"{t:.8g}") for t in time_s[filled]]


def _numbers(values: FloatArray, at: IntArray) -> list[float | None]:
    return [None if k < 0 else float(f"{values[k]:.5g}") for k in at]


def _shade(time_s: FloatArray, wanted: BoolArray, colour: Rgb) -> dict[str, Any]:
    """Spans of the frames that are wanted, each from half a frame before to half after."""
    padded = np.concatenate([[False], wanted, [False]]).astype(np.int8)
    starts, ends = np.flatnonzero(np.diff(padded) == 1), np.flatnonzero(np.diff(padded) == -1) - 1
    middles = 0.5 * (time_s[1:] + time_s[:-1])
    edges = np.concatenate([time_s[:1], middles, time_s[-1:]])
    spans = [[float(edges[a]), float(edges[b + 1])] for a, b in zip(starts, ends, strict=True)]
    return {"fill": rgba_of(colour, 0.16), "spans": spans}


def _key(runs: tuple[LoadedRun, ...], groups: list[ChartGroup]) -> str:
    """What the lines mean, as HTML."""
    parts = []
    if groups and groups[0].charts:
        first = groups[0].charts[0]
        what = "error: truth minus estimate" if first.is_error else "estimate"
        if first.high is not None and first.bound is None:
            what += ", band ±3σ as stated"
        parts.append(f"<b>{escape(groups[0].title)}</b>: {what}")
        if groups[0].remark:
            parts.append(f"{coloured('■', _KNOWN)} {escape(groups[0].remark)}")
        remarks = []
        charts = [chart for group in groups for chart in group.charts]
        if any(chart.estimated is not None and not chart.estimated.all() for chart in charts):
            remarks.append(f"{coloured('■', _NO_ESTIMATE)} no estimate")
        if first.linear_to is not None:
            unit = first.label.partition(",")[2]
            remarks.append(f"log scale beyond ±{first.linear_to:g}{escape(unit)}")
        if remarks:
            parts.append("&emsp;".join(remarks))
        if first.bound is not None:
            parts.append(f"{coloured('- -', REJECTED_COLOUR)} 95 % of frames below")
    pairs = zip(runs, RUNS, strict=False)
    names = [f"{coloured('━', colour)} {escape(loaded.name)}" for loaded, colour in pairs]
    parts.append("&emsp;".join([*names, "│ this frame"]))
    lines = "".join(f"<div>{part}</div>" for part in parts)
    style = "font-size:12px;line-height:1.5;padding:2px 8px"
    return f"<div class='pcnav-key' style='{style}'>{lines}</div>"
