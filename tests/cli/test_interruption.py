"""Commands that are interrupted, and commands at a terminal."""

import os
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

from pcnav.estimators.depth.tracker import Tracker
from pcnav.evaluation.answer.model import Answer, RunState
from pcnav.runs.reader import read_run
from tests.cli.answers import FRAMES, PIPELINE, content
from tests.commands import PATIENCE_S, Pcnav

COMMAND = [sys.executable, "-c", "from pcnav.cli import main; main()"]
# Pictures take most of the time of so short a run.
WITHOUT_PICTURES = """
from pcnav.cli import main
from pcnav.report import figures
figures.svg_bytes = lambda figure: b""
main()
"""


def interrupt_at(monkeypatch: pytest.MonkeyPatch, index: int) -> None:
    step = Tracker.step

    def interrupted(self: Tracker, frame: Any) -> Any:
        if frame.index == index:
            raise KeyboardInterrupt
        return step(self, frame)

    monkeypatch.setattr(Tracker, "step", interrupted)


def test_an_interrupted_run_keeps_what_was_done(
    pcnav: Pcnav, sequence: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    interrupt_at(monkeypatch, 4)
    result = tmp_path / "new" / "result"
    answer = pcnav("run", sequence, "-o", result)
    assert answer.code == 130
    told, line = answer.error_lines
    assert told == f"WARNING: interrupted: {result} holds the 4 frames that were done"
    assert line.startswith("interrupted")
    found = Answer.model_validate_json((result / "summary.json").read_text())
    assert (found.state, found.found, found.frames) == (RunState.INTERRUPTED, True, 4)
    assert found.estimate is not None and found.estimate.frame == 3
    run = read_run(result, with_covariance=True)
    assert len(run) == 4 and run.is_finished
    assert [path.name for path in result.parent.iterdir()] == ["result"]


def test_a_run_interrupted_at_once_leaves_nothing(
    pcnav: Pcnav, sequence: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    interrupt_at(monkeypatch, 0)
    answer = pcnav("run", sequence, "-o", tmp_path / "new" / "result")
    assert answer.code == 130
    assert len(answer.error_lines) == 1
    assert {path.name for path in tmp_path.iterdir()} == {"sequence"}


def test_an_interrupted_run_does_not_replace_an_earlier_result(
    pcnav: Pcnav,
    recorded: Path,
    sequence: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    result = tmp_path / "result"
    shutil.copytree(recorded / "result", result)
    before = content(result)
    interrupt_at(monkeypatch, 4)
    answer = pcnav("run", sequence, "-o", result, "--overwrite")
    assert answer.code == 130
    assert len(answer.error_lines) == 1
    assert content(result) == before
    assert {path.name for path in tmp_path.iterdir()} == {"sequence", "result"}


@pytest.mark.skipif(os.name == "nt", reason="Windows ends a process without asking it")
@pytest.mark.parametrize("name", ["SIGTERM", "SIGHUP"])
def test_a_command_told_to_terminate_leaves_nothing(tmp_path: Path, name: str) -> None:
    endless = tmp_path / "endless.toml"
    endless.write_text(PIPELINE.replace("frames = 6", "frames = 2000"))
    arguments = ["simulate", str(endless), "-o", str(tmp_path / "sequence")]
    with subprocess.Popen([*COMMAND, *arguments], stderr=subprocess.PIPE, text=True) as process:
        deadline = time.monotonic() + PATIENCE_S
        while not list(tmp_path.glob(".sequence-*/depth/000003.png")):
            assert time.monotonic() < deadline and process.poll() is None
            time.sleep(0.02)
        process.send_signal(getattr(signal, name))
        _, err = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 130
    assert err.splitlines() == ["interrupted: nothing is left half-written"]
    assert list(tmp_path.iterdir()) == [endless]


# Terminals.


@pytest.mark.skipif(os.name == "nt", reason="needs a pseudo-terminal")
def test_a_terminal_shows_a_bar_and_the_log_above_it(sequence: Path, tmp_path: Path) -> None:
    ours, theirs = os.openpty()
    arguments = ["run", str(sequence), "-o", str(tmp_path / "result")]
    environment = {**os.environ, "TERM": "xterm", "COLUMNS": "100"}
    with subprocess.Popen(
        [sys.executable, "-c", WITHOUT_PICTURES, *arguments],
        stdout=subprocess.PIPE,
        stderr=theirs,
        env=environment,
    ) as process:
        os.close(theirs)
        shown = b""
        # Linux answers the end of a pseudo-terminal with an error.
        while chunk := read_or_end(ours):
            shown += chunk
        out, _ = process.communicate(timeout=PATIENCE_S)
    os.close(ours)
    assert process.returncode == 0, shown
    assert f"{FRAMES}/{FRAMES}".encode() in shown
    # The line of the bar is erased before the log line is written, and the bar is gone at the end.
    assert re.search(rb"\x1b\[2KINFO: frame \d+: acquiring -> locked \(.*\)\s*\r\n", shown), shown
    assert shown.rstrip().endswith(b"\x1b[2K")
    assert b"\x1b[2K" not in out


def read_or_end(terminal: int) -> bytes:
    try:
        return os.read(terminal, 4096)
    except OSError:
        return b""


# Nothing to see, or too little.
