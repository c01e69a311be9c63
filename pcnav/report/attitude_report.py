"""The report of a run on attitudes: one HTML page that carries everything it shows."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure

from pcnav.core.arrays import FloatArray
from pcnav.estimators.attitude_inertia.rotation_model import INERTIA, OMEGA, SIZE, THETA
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
from pcnav.report.figures import ALERT, LINE, add_legend, component_figure, stacked_axes
from pcnav.report.from_run import AttitudeTrack
from pcnav.report.summary import run_facts

_DEGREES = float(np.rad2deg(1.0))
_FIGURES = (
    ("Attitude, body axes", THETA, _DEGREES, "deg", ("x", "y", "z")),
    ("Angular rate, body axes", OMEGA, _DEGREES, "deg/s", ("x", "y", "z")),
    ("Inertia ratios over Ixx", INERTIA, 1.0, "1", ("Iyy", "Izz", "Ixy", "Ixz", "Iyz")),
)


@dataclass(frozen=True)
class AttitudeReport:
    """What a report is made from."""

    title: str
    """Name of the recording."""
    command: str
    """How the run was started, as typed."""
    track: AttitudeTrack
    metrics: Metrics
    errors: FloatArray | None
    """(n, 11) true minus estimated."""
    outcomes: Sequence[tuple[str, int]]
    """What became of the frames that attitudes were taken from, in words; empty if recorded."""
    observability: tuple[TextTable, ...]
    configuration: Mapping[str, object]
    """The pipeline as nested tables."""
    versions: Mapping[str, str]


def attitude_report_html(content: AttitudeReport) -> str:
    """The page of a run."""
    metrics, track = content.metrics, content.track
    lead = f"attitude_inertia · {metrics.frames} frames over {number(metrics.duration_s)} s"
    body = [
        page.heading(content.title, lead),
        page.cards(headline(metrics)),
        page.section("Summary", page.table((), run_facts(metrics), text_columns=2)),
    ]
    if content.outcomes:
        rows = [(told, str(n), f"{n / len(track):.1%}") for told, n in content.outcomes]
        text = "Attitudes come from the images; a frame that is not measured is coasted through."
        table = page.table(("outcome", "frames", "share"), rows)
        body.append(page.section("Frames", page.paragraph(text), table))
    if metrics.quantities:
        body.append(truth_section(metrics))
    if track.has_estimate.any():
        body.append(page.section("States over time", page.grid(_state_figures(content))))
    if content.observability:
        body.append(observability_section(content.observability))
    made = provenance(content.command, content.configuration, content.versions)
    body.append(page.section("How the run was made", *made))
    return page.page(content.title, body)


def _state_figures(content: AttitudeReport) -> list[str]:
    """Error against its bounds where the truth is known, otherwise the estimate with them."""
    track, errors = content.track, content.errors
    compared = errors is not None and bool(np.isfinite(errors).any())
    series = errors if errors is not None and compared else _estimates(track)
    caption = "Error and stated 3 sigma." if compared else "Estimate and stated 3 sigma."
    pieces = []
    for title, block, scale, unit, names in _FIGURES:
        values, sd = scale * series[:, block], scale * track.sd[:, block]
        figure = component_figure(track.time_s, values, sd, names, unit, is_error=compared)
        if block == THETA and not compared:
            caption_here = "Stated 3 sigma of a turn about each axis, about the estimate."
            pieces.append(vector_figure(title, caption_here, figure))
        else:
            pieces.append(vector_figure(title, caption, figure))
    caption = "Root mean square about an axis: of the attitudes taken in, and of the estimate."
    pieces.append(vector_figure("Attitudes taken in", caption, _noise_figure(track)))
    return pieces


def _noise_figure(track: AttitudeTrack) -> Figure:
    figure, (axes,) = stacked_axes(1, track.time_s, row_in=2.2)
    stated = _DEGREES * np.sqrt(np.mean(track.sd[:, THETA] ** 2, axis=1))
    measured = _DEGREES * track.measured_sd
    at = np.isfinite(measured)
    axes.plot(track.time_s[at], measured[at], ".", color=ALERT, markersize=3, label="taken in")
    at = envelope(stated)
    axes.plot(track.time_s[at], stated[at], color=LINE, linewidth=0.9, label="estimate")
    axes.set_yscale("log")
    axes.set_ylabel("sd, deg")
    add_legend(figure, axes)
    return figure


def _estimates(track: AttitudeTrack) -> FloatArray:
    """(n, 11) the estimates in error-state order; the attitude, which has no zero, as zero."""
    values = np.full((len(track), SIZE), np.nan)
    values[:, OMEGA], values[:, INERTIA] = track.omega_body, track.inertia_ratios
    values[track.has_estimate, THETA] = 0.0
    return values
