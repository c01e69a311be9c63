"""What a run was made of: frames, rectangles, features, attitudes, and the estimator's notes."""

from collections import Counter

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from pcnav.core.arrays import FloatArray
from pcnav.dynamics.blocks import ATTITUDE
from pcnav.files.text_table import MISSING, TextTable, display_unit, number
from pcnav.report.content import ReportContent
from pcnav.report.envelope import Spans
from pcnav.report.figures import (
    ALERT,
    BOUND,
    INK,
    LINE,
    PALE,
    add_legend,
    drawing,
    new_figure,
    shortened,
    style_axes,
)
from pcnav.report.page import Piece
from pcnav.report.panels import Curve, Panel, Scale, panels_figure
from pcnav.report.status import STATUS_COLOURS
from pcnav.runs.reader import count_outcomes, read_features
from pcnav.runs.records import ACCEPTED
from pcnav.runs.result_files import MEASUREMENTS_FILE
from pcnav.runs.run import Run

_COUNTS = (
    (
        "rectangles",
        "Rectangles the filter used per frame: mean and range of short spans of frames.",
        {"n_rectangles": "used"},
    ),
    (
        "features",
        "Seen, used by the filter and rejected by its gate: means of short spans of frames.",
        {"n_features": "seen", "n_used": "used", "n_rejected": "rejected"},
    ),
    (
        "features",
        "Seen, shared with the frame compared with, and in agreement with the motion found: means "
        "of short spans of frames.",
        {"features": "seen", "matches": "matches", "agreeing": "agreeing"},
    ),
)
"""What is counted in a frame: its name, a caption, and the columns of the counts with theirs."""
_MEASURED = "sd_measured_rad"
"""A note of runs on attitudes: the deviation of the one taken in."""
_SHOWN_ELSEWHERE = {"inlier_ratio", "segment", _MEASURED} | {
    column for _, _, columns in _COUNTS for column in columns
}
_MAX_NOTES = 8
_MAX_OUTCOMES = 9


def frames_by_outcome(content: ReportContent) -> list[Piece]:
    """What became of every frame, in the words of the estimator."""
    run = content.run
    outcomes = run.words.get("outcome", ())
    if not outcomes:
        return []
    if _MEASURED in run.notes:
        text = "Attitudes come from the images; a frame that is not measured is coasted through."
    else:
        text = (
            "The first frame of a segment is given its attitude: it defines the body axes and is "
            "not compared with the truth. Another frame that is not measured has none, and says "
            "why."
        )
    if len(run.segments) > 1:
        text += (
            f" The chain had to begin anew: {len(run.segments)} segments, each with body axes of "
            "its own, the camera's at its first frame. Attitudes of different segments cannot be "
            "compared."
        )
    elif run.segments:
        text += " The body axes are the camera's at the first frame of the chain."
    counts = Counter(outcomes).most_common()
    rows = tuple((name, str(n), f"{n / len(run):.1%}") for name, n in counts)
    caption = "What became of every frame, coloured by status."
    figure = drawing("Outcomes", caption, _frame_figure(run, [name for name, _ in counts]))
    return [text, (figure, TextTable("", "", ("outcome", "frames", "share"), rows))]


def measurements(content: ReportContent) -> list[Piece]:
    """What was seen and used over time, what became of it, and the points found."""
    if not len(content.run):
        return []
    parts = (_counts, _rectangles, _attitudes, _points)
    figures = tuple(piece for part in parts for piece in part(content))
    table = _feature_table(content)
    return [*([figures] if figures else []), *([table] if table else [])]


def _counts(content: ReportContent) -> list[Piece]:
    run = content.run
    return [
        drawing(
            f"{name.capitalize()} per frame",
            caption,
            count_figure(run.time_s, {text: run.notes[key] for key, text in keys.items()}, name),
        )
        for name, caption, keys in _COUNTS
        if keys.keys() <= run.notes.keys()
    ]


def _rectangles(content: ReportContent) -> list[Piece]:
    """How often each was seen and used, and why not."""
    folder = content.run.folder
    if folder is None or not (folder / MEASUREMENTS_FILE).is_file():
        return []
    outcomes = count_outcomes(folder)
    if not outcomes:
        return [("No rectangle was seen.",)]
    seen: Counter[str] = Counter()
    for (rectangle, _), count in outcomes.items():
        seen[rectangle] += count
    used = {rectangle: outcomes[rectangle, ACCEPTED] for rectangle in seen}
    rows = tuple(
        (name or "not recognised", str(count), str(used[name]), f"{used[name] / count:.1%}")
        for name, count in seen.most_common()
    )
    caption = f"{outcomes.total()} rectangles seen in the run."
    figure = drawing("What became of the rectangles", caption, outcome_figure(outcomes))
    return [(figure, TextTable("", "", ("rectangle", "seen", "used", "share used"), rows))]


def _attitudes(content: ReportContent) -> list[Piece]:
    """How certain the attitudes taken in are, and the estimate from them."""
    run = content.run
    measured = run.notes.get(_MEASURED)
    if measured is None or not run.has_estimate.any():
        return []
    stated = np.sqrt(np.mean(run.trajectory.sd_of(ATTITUDE) ** 2, axis=1))
    curves = [
        Curve("taken in", np.rad2deg(measured), style=".", colour=ALERT),
        Curve("estimate", np.rad2deg(stated), colour=LINE),
    ]
    figure = panels_figure(run.time_s, [Panel("sd, deg", curves, Scale.LOG)], row_in=2.2)
    caption = "Root mean square about an axis: of the attitudes taken in, and of the estimate."
    return [drawing("Attitudes taken in", caption, figure)]


