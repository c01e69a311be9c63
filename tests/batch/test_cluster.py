"""A scheduler and workers as users start them, on loopback: same records, whatever dies."""

import os
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import pytest

from pcnav.batch import cluster, engine
from pcnav.batch.cluster import Workers
from pcnav.batch.engine import results
from pcnav.batch.grid import named_grid
from pcnav.batch.run_batch import run_batch
from pcnav.batch.store import RunStore, new_store, run_stored
from pcnav.core.errors import InputError
from tests.batch.cheap_runs import CheapRun, command_of, executions, planned
from tests.commands import PATIENCE_S

RUNS = planned(24)
CLIENT = """
import sys
from pathlib import Path
from pcnav.batch.cluster import Workers
from pcnav.batch.store import new_store
from pcnav.batch.store import run_stored
from tests.batch.cheap_runs import CheapRun, command_of, planned

if __name__ == "__main__":
    runs = planned(24)
    store = new_store(Path(sys.argv[2]), "", runs)
    workers = Workers(scheduler=sys.argv[1])
    run_stored(CheapRun(Path(sys.argv[3]), 0.1), runs, store, workers, command_of)
"""


@dataclass(frozen=True)
class Dask:
    """A running scheduler, and how to start more of its workers."""

    process: subprocess.Popen[bytes]
    address: str
    folder: Path
    environment: dict[str, str]

    @property
    def workers(self) -> Workers:
        """What a batch is given."""
        return Workers(scheduler=self.address)

    @contextmanager
    def worker(self, *options: str, **environment: str) -> Iterator[subprocess.Popen[bytes]]:
        """One more worker, ended with all of its processes when the block ends."""
        words = ["worker", self.address, "--nthreads", "1", "--no-dashboard", *options]
        words += ["--host", "127.0.0.1", "--dashboard-address", "127.0.0.1:0"]
        words += ["--local-directory", str(self.folder), "--memory-limit", "0"]
        with _dask(words, self.environment | environment) as process:
            yield process


@contextmanager
def _dask(words: list[str], environment: dict[str, str]) -> Iterator[subprocess.Popen[bytes]]:
    process = subprocess.Popen(
        [sys.executable, "-m", "dask", *words],
        env=environment,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )
    try:
        yield process
    finally:
        _kill(process)


def _kill(process: subprocess.Popen[bytes]) -> None:
    """End a worker as a power cut does: its watching process with it."""
    if process.poll() is None:
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()


@contextmanager
def _scheduler(
    folder: Path, repository: Path, protocol: str = "tcp", **settings: str
) -> Iterator[Dask]:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    environment = {**os.environ, "PYTHONPATH": str(repository), **settings}
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        environment.pop(name, None)
    words = ["scheduler", "--host", "127.0.0.1", "--port", str(port), "--no-dashboard"]
    words += ["--protocol", protocol]
    with _dask([*words, "--dashboard-address", "127.0.0.1:0"], environment) as process:
        yield Dask(process, f"{protocol}://127.0.0.1:{port}", folder, environment)


@pytest.fixture(scope="module")
def dask(tmp_path_factory: pytest.TempPathFactory, repository: Path) -> Iterator[Dask]:
    """A scheduler with one worker that stays."""
    folder = tmp_path_factory.mktemp("dask")
    with _scheduler(folder, repository) as running, running.worker():
        _until(lambda: len(_worker_threads(running.address)) == 1)
        yield running


@pytest.fixture(scope="module")
def local(tmp_path_factory: pytest.TempPathFactory) -> RunStore:
    """The batch, run in this process."""
    folder = tmp_path_factory.mktemp("local")
    store = new_store(folder / "out", "", RUNS)
    run_stored(CheapRun(folder / "log"), RUNS, store, Workers(jobs=1), command_of)
    return store


@pytest.fixture
def store(tmp_path: Path) -> RunStore:
    """An empty one for the runs of this file."""
    return new_store(tmp_path / "out", "", RUNS)


def _worker_threads(address: str) -> dict[str, int]:
    from distributed import Client

    try:
        with Client(address, timeout=PATIENCE_S, set_as_default=False) as client:
            return dict(client.nthreads())
    except OSError:
        return {}


def _until(done: Callable[[], bool]) -> None:
    deadline = time.monotonic() + PATIENCE_S
    while not done():
        assert time.monotonic() < deadline, "it takes too long"
        time.sleep(0.05)


