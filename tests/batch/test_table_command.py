"""What `pcnav table` does with a batch that was run, and what it refuses."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from pcnav.batch.standard_tables import Wanted, asked_layout
from pcnav.batch.store import RunStore, new_store
from pcnav.batch.tables import (
    run_table,
)
from pcnav.batch.tabulate import tabulate
from pcnav.core.errors import InputError
from tests.batch.stored_batch import FAILURE, MESSAGES, RUNS, rows_of, stored
from tests.commands import Pcnav


def test_a_pivot_is_what_was_asked_for() -> None:
    runs = run_table(RUNS)
    layout = asked_layout(Wanted(("range_m",), ("estimator",), ("add_s_p95_m",)), runs)
    assert (layout.rows, layout.columns) == (("range_m",), ("estimator",))
    assert asked_layout(Wanted(metrics=("nis",)), runs).rows == ("range_m", "range_sigma_m")
    assert asked_layout(Wanted(rows=("estimator",)), runs).columns == ()
    for wanted, message in (
        (Wanted(rows=("range",)), "--rows: range: expected some of: satellite, range_m"),
        (Wanted(columns=("x",)), "--columns: x: expected some of"),
        (Wanted(("estimator",), ("estimator",)), "not among the rows"),
        (Wanted(("range_m", "range_m")), "each axis once"),
        (Wanted(metrics=("speed",)), "--metrics: speed"),
        (Wanted(metrics=()), "one or more"),
    ):
        with pytest.raises(InputError, match=re.escape(message)):
            asked_layout(wanted, runs)


def test_the_command_tabulates_again_without_running(
    pcnav: Pcnav, store: RunStore, tmp_path: Path
) -> None:
    before = {path: path.stat().st_mtime_ns for path in store.runs_folder.iterdir()}
    code, out, err = pcnav(
        *("table", store.folder, "-o", tmp_path / "t", "--from", "5"),
        *("--rows", "range_m, range_sigma_m", "--columns", "estimator"),
        *("--metrics", "attitude_rms_deg,position_p95_m"),
    )
    assert (code, err) == (0, "")
    assert "attitude, RMS, deg" in out and "position, 95 %, mm" in out
    assert FAILURE in out
    assert "Errors over the frames from 5 s after the first on." in out
    rows = rows_of((tmp_path / "t" / "pivot.csv").read_text())
    assert len(rows) == 12
    assert {path: path.stat().st_mtime_ns for path in store.runs_folder.iterdir()} == before


THREADS = """
import os, sys
from importlib.abc import MetaPathFinder
class Watch(MetaPathFinder):
    def find_spec(self, name, path, target=None):
        if name == "numpy":
            print("numpy with", os.environ.get("OPENBLAS_NUM_THREADS"))
sys.meta_path.insert(0, Watch())
sys.argv = ["pcnav", "table", "nosuchgrid"]
from pcnav.cli import main
main()
"""


def test_the_libraries_are_loaded_for_one_thread(repository: Path) -> None:
    """As in the processes of a batch: sums over several threads depend on their number."""
    variables = {k: v for k, v in os.environ.items() if not k.endswith("_NUM_THREADS")}
    command = [sys.executable, "-c", THREADS]
    done = subprocess.run(
        command, env=variables, cwd=repository, capture_output=True, text=True, check=False
    )
    assert done.stdout.splitlines()[0] == "numpy with 1"
    assert "nosuchgrid: grid: expected a TOML file" in done.stderr


def test_bad_commands_are_one_line_each(pcnav: Pcnav, store: RunStore, tmp_path: Path) -> None:
    folder, other = store.folder, tmp_path / "other"
    other.mkdir()
    (other / "precious.txt").write_text("mine")
    for arguments, told in (
        ((), "expected a grid, a batch or --compare"),
        ((folder, "--rows", "range"), "--rows: range: expected some of: satellite"),
        ((folder, "--metrics", "speed_m"), "--metrics: speed_m: expected some of"),
        ((folder, "--jobs", "2"), "--jobs: expected none"),
        ((folder, "--from", "1000"), "--from: expected at most"),
        (("nosuchbatch",), "nosuchbatch"),
        ((folder, "-o", other), "empty or new folder"),
        ((folder, "-o", other, "--overwrite"), "no index.html"),
        ((other,), "expected that of a batch, with batch.json"),
        ((tmp_path / "none.toml", "-o", tmp_path / "x"), "grid: expected a TOML file or one of"),
        (("accuracy",), "--out: expected a folder"),
        (("--compare", folder, other), "expected that of a batch"),
        (("--compare", folder, folder, "--rows", "range_m"), "--rows: expected none"),
        (("--compare", folder, folder, "--metrics", "x"), "--metrics: x"),
    ):
        code, _, err = pcnav("table", *arguments)
        assert code == 2, arguments
        assert told in err, err
        assert err.count("\n") == 1
    assert [path.name for path in other.iterdir()] == ["precious.txt"]


def test_a_comparison_answers_with_its_exit_code(
    pcnav: Pcnav, store: RunStore, tmp_path: Path
) -> None:
    worse = stored(tmp_path / "worse", RUNS, factor=1.5, failures=MESSAGES).folder
    assert pcnav("table", "--compare", store.folder, store.folder)[0] == 0
    code, out, _ = pcnav(
        "table", "--compare", store.folder, worse, "--metrics", "attitude_rms_deg,pose_pct"
    )
    assert code == 0  # Only the position is worse.
    assert "0 worse" in out
    code, out, err = pcnav("table", "--compare", store.folder, worse)
    assert (code, err) == (1, "")
    assert "+50.0 %" in out
    assert "worse" in out
    assert pcnav("table", "--compare", worse, store.folder)[0] == 0


def test_a_batch_without_a_finished_run_has_no_table(tmp_path: Path) -> None:
    empty = new_store(tmp_path / "empty", "x", RUNS)
    with pytest.raises(InputError, match="at least one finished run"):
        tabulate(empty)
    assert not (tmp_path / "empty" / "tables").exists()


def test_a_batch_of_failures_alone_still_has_its_tables(tmp_path: Path) -> None:
    runs = RUNS[:4]
    failed = stored(tmp_path / "failed", runs, failures={run.key: "no" for run in runs})
    summary = tabulate(failed)
    assert len(summary.failures) == 4
    assert summary.page == tmp_path.resolve() / "failed" / "tables" / "index.html"
    text = (summary.page.parent / "locking.md").read_text()
    assert "| 3, 3 failed |" in text and "| 1, 1 failed |" in text
    # Tabulating again takes the place of the tables that are there.
    tabulate(failed)
