"""The answer as people read it."""

import io

import pytest
from rich.console import Console

from pcnav.evaluation.answer.model import Answer, Finding, RunState, Verdict
from pcnav.report.answer import (
    answer_cards,
    answer_line,
    deviation_text,
    terminal_answer,
    value_texts,
    verdict_text,
)
from tests.report.conftest import Contents


def finding(value: tuple[float, ...], sd: tuple[float, ...] | None, **changes: object) -> Finding:
    told: dict[str, object] = {
        **{"title": "range", "frame": "hill", "unit": "m", "components": ("x", "y", "z")},
        **{"value": value, "sd_unit": "m", "sd": sd, "verdicts": (Verdict.DATA,)},
    }
    return Finding.model_validate({**told, **changes})


def test_numbers_have_the_digits_that_their_deviations_leave_them() -> None:
    each = finding((17.999359, -0.5, 0.0000123), (0.0008, 0.12, 0.003))
    assert value_texts(each) == ["17.99936", "-0.50", "0.0000"]
    assert deviation_text(finding((1.0,), (0.0008,))) == "0.800 mm"
    assert value_texts(finding((17.999359, 2.0, 3.0), None)) == [
        "17.999359",
        "2.000000",
        "3.000000",
    ]
    # A direction is known to an angle: 0.57 deg is a hundredth.
    turned = finding((0.123456, 0.2, 0.3), (0.573,), unit="1", sd_unit="deg")
    assert value_texts(turned) == ["0.123", "0.200", "0.300"]


def test_verdicts_are_told_together_where_they_agree() -> None:
    verdicts = (Verdict.DATA, Verdict.PRIOR, Verdict.DATA)
    mixed = finding((1.0, 2.0, 3.0), (0.1, 0.1, 0.1), verdicts=verdicts)
    assert verdict_text(mixed) == "x, z known from data; y from prior"
    assert mixed.verdict is Verdict.PRIOR
    assert verdict_text(finding((1.0, 2.0, 3.0), None)) == "known from data"


def printed(answer: Answer) -> str:
    stream = io.StringIO()
    Console(width=80, file=stream).print(terminal_answer(answer))
    return stream.getvalue()


@pytest.mark.parametrize("kind", ["depth", "image_motion", "open3d_icp"])
def test_a_terminal_is_told_all_findings_in_80_columns(make_content: Contents, kind: str) -> None:
    answer = make_content(kind, 20).answer
    told = printed(answer.model_copy(update={"warnings": ("the noise is not as stated",)}))
    assert max(map(len, told.splitlines())) <= 80
    assert answer_line(answer)[:40] in told
    assert answer.estimate is not None
    for each in answer.estimate.findings.values():
        assert each.title.split()[0] in told
    assert told.rstrip().endswith("warning: the noise is not as stated")


def test_nothing_found_is_said_without_a_table(make_content: Contents) -> None:
    nothing = make_content("depth", 3).answer
    assert printed(nothing).strip() == "Nothing was found: no estimate in 3 frames."
    assert answer_cards(nothing) == [("status", "nothing found")]
    stopped = nothing.model_copy(update={"state": RunState.INTERRUPTED})
    assert answer_line(stopped).endswith("The run was interrupted.")
    found = make_content("depth", 20).answer
    assert found.estimate is not None
    doubted = found.estimate.model_copy(update={"is_claimed": False, "status": "coasting"})
    unclaimed = found.model_copy(update={"estimate": doubted, "found": False})
    assert answer_line(unclaimed).startswith("Nothing was found that the run stands for.")
    assert answer_cards(unclaimed)[0][1] == "coasting, nothing found"
