"""The report of a run: one HTML page that carries everything it shows."""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from math import sqrt

import numpy as np
from matplotlib.figure import Figure

from pcnav.core.arrays import FloatArray
from pcnav.dynamics.state import (
    COM_MODEL,
    INERTIA_RATIOS,
    OMEGA_BODY,
    R_HILL,
    STATE_SIZE,
    THETA_BODY,
    V_HILL,
)
from pcnav.evaluation.knowledge import (
    ENOUGH_BITS,
    FROM_DATA,
    MAX_PRIOR_SHARE,
    RunKnowledge,
    StateKnowledge,
)
from pcnav.evaluation.metrics import Consistency, Metrics
from pcnav.files.text_table import TextTable, display_unit, number
from pcnav.report import page
from pcnav.report.figures import (
    component_figure,
    consistency_figure,
    count_figure,
    outcome_figure,
    png_bytes,
    pose_error_figure,
    svg_bytes,
)
from pcnav.report.from_run import Track, track_errors_of
from pcnav.report.status import status_section
from pcnav.report.summary import ERROR_HEADINGS, error_row, run_facts
from pcnav.runs.records import ACCEPTED

_BLOCK_TITLES = {
    "r_hill": "mass centre in hill",
    "v_hill": "velocity in hill",
    "com_model": "mass centre in model",
    "theta_body": "attitude",
    "omega_body": "angular rate",
    "inertia_ratios": "inertia ratios",
    "all": "whole state",
}
_NEES_HEADINGS = (
    "block",
    "NEES per dof",
    "95 % bounds",
    "frames inside own 95 %",
    "errors over stated sigma",
    "verdict",
)
_KNOWLEDGE_HEADINGS = ("verdict", "unit", "prior sd", "final sd", "bits", "prior's share")
_XYZ = ("x", "y", "z")
_DEGREES = float(np.rad2deg(1.0))
_STATE_FIGURES = (
    ("Mass centre in hill", R_HILL, 1.0, "m", _XYZ),
    ("Velocity in hill", V_HILL, 1.0, "m/s", _XYZ),
    ("Attitude, body axes", THETA_BODY, _DEGREES, "deg", _XYZ),
    ("Angular rate, body axes", OMEGA_BODY, _DEGREES, "deg/s", _XYZ),
    ("Mass centre in model", COM_MODEL, 1.0, "m", _XYZ),
    ("Inertia ratios over Ixx", INERTIA_RATIOS, 1.0, "1", ("Iyy", "Izz", "Ixy", "Ixz", "Iyz")),
)


@dataclass(frozen=True)
class ReportContent:
    """What a report is made from."""

    title: str
    """Name of the run."""
    target: str
    """Name of the target."""
    command: str
    """How the run was started, as typed."""
    track: Track
    """With its covariances when the NEES is to be drawn."""
    outcomes: Counter[tuple[str, str]]
    """How often each rectangle (empty: not recognised) had each outcome."""
    metrics: Metrics
    configuration: Mapping[str, object]
    """The pipeline as nested tables."""
    versions: Mapping[str, str]
    symmetry: str = "C1"
    """Name of the target's symmetry group; C1 is none."""
    knowledge: RunKnowledge | None = None
    """None without an estimate."""
    observability: tuple[TextTable, ...] = ()
    """What the motion makes observable; empty without an estimate."""
    picture: Figure | None = None
    """A frame drawn by `frame_picture`."""
    picture_caption: str = ""


def report_html(content: ReportContent) -> str:
    """The page of a run."""
    metrics = content.metrics
    seconds = number(metrics.duration_s)
    lead = f"{content.target} · {metrics.frames} frames over {seconds} s"
    body = [page.heading(content.title, lead), page.cards(headline(metrics)), _summary(content)]
    if len(content.track):
        body.append(status_section(content.track, content.symmetry))
    if metrics.errors is not None:
        body.append(truth_section(metrics))
    if content.knowledge is not None:
        body.append(page.section("Known from data, or prior only", *_known(content.knowledge)))
    if content.observability:
        body.append(observability_section(content.observability))
    if content.track.has_estimate.any():
        body.append(page.section("States over time", page.grid(_state_figures(content))))
    if len(content.track):
        body.append(page.section("Measurements", *_measurements(content)))
    made = provenance(content.command, content.configuration, content.versions)
    body.append(page.section("How the run was made", *made))
    return page.page(content.title, body)


