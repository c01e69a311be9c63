"""The status of a run over time, on what evidence, and how it changed."""

from collections import Counter
from itertools import pairwise

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from pcnav.core.arrays import FloatArray
from pcnav.core.statistics import chi_square_bounds
from pcnav.files.text_table import MISSING, TextTable, number
from pcnav.report.content import ReportContent
from pcnav.report.envelope import Spans
from pcnav.report.figures import CATEGORIES, LINE, add_legend, drawing, new_figure, style_axes
from pcnav.report.page import Piece
from pcnav.report.panels import Curve, Panel, Scale, draw_panel
from pcnav.runs.doubts import COLUMN, TOLD, Doubt, doubts_in
from pcnav.runs.nis_window import NIS_WINDOW_FRAMES, NisWindow
from pcnav.runs.run import Run

STATUS_COLOURS = {
    "acquiring": "#94a3b8",
    "locked": "#16a34a",
    "ambiguous": "#f59e0b",
    "coasting": "#9333ea",
    "lost": "#dc2626",
}
"""The same colour for a status in every report, worse ones last."""

_STRIP, _EVIDENCE = 0.45, 1.3
"""Heights of the panels, inches."""
_MAX_CHANGES = 25


def status_and_evidence(content: ReportContent) -> list[Piece]:
    """What the run said of itself over time, and on what evidence."""
    run = content.run
    if not len(run):
        return []
    caption = "; ".join(["Frames by status", *_evidence(run)]) + "."
    figure = drawing("Status and its evidence", caption, status_figure(run))
    changes = [k for k in range(1, len(run)) if run.status[k] != run.status[k - 1]]
    beside: list[Piece] = []
    if changes:
        beside.append(_changes(run, changes[:_MAX_CHANGES]))
    else:
        beside.append(f"The status is {run.status[0]} in every frame.")
    if len(changes) > _MAX_CHANGES:
        beside.append(f"{len(changes) - _MAX_CHANGES} later changes are not listed.")
    if "ambiguous" in run.status:
        beside.append(_ambiguity(content.answer.symmetry))
    if any(run.words.get("motion", ())):
        beside.append(_motion(run))
    beside += _doubts(run)
    return [(figure, tuple(beside))]


def status_figure(run: Run) -> Figure:
    """The status of each frame as coloured bands, over the evidence it was decided on.

    That is the share of the frame explained and the NIS of the last frames, each where known.
    """
    evidence, spans = [*_evidence(run).values()], Spans(run.time_s)
    heights = [_STRIP] + [_EVIDENCE] * len(evidence)
    figure = new_figure(1.0 + sum(heights))
    grid = figure.add_gridspec(len(heights), 1, height_ratios=heights)
    rows = [figure.add_subplot(grid[k]) for k in range(len(heights))]
    _draw_statuses(rows[0], run, spans)
    for axes, panel in zip(rows[1:], evidence, strict=True):
        draw_panel(axes, run.time_s, panel)
    for axes in rows:
        style_axes(axes)
        axes.set_xlim(spans.edges_s[0], spans.edges_s[-1])
        axes.tick_params(labelbottom=axes is rows[-1])
    rows[0].grid(visible=False)
    rows[-1].set_xlabel("time, s")
    figure.align_ylabels(rows)
    add_legend(figure, rows[0], max_columns=len(STATUS_COLOURS))
    return figure


def window_nis_bounds(run: Run) -> tuple[FloatArray, FloatArray]:
    """Two-sided 95 % bounds (n,) of `Run.window_nis` of a filter that is right.

    nan where it is. The window covers the last `NIS_WINDOW_FRAMES` frames of one track with a used
    measurement, and the sum of their NIS has the sum of their degrees of freedom.
    """
    window, degrees = NisWindow(), np.zeros(len(run))
    for k, row in enumerate(zip(run.has_estimate, run.nis, run.nis_dof, strict=True)):
        window.follow(*row)
        degrees[k] = window.dof
    known = np.isfinite(run.window_nis) & (degrees > 0)
    lower, upper = np.full((2, len(run)), np.nan)
    lower[known], upper[known] = np.array(chi_square_bounds(degrees[known])) / degrees[known]
    return lower, upper


