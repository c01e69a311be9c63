"""No mutant of a file that pcnav reads is a traceback, a hang or a runaway of memory."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

MUTANTS = 2000
SEED = 1


@pytest.mark.study
@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="needs fork and /proc")
def test_every_mutant_is_read_or_refused_in_one_line(repository: Path) -> None:
    pytest.importorskip("tifffile")
    # Afresh: what other tests have loaded and started would be forked along.
    command = [sys.executable, "-m", "tests.fuzz.run", "--mutants", str(MUTANTS)]
    environment = {**os.environ, "PYTHONPATH": str(repository)}
    environment |= dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
    answer = subprocess.run(
        [*command, "--seed", str(SEED)],
        cwd=repository,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert answer.returncode == 0, answer.stdout + answer.stderr
    *bad, counts = answer.stdout.splitlines()
    assert not bad, "\n".join(bad)
    assert "'refused'" in counts and "'accepted'" in counts