def headline(metrics: Metrics) -> list[tuple[str, str]]:
    """The few numbers most readers come for."""
    share = metrics.frames_with_estimate / max(metrics.frames, 1)
    facts = [("frames with an estimate", f"{share:.1%}")]
    if metrics.frames_with_estimate:
        after = f"{number(metrics.first_estimate_after_s)} s"
        facts.append(("until the first estimate", after))
    titles = {
        "position_cam": "median position error, last third",
        "attitude": "median attitude error, last third",
        "com_model": "median mass-centre error, last third",
    }
    for quantity in metrics.quantities:
        if quantity.key in titles:
            row = error_row(quantity)
            facts.append((titles[quantity.key], f"{row.median} {row.unit}"))
    if metrics.nis.frames:
        facts.append(
            ("NIS per degree of freedom (1 is right)", number(metrics.nis.mean_per_degree))
        )
    return facts


def _summary(content: ReportContent) -> str:
    facts = page.table((), run_facts(content.metrics, content.knowledge), text_columns=2)
    pieces = [facts]
    if content.picture is not None:
        picture = png_bytes(content.picture)
        title = "One frame as it was understood"
        pieces.append(page.image(title, content.picture_caption, "image/png", picture))
    return page.section("Summary", page.grid(pieces) if len(pieces) > 1 else facts)


def truth_section(metrics: Metrics) -> str:
    """Error and consistency tables."""
    rows = [error_row(quantity) for quantity in metrics.quantities]
    errors = page.table(
        ("error", "unit", *ERROR_HEADINGS),
        [(row.title, row.unit, *row.numbers) for row in rows],
        text_columns=2,
    )
    pieces = [
        page.paragraph(
            f"{metrics.frames_compared} frames have both an estimate and a truth. Norms of the "
            "error vectors in the frames named. Median, 95 % and largest are those "
            "of the last third of the run."
        ),
        errors,
    ]
    if metrics.symmetry:
        pieces.append(
            page.paragraph(
                f"The run tells the target's attitude up to its symmetry: errors are those to the "
                f"equivalent truth under symmetry {metrics.symmetry} of the target."
            )
        )
    if metrics.nees:
        pieces += [
            page.paragraph(
                "Are the stated covariances honest? The NEES per degree of freedom is 1 when they "
                "are. The errors of a filter hang together from frame to frame, so the 95 % bounds "
                "are those of a single frame; many runs tell more (pcnav table)."
            ),
            page.table(
                _NEES_HEADINGS,
                [_nees_row(block) for block in metrics.nees],
            ),
        ]
    return page.section("Against the truth", *pieces)


def _nees_row(block: Consistency) -> tuple[str, ...]:
    title = _BLOCK_TITLES[block.name]
    if not block.frames:
        return (title, "-", "-", "-", "-", "no usable covariance")
    verdict = "consistent"
    if block.mean_per_degree > block.upper:
        verdict = "too confident"
    elif block.mean_per_degree < block.lower:
        verdict = "too cautious"
    if block.unusable_frames:
        verdict += f"; {block.unusable_frames} frames unusable"
    return (
        title,
        number(block.mean_per_degree),
        f"{block.lower:.3f} to {block.upper:.3f}",
        f"{block.share_inside:.1%}",
        number(sqrt(block.mean_per_degree)),
        verdict,
    )


def _state_figures(content: ReportContent) -> list[str]:
    """Error against its bounds where the truth is known, otherwise the estimate with them."""
    track, found = content.track, content.metrics.errors
    errors = None if found is None else track_errors_of(found)
    pieces = []
    if errors is not None and errors.has_pose.any():
        pieces.append(
            vector_figure(
                "Pose error",
                "Norms of the error of the model origin and of the attitude in the camera.",
                pose_error_figure(track.time_s, errors),
            )
        )
    compared = errors is not None and bool(errors.has_state.any())
    series = errors.state if errors is not None and compared else _estimates(track)
    for title, block, scale, unit, names in _STATE_FIGURES:
        values, sd = scale * series[:, block], scale * track.sd[:, block]
        figure = component_figure(track.time_s, values, sd, names, unit, is_error=compared)
        caption = (
            "Error and stated 3 sigma; where the run settles by orders of magnitude, the axis is "
            "linear between its two inner marks and logarithmic beyond."
            if compared
            else "Estimate and stated 3 sigma; the axes fit the run after its first tenth."
        )
        if block == THETA_BODY and not compared:
            caption = "Stated 3 sigma of a turn about each axis, about the estimate."
        pieces.append(vector_figure(title, caption, figure))
    if content.metrics.nis.frames:
        caption = (
            "Squared normalised innovations"
            + (" and errors, each" if _draws_nees(content) else ",")
            + " over its frame's 95 % chi-square bound: one in twenty belongs above 1."
        )
        pieces.append(vector_figure("Consistency", caption, consistency_figure(track, errors)))
    return pieces


def _draws_nees(content: ReportContent) -> bool:
    """Whether the errors can be normalised here: by covariances that were read."""
    return content.track.covariance is not None and bool(content.metrics.nees)


