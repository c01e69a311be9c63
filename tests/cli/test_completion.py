"""What a shell is told to complete."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.commands import PATIENCE_S


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ("pcnav obs", ["observability"]),
        ("pcnav run --estimator small", ["small_gicp", "small_gicp_10"]),
        ("pcnav simulate work", ["workshop"]),
        ("pcnav target twin", ["twinwing"]),
    ],
)
def test_names_are_completed(words: str, expected: list[str], repository: Path) -> None:
    asked = {
        **{"_PCNAV_COMPLETE": "complete_bash", "COMP_WORDS": words},
        **{"COMP_CWORD": str(len(words.split()) - 1), "PYTHONPATH": str(repository)},
    }
    program = "import sys; sys.argv[:] = ['pcnav']; from pcnav.cli import main; main()"
    answer = subprocess.run(
        [sys.executable, "-c", program],
        env={**os.environ, **asked},
        capture_output=True,
        text=True,
        check=False,
        timeout=PATIENCE_S,
    )
    assert answer.stdout.split() == expected, answer.stderr
