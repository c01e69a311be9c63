"""The report of a run on images of one camera: one HTML page that carries everything it shows."""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from pcnav.core.arrays import FloatArray
from pcnav.dynamics.blocks import ATTITUDE, RATE
from pcnav.evaluation.errors import Errors
from pcnav.evaluation.metrics import Metrics
from pcnav.files.text_table import TextTable, number
from pcnav.report import page
from pcnav.report.depth_report import (
    headline,
    observability_section,
    provenance,
    truth_section,
    vector_figure,
)
from pcnav.report.envelope import envelope
from pcnav.report.figures import (
    ALERT,
    BAND,
    BOUND,
    LINE,
    add_legend,
    new_figure,
    stacked_axes,
    style_axes,
)
from pcnav.report.from_run import ImageTrack
from pcnav.report.status import STATUS_COLOURS
from pcnav.report.summary import run_facts

_XYZ = ("x", "y", "z")


@dataclass(frozen=True)
class ImageReport:
    """What a report is made from."""

    title: str
    """Name of the recording."""
    command: str
    """How the run was started, as typed."""
    track: ImageTrack
    metrics: Metrics
    errors: Errors | None
    configuration: Mapping[str, object]
    """The pipeline as nested tables."""
    versions: Mapping[str, str]
    observability: tuple[TextTable, ...] = ()
    """What the motion makes observable; empty without an estimate."""


def image_report_html(content: ImageReport) -> str:
    """The page of a run."""
    metrics, track = content.metrics, content.track
    lead = f"image_motion · {metrics.frames} frames over {number(metrics.duration_s)} s"
    body = [
        page.heading(content.title, lead),
        page.cards([*headline(metrics), ("frames measured", number_of(track, "locked"))]),
        page.section("Summary", page.table((), run_facts(metrics), text_columns=2)),
        _outcome_section(track),
    ]
    if metrics.quantities:
        body.append(truth_section(metrics))
    if track.has_attitude.any():
        body.append(page.section("Attitude and rate over time", page.grid(_motion(content))))
    if content.observability:
        body.append(observability_section(content.observability))
    made = provenance(content.command, content.configuration, content.versions)
    body.append(page.section("How the run was made", *made))
    return page.page(content.title, body)


def number_of(track: ImageTrack, status: str) -> str:
    """How many frames of how many have a status."""
    return f"{track.status.count(status)} of {len(track)}"


def _outcome_section(track: ImageTrack) -> str:
    counts = Counter(track.outcome).most_common()
    rows = [(told, str(count), f"{count / len(track):.1%}") for told, count in counts]
    segments = len(np.unique(track.segment))
    axes = "The body axes are the camera's at that frame."
    if segments > 1:
        axes = (
            f"The chain had to begin anew: {segments} segments, each with body axes of its own, "
            "the camera's at its first frame. Attitudes of different segments cannot be compared."
        )
    text = (
        "The first frame of a segment is given its attitude: it defines the body axes and is not "
        "compared with the truth. Another frame that is not measured has none, and says why. "
        f"{axes}"
    )
    caption = "What became of every frame, coloured by status."
    figures = [
        vector_figure("Outcomes", caption, _outcome_figure(track)),
        page.table(("outcome", "frames", "share"), rows),
    ]
    caption = "Seen, shared with the frame compared with, and in agreement with the motion found."
    figures.append(vector_figure("Features per frame", caption, _count_figure(track)))
    return page.section("Frames", page.paragraph(text), page.grid(figures))


def _outcome_figure(track: ImageTrack) -> Figure:
    names = [told for told, _ in Counter(track.outcome).most_common()]
    figure = new_figure(0.9 + 0.3 * max(len(names), 2))
    axes = figure.add_subplot()
    style_axes(axes)
    place = np.array([names.index(told) for told in track.outcome])
    for status in dict.fromkeys(track.status):
        at = np.array([each == status for each in track.status])
        colour = STATUS_COLOURS[status]
        axes.plot(track.time_s[at], place[at], "|", color=colour, markersize=9, label=status)
    axes.set_yticks(range(len(names)), names)
    axes.set_ylim(len(names) - 0.5, -0.5)
    axes.set_xlabel("time, s")
    add_legend(figure, axes)
    return figure


def _count_figure(track: ImageTrack) -> Figure:
    figure, (axes,) = stacked_axes(1, track.time_s, row_in=2.0)
    for counts, colour, label in (
        (track.n_features, BOUND, "seen"),
        (track.n_matches, ALERT, "matches"),
        (track.n_agreeing, LINE, "agreeing"),
    ):
        at = envelope(counts.astype(np.float64))
        axes.plot(track.time_s[at], counts[at], color=colour, linewidth=0.9, label=label)
    axes.set_ylim(bottom=0.0)
    axes.yaxis.set_major_locator(MaxNLocator(nbins=6, integer=True))
    axes.set_ylabel("features")
    add_legend(figure, axes)
    return figure


def _motion(content: ImageReport) -> list[str]:
    track, errors = content.track, content.errors
    sd_deg = np.rad2deg(track.sd)
    axes_of = "Quaternion of R_world_body, scalar last."
    figures: list[tuple[str, str, FloatArray, FloatArray | None, tuple[str, ...]]] = [
        ("Attitude", axes_of, track.xyzw, None, ("q_x", "q_y", "q_z", "q_w")),
        (
            "Angular rate, body axes",
            "Inertial, from the attitudes of several frames.",
            np.rad2deg(track.omega_body),
            None,
            tuple(f"{name}, deg/s" for name in _XYZ),
        ),
    ]
    components = tuple(f"{name}, deg" for name in _XYZ)
    if errors is None or not np.isfinite(errors[ATTITUDE]).any():
        title, caption = "Uncertainty of the attitude", "Stated 3 sigma about the body axes."
        figures.append((title, caption, np.zeros_like(sd_deg), sd_deg, components))
    else:
        caption = "True minus estimated, and stated 3 sigma, about the body axes."
        theta_deg = np.rad2deg(errors[ATTITUDE])
        figures.append(("Attitude error", caption, theta_deg, sd_deg, components))
        rate_deg_s = np.rad2deg(errors[RATE])
        names = tuple(f"{name}, deg/s" for name in _XYZ)
        figures.append(("Rate error", "True minus estimated.", rate_deg_s, None, names))
    return [
        vector_figure(title, caption, _component_figure(track, values, sd, names))
        for title, caption, values, sd, names in figures
    ]


def _component_figure(
    track: ImageTrack, values: FloatArray, sd: FloatArray | None, names: tuple[str, ...]
) -> Figure:
    """Components (n, k) of the frames with an attitude; lines join those of one segment."""
    figure, rows = stacked_axes(len(names), track.time_s)
    known = track.has_attitude
    for segment in np.unique(track.segment[known]):
        at = np.flatnonzero(known & (track.segment == segment))
        for k, axes in enumerate(rows):
            _draw(axes, track.time_s[at], values[at, k], None if sd is None else sd[at, k])
    for axes, name in zip(rows, names, strict=True):
        axes.set_ylabel(name)
    return figure


def _draw(axes: Axes, time_s: FloatArray, values: FloatArray, sd: FloatArray | None) -> None:
    if sd is not None:
        at = envelope(sd)
        low, high = -3.0 * sd[at], 3.0 * sd[at]
        axes.fill_between(time_s[at], low, high, color=BAND, linewidth=0)
    at = envelope(values)
    axes.plot(time_s[at], values[at], ".-", color=LINE, linewidth=0.8, markersize=2.5)