def _estimates(track: Track) -> FloatArray:
    """(n, 20) the estimates in error-state order; the attitude, which has no zero, as zero."""
    values = np.full((len(track), STATE_SIZE), np.nan)
    values[:, R_HILL], values[:, V_HILL] = track.r_hill, track.v_hill
    values[:, COM_MODEL], values[:, OMEGA_BODY] = track.com_model, track.omega_body
    values[:, INERTIA_RATIOS] = track.inertia_ratios
    values[track.has_estimate, THETA_BODY] = 0.0
    return values


def _known(knowledge: RunKnowledge) -> list[str]:
    """The states one by one, and the combinations that single states hide."""
    rows, prior_only = [], []
    for title, block, scale, unit, components in _STATE_FIGURES:
        own = list(zip(components, knowledge.states[block], strict=True))
        rows += [_knowledge_row(f"{title}, {name}", state, scale, unit) for name, state in own]
        unknown = [name for name, state in own if not state.known]
        if unknown:
            prior_only.append(f"{title}: {', '.join(unknown)}")
    verdict = (
        f"Prior only are {'; '.join(prior_only)}."
        if prior_only
        else f"Here every state is {FROM_DATA}."
    )
    combinations = [
        _knowledge_row(each.name, each, 1.0, each.unit)
        for each in (*knowledge.com_combinations, *knowledge.ratio_combinations)
    ]
    return [
        page.paragraph(
            f"A state is {FROM_DATA} when at most {MAX_PRIOR_SHARE:.0%} of its final variance "
            "is due to the prior of the mass properties, which takes data that at least halve the "
            f"standard deviation of one of these, or when it gained {ENOUGH_BITS:g} bits or more. "
            "Position and velocity are seen of the model's origin: the prior leaves them no more "
            "certain than the mass centre. Attitude and rate are seen as they are, without any "
            "prior. " + verdict
        ),
        page.table(("state", *_KNOWLEDGE_HEADINGS), rows, text_columns=3),
        page.paragraph(
            "A motion may leave a combination of states unknown while each of them gains. These "
            "are the independent combinations of the mass centre and of the inertia ratios, the "
            "least known of each first."
        ),
        page.table(("combination", *_KNOWLEDGE_HEADINGS), combinations, text_columns=3),
    ]


def _knowledge_row(title: str, state: StateKnowledge, scale: float, unit: str) -> tuple[str, ...]:
    by, unit = display_unit(unit, scale * state.posterior_sd)
    return (
        title,
        state.verdict,
        unit,
        number(by * scale * state.prior_sd) if np.isfinite(state.prior_sd) else "none",
        number(by * scale * state.posterior_sd),
        number(state.bits),
        f"{state.prior_share:.1%}",
    )


def _measurements(content: ReportContent) -> list[str]:
    """What was used over time, and what became of each rectangle."""
    timeline = vector_figure(
        "Rectangles used",
        "Rectangles the filter used per frame: mean and range.",
        count_figure(content.track),
    )
    if not content.outcomes:
        return [page.grid([timeline]), page.paragraph("No rectangle was seen.")]
    outcomes = vector_figure(
        "What became of the rectangles",
        f"{content.outcomes.total()} rectangles seen in the run.",
        outcome_figure(content.outcomes),
    )
    return [page.grid([timeline, page.stack([outcomes, _rectangle_table(content.outcomes)])])]


def _rectangle_table(outcomes: Counter[tuple[str, str]]) -> str:
    seen: Counter[str] = Counter()
    for (rectangle, _), count in outcomes.items():
        seen[rectangle] += count
    used = {rectangle: outcomes[rectangle, ACCEPTED] for rectangle in seen}
    rows = [
        (name or "not recognised", str(count), str(used[name]), f"{used[name] / count:.1%}")
        for name, count in seen.most_common()
    ]
    return page.table(("rectangle", "seen", "used", "share used"), rows)


def observability_section(tables: tuple[TextTable, ...]) -> str:
    """What the motion of the run lets its estimator know, how well, and how soon."""
    pieces = []
    for table in tables:
        shown = page.table(table.header, table.rows, table.text_columns)
        pieces += [page.subheading(table.title), shown]
        if table.note:
            pieces.append(page.paragraph(table.note))
    return page.section("Observability of this motion", *pieces)


def provenance(
    command: str, configuration: Mapping[str, object], versions: Mapping[str, str]
) -> list[str]:
    """The command, the configuration and the versions."""
    return [
        page.preformatted(command),
        page.paragraph("The configuration as run, and what it was run with:"),
        page.settings({**configuration, "versions": versions}),
    ]


def vector_figure(title: str, caption: str, figure: Figure) -> str:
    """A drawing carried inside the page."""
    return page.image(title, caption, "image/svg+xml", svg_bytes(figure))
