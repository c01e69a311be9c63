"""The status of a run over time, on what evidence, and how it changed: a part of the report."""

from collections import Counter, deque

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from pcnav.core.arrays import FloatArray
from pcnav.evaluation.metrics import chi_square_bounds
from pcnav.files.text_table import number
from pcnav.report import page
from pcnav.report.envelope import envelope
from pcnav.report.figures import (
    BAND,
    CATEGORIES,
    LINE,
    LOG_FROM,
    MUTED,
    add_legend,
    end_s,
    new_figure,
    style_axes,
    svg_bytes,
    time_spans,
)
from pcnav.report.from_run import Track
from pcnav.runs.nis_window import NIS_WINDOW_FRAMES

STATUS_COLOURS = {
    "acquiring": "#94a3b8",
    "locked": "#16a34a",
    "ambiguous": "#f59e0b",
    "coasting": "#9333ea",
    "lost": "#dc2626",
}
"""The same colour for a status in every report, worse ones last."""

_CHANGE_HEADINGS = ("from", "to", "frame", "time, s", "inlier ratio", "NIS per dof")
_MAX_CHANGES = 25


def status_section(track: Track, symmetry: str) -> str:
    """What the run said of itself over time, and on what evidence; of a track with frames.

    ``symmetry`` is the name of the target's symmetry group, "C1" for none.
    """
    figure = page.image(
        "Status and its evidence",
        "; ".join(_shown(track)) + ".",
        "image/svg+xml",
        svg_bytes(status_figure(track)),
    )
    changes = [k for k in range(1, len(track)) if track.status[k] != track.status[k - 1]]
    rows = [_change_row(track, k) for k in changes[:_MAX_CHANGES]]
    pieces = [page.table(_CHANGE_HEADINGS, rows, text_columns=2)] if rows else []
    if not rows:
        pieces.append(page.paragraph(f"The status is {track.status[0]} in every frame."))
    if len(changes) > _MAX_CHANGES:
        pieces.append(
            page.paragraph(f"{len(changes) - _MAX_CHANGES} later changes are not listed.")
        )
    if "ambiguous" in track.status:
        pieces.append(page.paragraph(_ambiguity(symmetry)))
    return page.section("Status", page.grid([figure, page.stack(pieces)]))


def _shown(track: Track) -> list[str]:
    """What the figure has, from top to bottom."""
    told = ["Frames by status"]
    if np.isfinite(track.inlier_ratio).any():
        told.append("the inlier ratio of each frame")
    if np.isfinite(track.window_nis).any():
        told.append(
            f"the NIS per degree of freedom over the last {NIS_WINDOW_FRAMES} frames with its "
            "95 % band"
        )
    return told


def _change_row(track: Track, k: int) -> tuple[str, ...]:
    """The change of status at a frame."""
    explained = f"{track.inlier_ratio[k]:.0%}" if np.isfinite(track.inlier_ratio[k]) else "-"
    before, after = track.status[k - 1 : k + 1]
    return before, after, str(k), number(track.time_s[k]), explained, number(track.window_nis[k])


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


def status_figure(track: Track) -> Figure:
    """The status of each frame as coloured bands, over the evidence it was decided on.

    That is the share of the frame explained and the NIS of the last frames, each where known.
    """
    rows = [(_draw_statuses, 0.45)]
    if np.isfinite(track.inlier_ratio).any():
        rows.append((_draw_inlier_ratio, 1.3))
    if np.isfinite(track.window_nis).any():
        rows.append((_draw_window_nis, 1.3))
    heights = [height for _, height in rows]
    figure = new_figure(1.0 + sum(heights))
    grid = figure.add_gridspec(len(rows), 1, height_ratios=heights)
    panels = [figure.add_subplot(grid[k]) for k in range(len(rows))]
    for axes, (draw, _) in zip(panels, rows, strict=True):
        style_axes(axes)
        draw(axes, track)
        axes.set_xlim(track.time_s[0], end_s(track.time_s))
        axes.tick_params(labelbottom=axes is panels[-1])
    panels[-1].set_xlabel("time, s")
    figure.align_ylabels(panels)
    add_legend(figure, panels[0], max_columns=len(STATUS_COLOURS))
    return figure


def window_nis_bounds(track: Track) -> tuple[FloatArray, FloatArray]:
    """Two-sided 95 % bounds (n,) of `Track.window_nis` of a filter that is right.

    nan where it is. The window covers the last `NIS_WINDOW_FRAMES` frames of one track with an
    accepted measurement, and the sum of their NIS has the sum of their degrees of freedom.
    """
    window: deque[int] = deque(maxlen=NIS_WINDOW_FRAMES)
    degrees = np.zeros(len(track), dtype=np.intp)
    for k, (has_estimate, own) in enumerate(zip(track.has_estimate, track.nis_dof, strict=True)):
        if not has_estimate:
            window.clear()
        elif own > 0:
            window.append(int(own))
        degrees[k] = sum(window)
    known = np.isfinite(track.window_nis) & (degrees > 0)
    lower, upper = np.full((2, len(track)), np.nan)
    bounds = chi_square_bounds(degrees[known])
    lower[known], upper[known] = (bound / degrees[known] for bound in bounds)
    return lower, upper


def _draw_statuses(axes: Axes, track: Track) -> None:
    """A strip coloured by status, in each span of frames by the share of each."""
    spans, edges = time_spans(track)
    statuses = [[track.status[i] for i in span] for span in spans]
    counts = Counter(track.status)
    others = dict(
        zip(sorted(counts.keys() - STATUS_COLOURS), CATEGORIES * len(counts), strict=False)
    )
    below = np.zeros(len(spans))
    for name, colour in {**STATUS_COLOURS, **others}.items():
        if counts[name]:
            above = below + [span.count(name) / len(span) for span in statuses]
            label = f"{name} ({counts[name]})"
            axes.stairs(above, edges, baseline=below, fill=True, color=colour, label=label)
            below = above
    axes.set_yticks([])
    axes.set_ylim(0.0, 1.0)
    axes.set_ylabel("status")
    axes.grid(visible=False)


def _draw_inlier_ratio(axes: Axes, track: Track) -> None:
    at = envelope(track.inlier_ratio)
    axes.plot(track.time_s[at], track.inlier_ratio[at], color=LINE, linewidth=0.9)
    axes.set_ylim(0.0, 1.04)
    axes.set_ylabel("inlier ratio")


def _draw_window_nis(axes: Axes, track: Track) -> None:
    """The NIS per degree of freedom of the last frames, inside its 95 % band about 1."""
    lower, upper = window_nis_bounds(track)
    at = envelope(upper)
    axes.fill_between(track.time_s[at], lower[at], upper[at], color=BAND, linewidth=0)
    axes.axhline(1.0, color=MUTED, linewidth=0.6)
    at = envelope(track.window_nis)
    axes.plot(track.time_s[at], track.window_nis[at], color=LINE, linewidth=0.9)
    if np.nanmax(track.window_nis) > LOG_FROM:
        axes.set_yscale("log")
    else:
        axes.set_ylim(bottom=0.0)
    axes.set_ylabel("NIS per dof")