def _evidence(run: Run) -> dict[str, Panel]:
    """What the status was decided on, as far as it is known, by what a caption calls it."""
    found = {}
    ratio = run.notes.get("inlier_ratio")
    if ratio is not None and np.isfinite(ratio).any():
        curves = [Curve("", ratio, colour=LINE)]
        panel = Panel("inlier ratio", curves, limits=(0.0, 1.04))
        found["the inlier ratio of each frame"] = panel
    if np.isfinite(run.window_nis).any():
        curves, bands = [Curve("", run.window_nis, colour=LINE)], {"95 %": window_nis_bounds(run)}
        panel = Panel("NIS per dof", curves, Scale.FROM_ZERO, bands=bands, base=1.0)
        over = f"the NIS per degree of freedom over the last {NIS_WINDOW_FRAMES} frames"
        found[f"{over} with its 95 % band"] = panel
    return found


def _changes(run: Run, frames: list[int]) -> TextTable:
    """From which status to which it changed at some frames, and on what evidence."""
    ratio = run.notes.get("inlier_ratio", np.full(len(run), np.nan))[frames]
    evidence = {
        "inlier ratio": [f"{value:.0%}" if np.isfinite(value) else MISSING for value in ratio],
        "NIS per dof": [number(value) for value in run.window_nis[frames]],
    }
    known = {name: texts for name, texts in evidence.items() if set(texts) != {MISSING}}
    columns = {
        "from": [run.status[k - 1] for k in frames],
        "to": [run.status[k] for k in frames],
        "frame": [str(k) for k in frames],
        "time, s": [number(run.time_s[k]) for k in frames],
        **known,
    }
    rows = tuple(zip(*columns.values(), strict=True))
    return TextTable("", "", tuple(columns), rows, text_columns=2)


def _doubts(run: Run) -> list[str]:
    """What spoke against the estimate, and in how many of the frames."""
    counts = Counter(doubt for field in run.words.get(COLUMN, ()) for doubt in doubts_in(field))
    if not counts:
        return []
    told = [f"{doubt} ({TOLD[doubt]}) in {counts[doubt]}" for doubt in Doubt if counts[doubt]]
    return [f"Doubts raised, by number of frames: {'; '.join(told)}."]


def _ambiguity(symmetry: str) -> str:
    if symmetry == "C1":
        return (
            "Ambiguous: another motion explains the frames as well as the one followed, although "
            "the target itself has no symmetry."
        )
    return (
        f"Ambiguous: the target's symmetry group is {symmetry}. Its motions turn the target into "
        "itself, so no frame tells which of the equivalent attitudes is the true one; one of them "
        "is followed."
    )


def _motion(run: Run) -> str:
    """As what kind of motion the target was followed, in which share of the frames, and when that
    changed."""
    named = [(k, word) for k, word in enumerate(run.words["motion"]) if word]
    shares = [
        f"{word.replace('_', ' ')} in {count / len(named):.1%}"
        for word, count in Counter(word for _, word in named).most_common()
    ]
    changes = [
        f"to {word.replace('_', ' ')} at {number(run.time_s[k])} s (frame {k})"
        for (_, before), (k, word) in pairwise(named)
        if word != before
    ]
    text = f"Motion, of the frames with a pose: {', '.join(shares)}."
    if not changes:
        return text
    listed = ", ".join(changes[:_MAX_CHANGES])
    later = len(changes) - _MAX_CHANGES
    return f"{text} It changed {listed}" + (f", and {later} times later." if later > 0 else ".")


def _draw_statuses(axes: Axes, run: Run, spans: Spans) -> None:
    """A strip coloured by status, in each span of frames by the share of each."""
    counts = Counter(run.status)
    others = sorted(counts.keys() - STATUS_COLOURS)
    colours = {**STATUS_COLOURS, **dict(zip(others, CATEGORIES * len(others), strict=False))}
    statuses, below = np.array(run.status), 0.0 * spans.edges_s[1:]
    for name, colour in colours.items():
        if counts[name]:
            above = below + spans.mean(statuses == name)
            label = f"{name} ({counts[name]})"
            axes.stairs(above, spans.edges_s, baseline=below, fill=True, color=colour, label=label)
            below = above
    axes.set_yticks([])
    axes.set_ylim(0.0, 1.0)
    axes.set_ylabel("status")
