"""The report of a run on feature tracks: one HTML page that carries everything it shows."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from pcnav.core.arrays import FloatArray, IntArray
from pcnav.dynamics.blocks import MOTION_LAYOUT
from pcnav.evaluation.errors import Errors
from pcnav.evaluation.metrics import Metrics
from pcnav.files.text_table import TextTable, display_unit, number
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
    component_figure,
    consistency_figure,
    new_figure,
    stacked_axes,
    style_axes,
    time_spans,
)
from pcnav.report.from_run import (
    ERROR_SIZE,
    INERTIA_RATIOS,
    OMEGA_BODY,
    R_HILL,
    THETA_BODY,
    V_HILL,
    FeatureTrack,
    stacked,
)
from pcnav.report.status import status_section
from pcnav.report.summary import run_facts

_XYZ = ("x", "y", "z")
_DEGREES = float(np.rad2deg(1.0))
_STATE_FIGURES = (
    ("Mass centre in hill", R_HILL, 1.0, "m", _XYZ),
    ("Velocity in hill", V_HILL, 1.0, "m/s", _XYZ),
    ("Attitude, body axes", THETA_BODY, _DEGREES, "deg", _XYZ),
    ("Angular rate, body axes", OMEGA_BODY, _DEGREES, "deg/s", _XYZ),
    ("Inertia ratios over Ixx", INERTIA_RATIOS, 1.0, "1", ("Iyy", "Izz", "Ixy", "Ixz", "Iyz")),
)
_MAX_NOTES = 8


@dataclass(frozen=True)
class FeatureReport:
    """What a report is made from."""

    title: str
    """Name of the recording."""
    estimator: str
    command: str
    """How the run was started, as typed."""
    track: FeatureTrack
    metrics: Metrics
    errors: Errors | None
    configuration: Mapping[str, object]
    """The pipeline as nested tables."""
    versions: Mapping[str, str]
    observability: tuple[TextTable, ...] = ()
    """What the motion makes observable; empty without an estimate."""


def feature_report_html(content: FeatureReport) -> str:
    """The page of a run."""
    metrics, track = content.metrics, content.track
    lead = f"{content.estimator} · {metrics.frames} frames over {number(metrics.duration_s)} s"
    facts = page.table((), run_facts(metrics), text_columns=2)
    body = [
        page.heading(content.title, lead),
        page.cards(headline(metrics)),
        page.section("Summary", facts),
        status_section(track, "C1"),
    ]
    if metrics.quantities:
        body.append(truth_section(metrics))
    if track.has_estimate.any():
        body.append(page.section("States over time", page.grid(_state_figures(content))))
    if content.observability:
        body.append(observability_section(content.observability))
    body.append(page.section("Features", *_features(content)))
    if track.notes:
        caption = "What the estimator tells of itself."
        figure = vector_figure("Over time", caption, _notes_figure(track))
        body.append(page.section("Notes of the estimator", page.grid([figure, _last_notes(track)])))
    made = provenance(content.command, content.configuration, content.versions)
    body.append(page.section("How the run was made", *made))
    return page.page(content.title, body)


def _state_figures(content: FeatureReport) -> list[str]:
    """Error against its bounds where the truth is known, otherwise the estimate with them."""
    track = content.track
    errors = None if content.errors is None else stacked(content.errors, MOTION_LAYOUT)
    compared = errors is not None and bool(np.isfinite(errors).any())
    series = errors if errors is not None and compared else _estimates(track)
    caption = "Error and stated 3 sigma." if compared else "Estimate and stated 3 sigma."
    pieces = []
    for title, block, scale, unit, names in _STATE_FIGURES:
        values, sd = scale * series[:, block], scale * track.sd17[:, block]
        # What the estimator holds fixed at the truth has nothing to show.
        shown = [
            k
            for k in range(len(names))
            if np.nanmax(sd[:, k], initial=0.0) > 0.0
            or np.nanmax(np.abs(values[:, k]), initial=0.0) > 1e-12
        ]
        if shown:
            chosen = tuple(names[k] for k in shown)
            figure = component_figure(
                track.time_s, values[:, shown], sd[:, shown], chosen, unit, is_error=compared
            )
            pieces.append(vector_figure(title, caption, figure))
    if content.metrics.nis.frames:
        caption = (
            "Squared normalised innovations over their frame's 95 % chi-square bound: one in "
            "twenty belongs above 1."
        )
        figure = consistency_figure(track, None)
        pieces.append(vector_figure("Consistency", caption, figure))
    return pieces


def _estimates(track: FeatureTrack) -> FloatArray:
    """(n, 17) the estimates in error-state order; the attitude, which has no zero, as zero."""
    values = np.full((len(track), ERROR_SIZE), np.nan)
    values[:, R_HILL], values[:, V_HILL] = track.r_hill, track.v_hill
    values[:, OMEGA_BODY], values[:, INERTIA_RATIOS] = track.omega_body, track.inertia_ratios
    values[track.has_estimate, THETA_BODY] = 0.0
    return values


def _features(content: FeatureReport) -> list[str]:
    """What was seen and used over time, and the points at the end."""
    track, errors = content.track, content.errors
    caption = "Seen, used by the filter and rejected by its gate: means of short spans of frames."
    pieces = [vector_figure("Features per frame", caption, _count_figure(track))]
    rms_m = None if errors is None else errors.points_rms_m
    if rms_m is not None and np.isfinite(rms_m).any():
        caption = "Root mean square distance of the estimated points from the true ones."
        figure = _feature_error_figure(track.time_s, rms_m)
        pieces.append(vector_figure("Error of the points", caption, figure))
    return [page.stack([page.grid(pieces), _feature_table(track, errors)])]


def _feature_table(track: FeatureTrack, errors: Errors | None) -> str:
    known = {} if errors is None else errors.point_m or {}
    header = ("feature", "x, m", "y, m", "z, m", "sd x, m", "sd y, m", "sd z, m")
    header = (*header, "frames seen", "rejected", *(("error, m",) if known else ()))
    rows, table = [], track.features
    assert table is not None, "the run has been written"
    for k, i in enumerate(table.feature.tolist()):
        numbers = ["-"] * 6
        if np.isfinite(table.p_body[k]).all():
            numbers = [f"{value:.4f}" for value in (*table.p_body[k], *table.sd[k])]
        counts = (table.frames_seen[k], table.frames_rejected[k])
        error = [number(known[i]) if i in known else "-"] if known else []
        rows.append((str(i), *numbers, *(str(count) for count in counts), *error))
    return page.table(header, rows)


def _count_figure(track: FeatureTrack) -> Figure:
    figure = new_figure(2.6)
    axes = figure.add_subplot()
    style_axes(axes)
    spans, edges = time_spans(track)

    def means(counts: IntArray) -> FloatArray:
        return np.array([counts[span].mean() for span in spans])

    axes.stairs(means(track.n_features), edges, fill=True, color=BAND, label="seen")
    for counts, colour, label in (
        (track.n_used, LINE, "used"),
        (track.n_rejected, ALERT, "rejected"),
    ):
        axes.stairs(means(counts), edges, baseline=None, color=colour, linewidth=0.9, label=label)
    axes.set_xlim(edges[0], edges[-1])
    axes.set_ylim(0.0, float(track.n_features.max()) + 0.5)
    axes.yaxis.set_major_locator(MaxNLocator(nbins=6, integer=True))
    axes.set_ylabel("features")
    axes.set_xlabel("time, s")
    add_legend(figure, axes)
    return figure


def _feature_error_figure(time_s: FloatArray, rms_m: FloatArray) -> Figure:
    figure, (axes,) = stacked_axes(1, time_s, row_in=2.0)
    scale, unit = display_unit("m", float(np.nanmedian(rms_m)))
    at = envelope(rms_m)
    axes.plot(time_s[at], scale * rms_m[at], color=LINE, linewidth=0.9)
    if np.nanmin(rms_m) > 0.0:
        axes.set_yscale("log")
    axes.set_ylabel(f"RMS error, {unit}")
    return figure


def _notes_figure(track: FeatureTrack) -> Figure:
    shown = list(track.notes.items())[:_MAX_NOTES]
    figure, rows = stacked_axes(len(shown), track.time_s)
    for axes, (name, values) in zip(rows, shown, strict=True):
        at = envelope(values)
        axes.plot(track.time_s[at], values[at], color=BOUND, linewidth=0.9)
        axes.set_ylabel(name, fontsize=7)
    return figure


def _last_notes(track: FeatureTrack) -> str:
    rows = []
    for name, values in track.notes.items():
        known = values[np.isfinite(values)]
        rows.append((name, number(float(known[-1])) if known.size else "-"))
    return page.table(("note", "last value"), rows)
