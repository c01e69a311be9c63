"""The report of a run of any estimator: one HTML page that carries everything it shows.

Its sections are told apart by what the run holds, not by the estimator: each of them returns its
pieces, or none where it does not apply.
"""

from collections.abc import Callable
from pathlib import Path

from pcnav.evaluation.metrics import Metrics
from pcnav.files.text_table import TextTable, number
from pcnav.report.answer import answer_cards, answer_line, answer_table
from pcnav.report.budget import budget_table
from pcnav.report.content import ReportContent
from pcnav.report.evaluation import against_the_truth, consistency, information_gain
from pcnav.report.figures import drawing
from pcnav.report.measurements import frames_by_outcome, measurements, own_notes
from pcnav.report.mesh_fit import mesh_against_frames
from pcnav.report.page import Code, Part, Piece, document
from pcnav.report.states import states_over_time
from pcnav.report.status import status_and_evidence
from pcnav.report.summary import error_row, run_facts

_MEDIANS = {
    "position_cam": "median position error, last third",
    "r_hill": "median mass-centre error, last third",
    "attitude": "median attitude error, last third",
    "com_model": "median mass-centre error, last third",
}


def write_report(path: Path, content: ReportContent) -> None:
    """Write the page of a run: UTF-8 HTML that loads nothing from elsewhere."""
    path.write_text(report_html(content), encoding="utf-8")


def report_html(content: ReportContent) -> str:
    """The page of a run."""
    metrics = content.metrics
    seconds = f"{metrics.frames} frames over {number(metrics.duration_s)} s"
    names = [name for name in (content.run.estimator, content.answer.target) if name]
    made = [Part(title, section(content)) for title, section in SECTIONS.items()]
    parts = [part for part in made if part.pieces]
    lead = " · ".join([*names, seconds])
    return document(content.title, lead, _headline(content), parts, content.answer.warnings)


def _headline(content: ReportContent) -> list[tuple[str, str]]:
    """The few numbers most readers come for."""
    metrics, run = content.metrics, content.run
    share = metrics.frames_with_estimate / max(metrics.frames, 1)
    facts = [*answer_cards(content.answer), ("frames with an estimate", f"{share:.1%}")]
    if metrics.frames_with_estimate:
        after = f"{number(metrics.first_estimate_after_s)} s"
        facts.append(("until the first estimate", after))
    facts += _medians(metrics)
    if metrics.nis.frames:
        name = "NIS per degree of freedom (1 is right)"
        facts.append((name, number(metrics.nis.mean_per_degree)))
    if "outcome" in run.words:
        facts.append(("frames measured", f"{run.status.count('locked')} of {len(run)}"))
    return facts


def _medians(metrics: Metrics) -> list[tuple[str, str]]:
    found = {quantity.key: error_row(quantity) for quantity in metrics.quantities}
    if "com_model" in found:
        # The error in Hill axes is that in the model, turned.
        found.pop("r_hill", None)
    return [
        (title, f"{found[key].median} {found[key].unit}")
        for key, title in _MEDIANS.items()
        if key in found
    ]


def _answer(content: ReportContent) -> list[Piece]:
    table = answer_table(content.answer)
    return [answer_line(content.answer), *([table] if table.rows else [])]


def _summary(content: ReportContent) -> list[Piece]:
    facts = run_facts(content.metrics, content.gain)
    table = TextTable("", "", ("", ""), tuple(facts), text_columns=2)
    if content.picture is None:
        return [table]
    title = "One frame as it was understood"
    return [(table, drawing(title, content.picture_caption, content.picture))]


def _observability(content: ReportContent) -> list[Piece]:
    return [*content.observability]


def _provenance(content: ReportContent) -> list[Piece]:
    return [
        Code(content.command),
        "The configuration as run, and what it was run with:",
        {**content.configuration, "versions": content.versions},
    ]


def _budget(content: ReportContent) -> list[Piece]:
    table = budget_table(content.answer)
    return [] if table is None else [table]


SECTIONS: dict[str, Callable[[ReportContent], list[Piece]]] = {
    "Answer": _answer,
    "Error budget": _budget,
    "Consistency": consistency,
    "Against the truth": against_the_truth,
    "Summary": _summary,
    "Status": status_and_evidence,
    "Frames": frames_by_outcome,
    "States over time": states_over_time,
    "Information gain": information_gain,
    "Observability of this motion": _observability,
    "Mesh against the frames": mesh_against_frames,
    "Measurements": measurements,
    "Notes of the estimator": own_notes,
    "How the run was made": _provenance,
}
"""In the order of the page: what was found, how far it may be believed, then the rest."""
