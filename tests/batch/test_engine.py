"""Runs over processes of this machine: order, seeds, threads, failures, interrupts, resumption."""

import errno
import os
import signal
import subprocess
import sys
import time
from collections import Counter
from contextlib import suppress
from pathlib import Path

import pytest

from pcnav.batch.attempt import Failure
from pcnav.batch.cluster import Workers
from pcnav.batch.engine import outcomes, results
from pcnav.batch.store import RunStore, new_store, open_store, run_stored
from pcnav.batch.worker_check import here
from pcnav.core.errors import InputError
from tests.batch.cheap_runs import CheapRun, command_of, executions, lock_of, planned
from tests.commands import PATIENCE_S

HERE = Workers(jobs=1)
TWO = Workers(jobs=2)
RUNS = planned(8)
GRID = "[batch]\nname = 'cheap'\n"
BATCH = """
import sys
from pathlib import Path
from pcnav.batch.cluster import Workers
from pcnav.batch.store import new_store
from pcnav.batch.store import run_stored
from tests.batch.cheap_runs import CheapRun, command_of, planned

if __name__ == "__main__":
    import signal
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    out, log = Path(sys.argv[1]), Path(sys.argv[2])
    runs = planned(8)
    store = new_store(out, "", runs)
    try:
        run_stored(
            CheapRun(log, 3600.0, quick=runs[0].key), runs, store, Workers(int(sys.argv[3])),
            command_of, lambda done, total, failed: print(done, total, failed, flush=True),
        )
    except KeyboardInterrupt:
        raise SystemExit(130) from None
"""


@pytest.fixture
def store(tmp_path: Path) -> RunStore:
    """An empty one for the runs of this file."""
    return new_store(tmp_path / "out", GRID, RUNS)


def test_workers_that_cannot_be_meant_are_refused() -> None:
    for jobs, scheduler, expected in (
        (0, None, "expected at least 1, got 0"),
        (2, "tcp://host:8786", "expected none beside --scheduler"),
        (None, "host:8786", "like tcp://host:8786"),
        (None, "tcp://host", "like tcp://host:8786"),
    ):
        with pytest.raises(InputError, match=expected):
            Workers(jobs, scheduler)