def _assert_same(store: RunStore, local: RunStore) -> None:
    assert not store.missing
    for run in RUNS:
        assert store.path(run.key).read_bytes() == local.path(run.key).read_bytes()


@pytest.mark.study
def test_a_worker_that_is_killed_loses_nothing_and_the_records_are_those_of_this_process(
    dask: Dask, store: RunStore, local: RunStore, tmp_path: Path, capfd: pytest.CaptureFixture
) -> None:
    log = tmp_path / "log"
    finished: list[str] = []
    with dask.worker() as second:
        _until(lambda: len(_worker_threads(dask.address)) == 2)

        def kill_one(done: int, total: int, failed: int) -> None:
            assert total == len(RUNS) and failed == 0
            if done == 6:
                _kill(second)
                finished.extend(run.key for run in RUNS if store.finished(run))

        run_stored(CheapRun(log, 0.1), RUNS, store, dask.workers, command_of, kill_one)
    _assert_same(store, local)
    times = Counter(executions(log))
    assert len(finished) >= 6 and all(times[key] == 1 for key in finished)
    # What the killed worker had begun is all that was begun twice.
    assert set(times) == {run.key for run in RUNS} and sum(times.values()) <= len(RUNS) + 1
    assert capfd.readouterr().err == ""


def test_a_killed_client_goes_on_where_it_ended(
    dask: Dask, store: RunStore, local: RunStore, tmp_path: Path
) -> None:
    script, log = tmp_path / "client.py", tmp_path / "log"
    script.write_text(CLIENT)
    command = [sys.executable, str(script), dask.address, str(store.folder), str(log)]
    client = subprocess.Popen(command, env=dask.environment)
    _until(lambda: len(store.missing) <= len(RUNS) - 5)
    client.kill()
    client.wait()
    written = {
        run.key: store.path(run.key).stat().st_mtime_ns for run in RUNS if store.finished(run)
    }
    assert 5 <= len(written) < len(RUNS)
    run_stored(CheapRun(log, 0.02), RUNS, store, dask.workers, command_of)
    _assert_same(store, local)
    times = Counter(executions(log))
    for key, at in written.items():
        assert times[key] == 1 and store.path(key).stat().st_mtime_ns == at
    # The run that the only worker had begun may have been begun again.
    assert sum(times.values()) <= len(RUNS) + 1


def test_studies_run_there_too(dask: Dask) -> None:
    found = dict(results(abs, [3, -4, 5, -6], dask.workers))
    assert found == {0: 3, 1: 4, 2: 5, 3: 6}


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        (["--preload", "tests.batch.old_worker"], r"version of pcnav: expected .*, found 0\.0\.1"),
        (["--nthreads", "2"], "threads: expected 1 .*found 2"),
    ],
    ids=["version", "threads"],
)
def test_a_worker_that_would_give_other_numbers_is_named_and_refused(
    dask: Dask, options: list[str], expected: str
) -> None:
    with dask.worker(*options):
        _until(lambda: len(_worker_threads(dask.address)) == 2)
        with pytest.raises(InputError, match=f"^tcp://127.0.0.1:[0-9]+: {expected}") as caught:
            dict(results(abs, [1], dask.workers))
    assert "\n" not in str(caught.value)
    _until(lambda: len(_worker_threads(dask.address)) == 1)


def test_a_worker_that_joins_late_is_refused_as_well(
    dask: Dask, store: RunStore, tmp_path: Path
) -> None:
    # It needs seconds to start, in which the other one is asked and begins.
    expected = "OMP_NUM_THREADS: expected 1 .*found 4"
    with dask.worker(OMP_NUM_THREADS="4"), pytest.raises(InputError, match=expected):
        run_stored(CheapRun(tmp_path / "log", 0.5), RUNS, store, dask.workers, command_of)
    assert len(list(store.headers())) < len(RUNS)
    _until(lambda: len(_worker_threads(dask.address)) == 1)


def test_a_folder_that_workers_do_not_see_is_refused(
    dask: Dask, store: RunStore, tmp_path: Path
) -> None:
    # A folder of the same name on another machine, even one made from a copy, is another one.
    elsewhere = replace(store, identity="0")
    with pytest.raises(InputError, match=r"folder: expected to see .*/out as it is here"):
        run_stored(CheapRun(tmp_path / "log"), RUNS, elsewhere, dask.workers, command_of)
    assert not executions(tmp_path / "log")


