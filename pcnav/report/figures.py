"""Figures of a run over time, drawn with matplotlib's object interface."""

import io
from collections import Counter

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import (
    FixedLocator,
    LogLocator,
    MaxNLocator,
    NullFormatter,
    NullLocator,
    StrMethodFormatter,
)

from pcnav.core import chi_square
from pcnav.core.arrays import BoolArray, FloatArray, IntArray
from pcnav.evaluation.metrics import squared_normalised_errors
from pcnav.files.text_table import display_unit
from pcnav.report.envelope import BUCKETS, envelope
from pcnav.report.from_run import Track, TrackErrors
from pcnav.runs.records import ACCEPTED

INK, MUTED, GRID = "#1f2937", "#6b7280", "#e5e7eb"
LINE, BAND, BOUND, ALERT = "#1d4ed8", "#bfdbfe", "#f59e0b", "#ea580c"
CATEGORIES = ("#2563eb", "#f59e0b", "#0d9488", "#9333ea", "#db2777", "#65a30d", "#64748b")

_WIDTH_IN = 5.8
_ROW_IN = 1.15
_MAX_OUTCOMES = 9
_CONFIDENCE = 0.95
_DECADES_FROM = 20.0
"""Bounds that shrink by this factor over a run get logarithmic axes."""
LOG_FROM = 20.0
"""A squared error this many times its bound asks for a logarithmic axis."""


def component_figure(
    time_s: FloatArray,
    values: FloatArray,
    sd: FloatArray,
    names: tuple[str, ...],
    unit: str,
    *,
    is_error: bool,
) -> Figure:
    """Components (n, k) over time, one row each, with their 3 sigma bounds.

    Errors are drawn against bounds about zero, estimates inside bounds about themselves. Errors
    that shrink by orders of magnitude get an axis that is linear about zero and logarithmic
    beyond; otherwise the axes span what happens after the first tenth of the run.
    """
    settled = time_s >= time_s[0] + 0.1 * np.ptp(time_s)
    typical = np.abs(values[settled])
    typical = typical[np.isfinite(typical)]
    scale, unit = display_unit(unit, float(np.median(typical)) if typical.size else 1.0)
    figure, rows = stacked_axes(len(names), time_s)
    for k, (axes, name) in enumerate(zip(rows, names, strict=True)):
        value, bound = scale * values[:, k], 3.0 * scale * sd[:, k]
        centre = np.zeros_like(value) if is_error else value
        at = envelope(bound if is_error else value)
        low, high = (centre - bound)[at], (centre + bound)[at]
        axes.fill_between(time_s[at], low, high, color=BAND, linewidth=0)
        shown = envelope(value)
        label = "error (truth - estimate)" if is_error else "estimate"
        axes.plot(time_s[shown], value[shown], color=LINE, linewidth=0.9, label=label)
        # Over the line: a long noisy series would bury them.
        axes.plot(time_s[at], low, color=BOUND, linewidth=0.9, label="3 sigma as stated")
        axes.plot(time_s[at], high, color=BOUND, linewidth=0.9)
        axes.set_ylabel(name if unit == "1" else f"{name}, {unit}")
        if is_error:
            axes.axhline(0.0, color=MUTED, linewidth=0.6)
            if _spans_decades(time_s, bound):
                _set_two_sided_log(axes, time_s, bound, value)
                continue
        _span(axes, np.concatenate([value, centre - bound, centre + bound]), np.tile(settled, 3))
    add_legend(figure, rows[0])
    return figure


def pose_error_figure(time_s: FloatArray, errors: TrackErrors) -> Figure:
    """Error norms of the pose in the camera over time, logarithmic."""
    figure, rows = stacked_axes(2, time_s, row_in=1.6)
    distance = np.linalg.norm(errors.p_cam_m, axis=1)
    known = distance[np.isfinite(distance)]
    scale, unit = display_unit("m", float(np.median(known)) if known.size else 1.0)
    angle = np.rad2deg(np.linalg.norm(errors.theta_model_rad, axis=1))
    for axes, norm, label in (
        (rows[0], scale * distance, f"position, {unit}"),
        (rows[1], angle, "attitude, deg"),
    ):
        at = envelope(norm)
        axes.plot(time_s[at], norm[at], color=LINE, linewidth=0.9)
        if np.any(norm > 0.0):
            axes.set_yscale("log")
            axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 3.0), numticks=8))
            axes.yaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
            axes.yaxis.set_minor_formatter(NullFormatter())
        axes.set_ylabel(label)
    return figure


