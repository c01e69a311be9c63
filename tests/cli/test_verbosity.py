"""What commands say, and to whom: people, scripts, log files."""

import json
import re
from pathlib import Path

import pytest
import typer

from pcnav.cli import app
from pcnav.cli.progress import _Lines, progress
from pcnav.evaluation.answer.model import Answer
from tests.commands import Pcnav


def test_a_quiet_run_prints_its_answer_for_programs_alone(
    pcnav: Pcnav, sequence: Path, tmp_path: Path
) -> None:
    options = ("--no-report", "--frames", "3")
    answer = pcnav("run", sequence, "-o", tmp_path / "run", *options, "-q", "--json")
    assert (answer.code, answer.error_lines) == (0, [])
    (line,) = answer.out.splitlines()
    said = Answer.model_validate_json(line)
    assert said == Answer.model_validate_json((tmp_path / "run" / "summary.json").read_text())
    loud = pcnav("run", sequence, "-o", tmp_path / "loud", *options, "--verbose")
    frames = [one for one in loud.error_lines if one.startswith("DEBUG: <Estimate at ")]
    assert len(frames) == 3 and "locked" in frames[-1]
    assert "pcnav view" in loud.out
    both = pcnav("run", sequence, "-o", tmp_path / "both", "-q", "-v")
    assert both.code == 2 and "one of --quiet and --verbose" in both.error_lines[0]
    info = pcnav("info", sequence, "--json")
    assert json.loads(info.out)["frames"] == "6"


def test_every_command_can_be_quiet() -> None:
    group = typer.main.get_command(app)
    for name, command in group.commands.items():  # type: ignore[attr-defined]
        options = {word for one in command.params for word in one.opts}
        assert {"-q", "--quiet", "-v", "--verbose"} <= options, name


def test_a_log_file_gets_a_line_now_and_then(capsys: pytest.CaptureFixture[str]) -> None:
    clock = iter(float(k) for k in range(1000))
    lines = _Lines("run", lambda: next(clock))
    for done in range(1, 61):
        lines(done, 60, 2)
    told = capsys.readouterr().err.splitlines()
    # A frame a second: every ten seconds, and none at the end, where the answer follows.
    assert told[0] == "run: 10 of 60, 50 s left, 2 failed"
    assert [re.findall(r"\d+", line)[0] for line in told] == ["10", "20", "30", "40", "50"]


def test_where_there_is_no_terminal_short_work_says_nothing(
    capsys: pytest.CaptureFixture[str],
) -> None:
    with progress("run") as advance:
        for done in range(1, 1001):
            advance(done, 1000)
    assert capsys.readouterr().err == ""
