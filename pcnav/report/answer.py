"""The answer of a run as people read it: a line, a table, and the few numbers most come for."""

import math

from rich.box import SIMPLE_HEAD
from rich.console import Group
from rich.markup import escape
from rich.table import Table
from rich.text import Text

from pcnav.evaluation.answer.model import Answer, FinalEstimate, Finding, RunState, Verdict
from pcnav.files.text_table import MISSING, TextTable, display_unit, number

_HEADINGS = ("quantity", "estimate\nand one standard deviation", "verdict", "axes")
_MAX_DECIMALS = 9
_CARDS = {"range_m": "range", "rate_magnitude_deg_s": "angular rate"}
_DEVIATIONS = {
    "position_cam_m": "position, one standard deviation",
    "attitude_cam_xyzw": "attitude, one standard deviation",
    "attitude_world_xyzw": "attitude, one standard deviation",
    "mass_centre_model_m": "mass centre, one standard deviation",
}


def answer_line(answer: Answer) -> str:
    """What the run found, in a sentence or two."""
    if answer.estimate is None:
        return f"Nothing was found: no estimate in {_counted(answer.frames)}.{_how(answer)}"
    at = answer.estimate
    when = f"frame {at.frame} at {number(at.time_s)} s"
    age = f", {number(at.age_s)} s before the last" if at.age_s > 0.0 else ", the last"
    motion = f", followed as {at.motion.replace('_', ' ')}" if at.motion else ""
    claims = f"{answer.frames_claimed} of {_counted(answer.frames)} have an estimate that counts"
    if not answer.found:
        return (
            f"Nothing was found that the run stands for. Its last estimate is of {when}{age}, "
            f"status {at.status}{motion}.{_how(answer)}"
        )
    return f"Estimate of {when}{age}: {at.status}{motion}. {claims}.{_how(answer)}"


def _how(answer: Answer) -> str:
    return " The run was interrupted." if answer.state is RunState.INTERRUPTED else ""


def _counted(frames: int) -> str:
    return f"{frames} frame{'' if frames == 1 else 's'}"


def answer_table(answer: Answer) -> TextTable:
    """All findings, for a page."""
    found = {} if answer.estimate is None else answer.estimate.findings
    rows = tuple(
        (each.title, _both(each), verdict_text(each), each.frame) for each in found.values()
    )
    return TextTable("answer", "", _HEADINGS, rows, text_columns=4)


def terminal_answer(answer: Answer) -> Group:
    """The same for a terminal, narrow enough for 80 columns: line, table and warnings."""
    table = Table(box=SIMPLE_HEAD, pad_edge=False, padding=(0, 1, 0, 0))
    for heading in ("quantity", "estimate ± one standard deviation", "verdict"):
        table.add_column(heading)
    found = {} if answer.estimate is None else answer.estimate.findings
    for each in found.values():
        table.add_row(*map(escape, (each.title, _both(each), verdict_text(each))))
    warnings = [Text(f"warning: {text}") for text in answer.warnings]
    return Group(Text(answer_line(answer)), *([table] if found else []), *warnings)


def answer_cards(answer: Answer) -> list[tuple[str, str]]:
    """Large values of a page by name."""
    at = answer.estimate
    if at is None:
        return [("status", "nothing found")]
    status = f"status at {number(at.time_s)} s"
    cards = [(status, at.status if at.is_claimed else f"{at.status}, nothing found")]
    return cards + _values(at) + _deviations(at)


def _values(at: FinalEstimate) -> list[tuple[str, str]]:
    cards = []
    for key, name in _CARDS.items():
        each = at.findings.get(key)
        if each is not None:
            stated = "" if each.sd is None else f" ± {deviation_text(each)}"
            cards.append((f"{name}{stated}", f"{value_texts(each)[0]} {each.unit}"))
    return cards


def _deviations(at: FinalEstimate) -> list[tuple[str, str]]:
    cards = []
    for key, name in _DEVIATIONS.items():
        each = at.findings.get(key)
        if each is None or each.sd is None:
            continue
        scale, unit = display_unit(each.sd_unit, max(each.sd))
        cards.append((f"{name}: {each.verdict}", f"{number(scale * max(each.sd))} {unit}"))
    return cards


def _both(finding: Finding) -> str:
    unit = "" if finding.unit == "1" else f" {finding.unit}"
    value = ", ".join(value_texts(finding)) + unit
    return value if finding.sd is None else f"{value}\n± {deviation_text(finding)}"


def value_texts(finding: Finding) -> list[str]:
    """The components, each to two digits of its deviation; to six where there is none."""
    sds = finding.sd or ()
    if len(sds) == len(finding.value) and finding.sd_unit == finding.unit:
        steps = list(sds)
    else:
        # Of a quaternion or a direction: half an angle, or an angle, changes it by so much.
        steps = [math.radians(max(sds)) if sds else 1e-5] * len(finding.value)
    return [_to(value, step) for value, step in zip(finding.value, steps, strict=True)]


def _to(value: float, step: float) -> str:
    if not step > 0.0:
        return f"{value:.6g}"
    decimals = min(max(1 - math.floor(math.log10(step)), 0), _MAX_DECIMALS)
    return f"{value:.{decimals}f}"


def deviation_text(finding: Finding) -> str:
    """The deviations with their unit."""
    if finding.sd is None:
        return MISSING
    scale, unit = display_unit(finding.sd_unit, max(finding.sd))
    texts = ", ".join(number(scale * sd) for sd in finding.sd)
    return texts if unit == "1" else f"{texts} {unit}"


def verdict_text(finding: Finding) -> str:
    """One verdict where all components have the same, else each with its components."""
    verdicts = finding.verdicts
    if len(set(verdicts)) == 1:
        return str(verdicts[0])
    names = finding.components if len(verdicts) == len(finding.components) else ("x", "y", "z")
    by_verdict = {
        verdict: [name for name, own in zip(names, verdicts, strict=True) if own is verdict]
        for verdict in Verdict
    }
    return "; ".join(f"{', '.join(own)} {verdict}" for verdict, own in by_verdict.items() if own)