def test_processes_work_on_one_thread_each(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # What another process is to call must be importable there, which a test module is not.
    monkeypatch.setenv("OMP_NUM_THREADS", "7")
    monkeypatch.delenv("MKL_NUM_THREADS", raising=False)
    names = ["OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS"]
    # The last, which dask would set, has a process ask the system for every array anew.
    names.append("MALLOC_TRIM_THRESHOLD_")
    assert dict(results(os.getenv, names, TWO)) == {0: "1", 1: "1", 2: "1", 3: None}
    assert os.environ["OMP_NUM_THREADS"] == "7" and "MKL_NUM_THREADS" not in os.environ


def test_no_other_user_of_the_machine_can_reach_the_processes() -> None:
    # Whoever reaches a port of a scheduler runs code as the user who started it.
    psutil = pytest.importorskip("psutil")
    here = psutil.Process()
    before = set(here.net_connections("inet"))
    opened: list[object] = []
    for _ in results(sum, [[k] for k in range(4)], TWO):
        children = here.children(recursive=True)
        opened += set(here.net_connections("inet")) - before
        with suppress(psutil.NoSuchProcess):
            opened += [each for child in children for each in child.net_connections("inet")]
        assert children
    assert not opened


def test_what_cannot_be_sent_back_or_loaded_is_the_failure_of_its_run() -> None:
    ended = dict(outcomes(lock_of, [0, 1], TWO, here()))
    for each in ended.values():
        assert isinstance(each, Failure)
        assert "pickle" in each.summary and "\n" not in each.summary


def test_records_are_the_same_from_one_process_and_from_two_and_failures_are_kept(
    store: RunStore, tmp_path: Path, recwarn: pytest.WarningsRecorder, capfd: pytest.CaptureFixture
) -> None:
    log, told = tmp_path / "log", []
    function = CheapRun(log, fails=RUNS[5].key)
    run_stored(function, RUNS, store, TWO, command_of, lambda *count: told.append(count))
    other = new_store(tmp_path / "other", GRID, RUNS)
    run_stored(function, RUNS, other, HERE, command_of)
    for run in RUNS:
        assert store.path(run.key).read_bytes() == other.path(run.key).read_bytes()
    # Progress: from none to all, of which one failed.
    assert [done for done, _, _ in told] == list(range(9)) and told[-1] == (8, 8, 1)
    failed = store.record(RUNS[5].key)
    assert failed.failure == "ValueError: no such pose" and failed.frames == 0
    assert failed.command == command_of(RUNS[5])
    assert not recwarn.list
    out, err = capfd.readouterr()
    assert (out, err) == ("", "")


def test_finished_runs_are_not_repeated_be_they_failures(store: RunStore, tmp_path: Path) -> None:
    log = tmp_path / "log"
    run_stored(CheapRun(log, fails=RUNS[0].key), RUNS[:3], store, HERE, command_of)
    assert store.missing == tuple(run.key for run in RUNS[3:])
    told: list[tuple[int, int, int]] = []
    run_stored(CheapRun(log), RUNS, store, HERE, command_of, lambda *count: told.append(count))
    assert executions(log) == [run.key for run in RUNS]
    assert told[0] == (3, 8, 1) and told[-1] == (8, 8, 1)


def test_a_run_that_kills_its_process_becomes_a_failure_and_loses_no_other(
    store: RunStore, tmp_path: Path
) -> None:
    log = tmp_path / "log"
    function = CheapRun(log, kills=RUNS[2].key)
    run_stored(function, RUNS, store, TWO, command_of)
    records = list(store.headers())
    assert [record.run for record in records] == RUNS
    assert [k for k, record in enumerate(records) if record.failure is not None] == [2]
    assert records[2].failure is not None
    assert "ended abruptly, each of the 3 times" in records[2].failure
    assert records[2].command == command_of(RUNS[2])
    assert Counter(executions(log)) == Counter({run.key: 1 for run in RUNS}) + Counter(
        {RUNS[2].key: 2}
    )


def test_a_file_system_that_refuses_ends_the_batch_and_names_the_file(
    store: RunStore, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(_: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as patch, pytest.raises(OSError, match="No space left") as caught:
        patch.setattr(os, "fsync", full)
        run_stored(CheapRun(tmp_path / "log"), RUNS, store, HERE, command_of)
    assert caught.value.filename == str(store.path(RUNS[0].key))
    # In another process the system itself refuses: no file may grow beyond so many bytes.
    with pytest.raises(OSError, match="File too large") as caught:
        log = tmp_path / "other-log"
        run_stored(CheapRun(log, largest_file=2000), RUNS, store, TWO, command_of)
    assert str(caught.value.filename).startswith(str(store.runs_folder))
    assert len(store.missing) == 8 and not list(store.runs_folder.iterdir())


@pytest.mark.study
@pytest.mark.parametrize(
    ("jobs", "number"),
    [(1, signal.SIGINT), (2, signal.SIGINT), (2, signal.SIGTERM), (2, signal.SIGKILL)],
)
def test_an_interrupt_ends_everything_at_once_and_leaves_finished_runs(
    tmp_path: Path, repository: Path, jobs: int, number: signal.Signals
) -> None:
    script, out, log = tmp_path / "batch.py", tmp_path / "out", tmp_path / "log"
    script.write_text(BATCH)
    command = [sys.executable, "-W", "error", str(script), str(out), str(log), str(jobs)]
    # A session of its own: the interrupt goes to all of its processes, as from a terminal.
    process = subprocess.Popen(
        command,
        env={**os.environ, "PYTHONPATH": str(repository)},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    assert process.stdout is not None and process.stderr is not None
    while process.stdout.readline().split() != ["1", "8", "0"]:
        assert process.poll() is None, process.stderr.read()
    os.killpg(process.pid, number) if number == signal.SIGINT else process.send_signal(number)
    # The runs that are out would take an hour more.
    code = process.wait(timeout=PATIENCE_S)
    _, errors = process.communicate()
    assert (code, errors) == (-9 if number == signal.SIGKILL else 130, "")
    assert not _living(process.pid)
    store = open_store(out)
    assert [record.run for record in store.headers()] == planned(8)[:1]
    assert not list(store.runs_folder.glob(".*"))


def _living(session: int) -> list[str]:
    """Names of the processes of a session, once those that are about to end have ended."""
    psutil = pytest.importorskip("psutil")
    deadline = time.monotonic() + 5.0
    while True:
        found = []
        for process in psutil.process_iter(["pid", "status", "cmdline"]):
            with suppress(ProcessLookupError):
                if os.getsid(process.pid) == session and process.info["status"] != "zombie":
                    found.append(" ".join(process.info["cmdline"] or ()))
        if not found or time.monotonic() > deadline:
            return found
        time.sleep(0.05)