def consistency_figure(track: Track, errors: TrackErrors | None) -> Figure:
    """NIS, and the NEES where there is a truth, over the 95 % chi-square bound of each frame."""
    series = [("NIS", track.nis, track.nis_dof)]
    if errors is not None and track.covariance is not None and errors.has_state.any():
        nees = squared_normalised_errors(errors.state, track.covariance)
        series.append(("NEES", nees, np.full(len(nees), errors.state.shape[1])))
    figure, rows = stacked_axes(len(series), track.time_s, row_in=1.6)
    for axes, (label, squared, degrees) in zip(rows, series, strict=True):
        used = np.isfinite(squared) & (degrees > 0)
        _draw_squared(axes, track.time_s[used], squared[used], degrees[used])
        axes.set_ylabel(f"{label} / bound")
    add_legend(figure, rows[0])
    return figure


def count_figure(track: Track) -> Figure:
    """Accepted rectangles per frame: in long runs the mean, smallest and largest of each span."""
    figure = new_figure(2.6)
    axes = figure.add_subplot()
    style_axes(axes)
    spans, edges = time_spans(track)
    counts = [track.n_rectangles[span] for span in spans]
    low = np.array([part.min() for part in counts])
    high = np.array([part.max() for part in counts])
    axes.stairs(high, edges, baseline=low, fill=True, color=BAND)
    means = np.array([part.mean() for part in counts])
    axes.stairs(means, edges, baseline=None, color=LINE, linewidth=0.9)
    axes.set_xlim(edges[0], edges[-1])
    axes.set_ylim(0.0, float(high.max()) + 0.5)
    axes.yaxis.set_major_locator(MaxNLocator(nbins=6, integer=True))
    axes.set_ylabel("rectangles used")
    axes.set_xlabel("time, s")
    return figure


def outcome_figure(outcomes: Counter[tuple[str, str]]) -> Figure:
    """How many rectangles were accepted, and why the others were not."""
    totals: Counter[str] = Counter()
    for (_, outcome), count in outcomes.items():
        totals[outcome] += count
    counts = totals.most_common()
    if len(counts) > _MAX_OUTCOMES:
        rest = sum(count for _, count in counts[_MAX_OUTCOMES:])
        counts = [*counts[:_MAX_OUTCOMES], ("other reasons", rest)]
    figure = new_figure(0.8 + 0.26 * max(len(counts), 2))
    axes = figure.add_subplot()
    names = [_shortened(name, 44) for name, _ in counts]
    colours = [LINE if name == ACCEPTED else "#cbd5e1" for name, _ in counts]
    bars = axes.barh(range(len(counts)), [count for _, count in counts], color=colours, height=0.7)
    axes.bar_label(bars, padding=3, fontsize=8, color=INK)
    axes.set_yticks(range(len(counts)), names)
    axes.invert_yaxis()
    axes.margins(x=0.12)
    axes.set_xlabel("rectangles seen")
    style_axes(axes)
    axes.grid(visible=False, axis="y")
    return figure


def time_spans(track: Track) -> tuple[list[IntArray], FloatArray]:
    """The frames in runs of equal length, and the times at which these begin and the last ends."""
    spans = _spans(len(track), BUCKETS)
    return spans, np.array([*(track.time_s[span[0]] for span in spans), end_s(track.time_s)])


def end_s(time_s: FloatArray) -> float:
    """When the last frame ends: it lasts as long as the one before it."""
    return float(2.0 * time_s[-1] - time_s[-2]) if len(time_s) > 1 else float(time_s[0]) + 1.0


def svg_bytes(figure: Figure) -> bytes:
    """The figure as SVG, the same bytes for the same figure."""
    stream = io.BytesIO()
    # Text as outlines looks the same on every machine; the salt and the missing date keep the
    # bytes reproducible.
    with matplotlib.rc_context({"svg.fonttype": "path", "svg.hashsalt": "pcnav"}):
        figure.savefig(stream, format="svg", dpi=200, metadata={"Date": None})
    return stream.getvalue()


def png_bytes(figure: Figure, dots_per_inch: float = 150.0) -> bytes:
    """The figure as PNG."""
    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=dots_per_inch)
    return stream.getvalue()


