"""The time line of one or two runs: status, inlier ratio, error over sigma, events."""

from collections.abc import Sequence
from itertools import groupby
from typing import Any

import numpy as np

from pcnav.core.arrays import FloatArray
from pcnav.viewer.assessment import SIGMA_BOUND, error_over_sigma, inlier_ratio, nis_over_bound
from pcnav.viewer.events import Event, Kind
from pcnav.viewer.loaded_run import LoadedRun
from pcnav.viewer.palette import (
    ACCEPTED_COLOUR,
    AMBIGUOUS,
    COASTING,
    PLAIN,
    REJECTED_COLOUR,
    RUNS,
    STATUS,
    Rgb,
    hex_of,
)

_MAX_BARS = 500
_MAX_RATIO = 6.0
"""Of error over sigma and NIS over its bound: what is larger fills the height."""
_EVENT_COLOURS: dict[Kind, Rgb] = {
    Kind.LOCK: ACCEPTED_COLOUR,
    Kind.LOSS: REJECTED_COLOUR,
    Kind.FLIP: AMBIGUOUS,
    Kind.STATUS: COASTING,
    Kind.REJECTED: PLAIN,
}


def time_line(runs: tuple[LoadedRun, ...], events: Sequence[Event]) -> dict[str, Any]:
    """All that the page draws of it."""
    first = runs[0].run.time_s
    pairs = [(loaded, colour) for loaded, colour in zip(runs, RUNS, strict=False) if len(loaded)]
    ends = [(loaded.run.time_s[0], _edges(loaded.run.time_s)[-1]) for loaded, _ in pairs]
    span = [min(a for a, _ in ends), max(b for _, b in ends)] if ends else [0.0, 1.0]
    return {
        "span": [float(each) for each in span],
        "runs": [_row(loaded, colour) for loaded, colour in pairs],
        "events": [
            {
                "time": float(first[event.frame]),
                "colour": hex_of(_EVENT_COLOURS[event.kind]),
                "text": text_of(event, runs),
            }
            for event in events
        ],
    }


def text_of(event: Event, runs: tuple[LoadedRun, ...]) -> str:
    """What happened, of which run where there are two."""
    of_which = f"{runs[event.run].name}, " if len(runs) > 1 else ""
    return f"{of_which}{event.kind} at frame {event.frame}: {event.text}"


def _row(loaded: LoadedRun, colour: Rgb) -> dict[str, Any]:
    edges, inliers, ratio = (
        _edges(loaded.run.time_s),
        inlier_ratio(loaded),
        error_over_sigma(loaded),
    )
    bars = []
    if inliers is not None:
        lowest = -_largest(-100.0 * inliers)
        bars.append(_bars("inliers, %", edges, lowest, 100.0, None, "100 %"))
    if ratio is not None and np.isfinite(ratio).any():
        name, end = "|error| / σ", f"{_MAX_RATIO:g} σ"
        bars.append(_bars(name, edges, _largest(ratio), _MAX_RATIO, SIGMA_BOUND, end))
    else:
        nis = nis_over_bound(loaded)
        if np.isfinite(nis).any():
            name, end = "NIS / bound", f"{_MAX_RATIO:g} ×"
            bars.append(_bars(name, edges, _largest(nis), _MAX_RATIO, 1.0, end))
    return {
        "name": loaded.name,
        "colour": hex_of(colour),
        "status": status_spans(loaded.run.status, edges),
        "bars": bars,
    }


def status_spans(status: Sequence[str], edges_s: FloatArray) -> list[list[Any]]:
    """Start, end, colour and name of each stretch of one status; ``edges_s`` (n + 1,)."""
    spans, k = [], 0
    for name, frames in groupby(status):
        n = len(list(frames))
        colour = hex_of(STATUS.get(name, PLAIN))
        spans.append([float(edges_s[k]), float(edges_s[k + n]), colour, name])
        k += n
    return spans


def _edges(time_s: FloatArray) -> FloatArray:
    """(n + 1,) when frames begin, and when the last ends: it takes as long as is usual."""
    step = float(np.median(np.diff(time_s))) if len(time_s) > 1 else 1.0
    return np.append(time_s, time_s[-1] + step)


def _largest(values: FloatArray) -> FloatArray:
    """(m,) the largest of so many frames each, of values (n,); nan where no frame has one."""
    size = _frames_a_bar(len(values))
    padded = np.full(-(-len(values) // size) * size, np.nan)
    padded[: len(values)] = values
    return np.asarray(np.fmax.reduce(padded.reshape(-1, size), axis=1))


def _frames_a_bar(n: int) -> int:
    return max(1, -(-n // _MAX_BARS))


def _bars(
    name: str, edges_s: FloatArray, heights: FloatArray, top: float, bound: float | None, end: str
) -> dict[str, Any]:
    """Bars of heights (m,), of frames that begin and end at ``edges_s`` (n + 1,)."""
    edges = np.append(edges_s[: -1 : _frames_a_bar(len(edges_s) - 1)], edges_s[-1])
    return {
        "name": name,
        "edges": [round(float(t), 6) for t in edges],
        "values": [float(f"{v:.4g}") if np.isfinite(v) else None for v in heights],
        "top": top,
        "bound": bound,
        "scale": end,
    }
