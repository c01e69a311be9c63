"""What the deviations of the final estimate are made of, as a page shows it."""

from pcnav.evaluation.answer.model import Answer, Finding
from pcnav.files.text_table import MISSING, TextTable, display_unit, number

_SHOWN = (
    "range_m",
    "position_cam_m",
    "attitude_cam_xyzw",
    "velocity_hill_m_s",
    "rate_body_deg_s",
    "momentum_direction_world",
    "mass_centre_model_m",
    "inertia_ratios",
)
_NOTE = (
    "One standard deviation, of the component that is known least, and what makes it; the squares "
    "of a row add up to that of its whole. What the calibration makes is considered: it is the "
    "same in all frames, and more of them do not lessen it. What is known of the camera is "
    "stated in [calibration] of sequence.toml."
)


def budget_table(answer: Answer) -> TextTable | None:
    """The error budget of a run; None where its estimator does not say."""
    found = {} if answer.estimate is None else answer.estimate.findings
    told = [found[name] for name in _SHOWN if name in found and found[name].budget]
    if not told:
        return None
    sources = list(dict.fromkeys(name for each in told for name in each.budget or {}))
    rows = tuple(_row(each, sources) for each in told)
    headings = ("quantity", "unit", "all", *sources)
    return TextTable("error_budget", "", headings, rows, _NOTE, text_columns=2)


def _row(finding: Finding, sources: list[str]) -> tuple[str, ...]:
    assert finding.sd is not None and finding.budget is not None, "it was asked for"
    least = max(range(len(finding.sd)), key=finding.sd.__getitem__)
    scale, unit = display_unit(finding.sd_unit, finding.sd[least])
    parts = (finding.budget[name][least] if name in finding.budget else None for name in sources)
    told = (MISSING if part is None else number(scale * part) for part in parts)
    return finding.title, "" if unit == "1" else unit, number(scale * finding.sd[least]), *told