def _points(content: ReportContent) -> list[Piece]:
    """The errors of the points of a run without a model."""
    rms_m = None if content.metrics.errors is None else content.metrics.errors.points_rms_m
    if rms_m is None or not np.isfinite(rms_m).any():
        return []
    scale, unit = display_unit("m", float(np.nanmedian(rms_m)))
    panel = Panel(f"RMS error, {unit}", [Curve("", scale * rms_m, colour=LINE)], Scale.LOG)
    figure = panels_figure(content.run.time_s, [panel], row_in=2.0)
    caption = "Root mean square distance of the estimated points from the true ones."
    return [drawing("Error of the points", caption, figure)]


def _feature_table(content: ReportContent) -> TextTable | None:
    """The points at the end of a run, and how often they were seen."""
    table = None if content.run.folder is None else read_features(content.run.folder)
    if table is None:
        return None
    known = (content.metrics.errors.point_m if content.metrics.errors is not None else None) or {}
    header = ("feature", "x, m", "y, m", "z, m", "sd x, m", "sd y, m", "sd z, m")
    header = (*header, "frames seen", "rejected", *(("error, m",) if known else ()))
    rows = []
    for k, i in enumerate(table.feature.tolist()):
        point = np.concatenate([table.p_body[k], table.sd[k]])
        numbers = [f"{value:.4f}" if np.isfinite(value) else MISSING for value in point]
        counts = (str(table.frames_seen[k]), str(table.frames_rejected[k]))
        error = [number(known.get(i, np.nan))] if known else []
        rows.append((str(i), *numbers, *counts, *error))
    return TextTable("", "Features", header, tuple(rows))


def own_notes(content: ReportContent) -> list[Piece]:
    """The numbers that the estimator notes of itself, beyond those that have a section."""
    run = content.run
    notes = {
        name: values
        for name, values in run.notes.items()
        if name not in _SHOWN_ELSEWHERE and np.isfinite(values).any()
    }
    if not notes:
        return []
    shown = list(notes.items())[:_MAX_NOTES]
    panels = [Panel(name, [Curve("", values, colour=BOUND)]) for name, values in shown]
    figure = panels_figure(run.time_s, panels)
    rows = tuple(
        (name, number(float(values[np.isfinite(values)][-1]))) for name, values in notes.items()
    )
    caption = "What the estimator notes of itself."
    table = TextTable("", "", ("note", "last value"), rows)
    return [(drawing("Over time", caption, figure), table)]


def count_figure(time_s: FloatArray, counts: dict[str, FloatArray], label: str) -> Figure:
    """Counts per frame by name, as means over spans in long runs: the others over the first.

    One alone has its range in each span.
    """
    spans = Spans(time_s)
    # A line that is level from each edge on has to be told where the last level ends.
    series = {
        name: np.append(each := spans.mean(np.nan_to_num(values)), each[-1])
        for name, values in counts.items()
    }
    first, *others = counts
    if others:
        bands = {first: (np.zeros_like(series[first]), series[first])}
    else:
        low, high = spans.extremes(np.nan_to_num(counts[first]))
        bands, others = {"range": (np.append(low, low[-1]), np.append(high, high[-1]))}, [first]
    curves = [
        Curve(name, series[name], colour=colour, steps=True)
        for name, colour in zip(others, (LINE, ALERT), strict=False)
    ]
    panel = Panel(label, curves, Scale.FROM_ZERO, bands=bands)
    figure = panels_figure(spans.edges_s, [panel], row_in=2.0)
    figure.axes[0].yaxis.set_major_locator(MaxNLocator(nbins=6, integer=True))
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
    names = [shortened(name, 44) for name, _ in counts]
    colours = [LINE if name == ACCEPTED else PALE for name, _ in counts]
    bars = axes.barh(range(len(counts)), [count for _, count in counts], color=colours, height=0.7)
    axes.bar_label(bars, padding=3, fontsize=8, color=INK)
    axes.set_yticks(range(len(counts)), names)
    axes.invert_yaxis()
    axes.margins(x=0.12)
    axes.set_xlabel("rectangles seen")
    style_axes(axes)
    axes.grid(visible=False, axis="y")
    return figure


def _frame_figure(run: Run, names: list[str]) -> Figure:
    """A tick a frame in the row of its outcome, in the colour of its status."""
    figure = new_figure(0.9 + 0.3 * max(len(names), 2))
    axes = figure.add_subplot()
    style_axes(axes)
    place, statuses = np.array([names.index(o) for o in run.words["outcome"]]), np.array(run.status)
    for status in dict.fromkeys(run.status):
        at, colour = statuses == status, STATUS_COLOURS[status]
        axes.plot(run.time_s[at], place[at], "|", color=colour, markersize=9)
        axes.plot([], [], "s", color=colour, markersize=2.5, label=status)
    axes.set_yticks(range(len(names)), names)
    axes.set_ylim(len(names) - 0.5, -0.5)
    axes.set_xlabel("time, s")
    add_legend(figure, axes)
    return figure