def _spans(n: int, buckets: int) -> list[IntArray]:
    """The indices 0 to n - 1 cut into at most so many runs of equal length."""
    size = -(-n // buckets)
    return [np.arange(start, min(start + size, n)) for start in range(0, n, size)]


def new_figure(height_in: float) -> Figure:
    """An empty figure as wide as half a report."""
    figure = Figure(figsize=(_WIDTH_IN, height_in), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def stacked_axes(
    rows: int, time_s: FloatArray, row_in: float = _ROW_IN
) -> tuple[Figure, list[Axes]]:
    """Axes above each other that share their time axis, the whole run wide."""
    figure = new_figure(0.6 + row_in * rows)
    grid = figure.subplots(rows, 1, sharex=True, squeeze=False)
    axes: list[Axes] = list(grid[:, 0])
    for each in axes:
        style_axes(each)
    if np.ptp(time_s) > 0.0:
        axes[-1].set_xlim(time_s[0], time_s[-1])
    axes[-1].set_xlabel("time, s")
    figure.align_ylabels(axes)
    return figure, axes


def style_axes(axes: Axes) -> None:
    """Spines, grid and labels in the look of the report."""
    axes.spines[["top", "right"]].set_visible(False)
    axes.spines[["left", "bottom"]].set_color(MUTED)
    axes.grid(visible=True, color=GRID, linewidth=0.6)
    axes.set_axisbelow(True)
    axes.tick_params(labelsize=8, color=MUTED, labelcolor=INK)
    axes.xaxis.label.set(fontsize=8.5, color=INK)
    axes.yaxis.label.set(fontsize=8.5, color=INK)


def add_legend(figure: Figure, axes: Axes, max_columns: int = 4) -> None:
    """The legend of one of the axes, above all of them, where it covers no data."""
    handles, labels = axes.get_legend_handles_labels()
    figure.legend(
        handles,
        [_shortened(label, 32) for label in labels],
        loc="outside upper left",
        ncols=min(len(labels), max_columns) or 1,
        fontsize=8,
        frameon=False,
        markerscale=2.5,
        handlelength=1.4,
        labelcolor=INK,
    )


def _draw_squared(axes: Axes, time_s: FloatArray, squared: FloatArray, degrees: IntArray) -> None:
    """Squared normalised errors as dots, over the 95 % chi-square bound of their frame."""
    # The bound changes with the number of measurements; their ratio has one line to compare with.
    ratio = squared / chi_square.quantile(_CONFIDENCE, degrees)
    axes.axhspan(0.0, 1.0, color=BAND, linewidth=0, label="95 % of the frames belong here")
    for shown, colour, text in ((ratio <= 1.0, LINE, "inside"), (ratio > 1.0, ALERT, "outside")):
        dots = axes.plot(time_s[shown], ratio[shown], ".", markersize=3, color=colour, label=text)
        # As pixels, thousands of dots cost no more than a few, and none has to be left out.
        dots[0].set_rasterized(True)
    if ratio.size and ratio.max() > LOG_FROM:
        axes.set_yscale("log")
    else:
        axes.set_ylim(bottom=0.0)


def _span(axes: Axes, values: FloatArray, settled: BoolArray) -> None:
    """Vertical limits that hold all settled values; a start-up transient may leave the axes."""
    shown = values[settled & np.isfinite(values)]
    if shown.size and np.ptp(shown) > 0.0:
        margin = 0.08 * np.ptp(shown)
        axes.set_ylim(shown.min() - margin, shown.max() + margin)


def _settled_bound(time_s: FloatArray, bound: FloatArray) -> float:
    """The typical bound in the last tenth of the run, nan without any."""
    last = bound[time_s >= time_s[0] + 0.9 * np.ptp(time_s)]
    last = last[np.isfinite(last) & (last > 0.0)]
    return float(np.median(last)) if last.size else np.nan


def _spans_decades(time_s: FloatArray, bound: FloatArray) -> bool:
    """Whether the run settles so far that its start and its end do not fit one linear axis."""
    known = bound[np.isfinite(bound)]
    if not known.size:
        return False
    return bool(known.max() > _DECADES_FROM * _settled_bound(time_s, bound))


def _set_two_sided_log(
    axes: Axes, time_s: FloatArray, bound: FloatArray, error: FloatArray
) -> None:
    """Linear up to the power of ten below the settled bound, logarithmic beyond, all in view."""
    linear = 10.0 ** np.floor(np.log10(_settled_bound(time_s, bound)))
    largest = float(np.nanmax([np.nanmax(bound), np.nanmax(np.abs(error), initial=0.0)]))
    axes.set_yscale("symlog", linthresh=linear)
    top = max(10.0 ** np.floor(np.log10(largest)), linear)
    axes.yaxis.set_major_locator(FixedLocator(sorted({-top, -linear, 0.0, linear, top})))
    axes.yaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
    axes.yaxis.set_minor_locator(NullLocator())
    axes.set_ylim(-1.5 * largest, 1.5 * largest)
    axes.text(
        *(1.0, 1.01),
        f"linear to ±{linear:g}, logarithmic beyond",
        transform=axes.transAxes,
        ha="right",
        va="bottom",
        fontsize=6.5,
        color=MUTED,
    )


def _shortened(text: str, length: int) -> str:
    return text if len(text) <= length else text[: length - 1] + "…"