@pytest.mark.parametrize("listens", [False, True])
def test_a_scheduler_that_does_not_answer_is_one_line_and_is_not_waited_for(
    listens: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        if listens:
            # It takes connections and says nothing.
            other.listen()
            monkeypatch.setattr(cluster, "_ANSWER_WITHIN_S", 1.0)
        address = f"tcp://127.0.0.1:{other.getsockname()[1]}"
        started = time.monotonic()
        with pytest.raises(InputError, match=rf"^{address}: scheduler: expected a dask scheduler"):
            dict(results(abs, [1], Workers(scheduler=address)))
        assert time.monotonic() - started < PATIENCE_S


@pytest.mark.study
def test_a_scheduler_without_workers_or_that_goes_away_is_said(
    tmp_path: Path, repository: Path, store: RunStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cluster, "WORKERS_WITHIN_S", 0.2)
    monkeypatch.setattr(cluster, "_TELL_AFTER_S", 0.1)
    monkeypatch.setattr(engine, "_ALONE_FOR_S", 0.5)
    with _scheduler(tmp_path, repository) as lonely:
        with pytest.raises(InputError, match="workers: expected a worker within"):
            dict(results(abs, [1], lonely.workers))
        with lonely.worker() as only:
            _until(lambda: len(_worker_threads(lonely.address)) == 1)

            def leave(done: int, total: int, failed: int) -> None:
                if done == 2:
                    _kill(only)

            run = CheapRun(tmp_path / "log", 0.05)
            with pytest.raises(InputError, match="workers: expected one to come back"):
                run_stored(run, RUNS, store, lonely.workers, command_of, leave)
        with lonely.worker():
            _until(lambda: len(_worker_threads(lonely.address)) == 1)

            def end(done: int, total: int, failed: int) -> None:
                if done == 10:
                    _kill(lonely.process)

            started = time.monotonic()
            with pytest.raises(InputError, match="scheduler: expected it to stay to the end"):
                run_stored(run, RUNS, store, lonely.workers, command_of, end)
            assert time.monotonic() - started < PATIENCE_S
    assert len(list(store.headers())) >= 10


def test_workers_that_cannot_be_used_leave_no_folder_behind(tmp_path: Path) -> None:
    plan = named_grid("accuracy")
    with socket.socket() as nobody:
        nobody.bind(("127.0.0.1", 0))
        workers = Workers(scheduler=f"tcp://127.0.0.1:{nobody.getsockname()[1]}")
        with pytest.raises(InputError, match="scheduler"):
            run_batch(plan, tmp_path / "out", workers)
    assert not (tmp_path / "out").exists()


@pytest.mark.study
@pytest.mark.skipif(shutil.which("openssl") is None, reason="openssl makes the key")
def test_with_tls_as_documented_only_who_has_the_key_is_let_in(
    tmp_path: Path, repository: Path
) -> None:
    key, certificate = tmp_path / "key.pem", tmp_path / "cert.pem"
    command = [
        "openssl",
        "req",
        "-x509",
        "-newkey",
        "rsa:3072",
        "-nodes",
        "-days",
        "30",
        "-subj",
        "/CN=pcnav",
        "-keyout",
    ]
    subprocess.run([*command, key, "-out", certificate], check=True, capture_output=True)
    page = (repository / "docs" / "cluster.md").read_text()
    settings = page.split("```yaml\n")[1].split("```")[0].replace("/home/me/.pcnav-cluster", "{}")
    (tmp_path / "tls.yaml").write_text(settings.replace("{}", str(tmp_path)))
    with _scheduler(tmp_path, repository, "tls", DASK_CONFIG=str(tmp_path)) as safe, safe.worker():
        probe = tmp_path / "probe.py"
        probe.write_text(
            "import sys\nfrom pcnav.batch.cluster import Workers\n"
            "from pcnav.batch.engine import results\n"
            "print(dict(results(abs, [3, -4], Workers(scheduler=sys.argv[1]))))\n"
        )
        for has_key in (True, False):
            environment = dict(safe.environment)
            if not has_key:
                environment["DASK_CONFIG"] = str(tmp_path / "none")
            answer = subprocess.run(
                [sys.executable, str(probe), safe.address],
                env=environment,
                capture_output=True,
                text=True,
                check=False,
            )
            if has_key:
                assert answer.stdout == "{0: 3, 1: 4}\n", answer.stderr
            else:
                assert "expected a dask scheduler that answers" in answer.stderr
