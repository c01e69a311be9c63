"""Where runs are run: processes of this machine, or the workers of a dask scheduler."""

import asyncio
import logging
import multiprocessing
import os
import re
import signal
import tempfile
import warnings
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing import resource_tracker
from typing import TYPE_CHECKING, Any

from pcnav.batch.process import THREAD_VARIABLES, one_thread_each
from pcnav.batch.worker_check import Requirements, check_workers
from pcnav.core.errors import InputError

if TYPE_CHECKING:
    from distributed import Client, LocalCluster

_MAX_JOBS = 8
"""A process holds the libraries and a satellite, some 400 MB: more are not started unasked."""
_ADDRESS = re.compile(r"[a-z]+://.+:\d+/?")
_ANSWER_WITHIN_S = 5.0
_TELL_AFTER_S = 3.0
WORKERS_WITHIN_S = 30.0
"""How long a scheduler without workers is waited for at the beginning."""
THIS_MACHINE = "this machine"
"""Stands where messages name a scheduler."""
DEATHS_OF_A_RUN = 3
"""Processes of this machine that may end in the middle of a run before it counts as failed."""

_SETTINGS: dict[str, Any] = {
    "distributed.scheduler.allowed-failures": DEATHS_OF_A_RUN - 1,
    # A run that computes for minutes without letting go is not a dead process.
    "distributed.scheduler.worker-ttl": None,
    "distributed.comm.timeouts.connect": "60s",
    "distributed.comm.timeouts.tcp": "60s",
    # A process that ends is started again, however long that takes on a busy machine.
    "distributed.deploy.lost-worker-timeout": "1 hour",
    "distributed.worker.multiprocessing-method": "spawn",
    # Dask has processes give every freed array back to the system at once. Runs that make and drop
    # images would spend a third of their time on getting the memory again.
    "distributed.nanny.pre-spawn-environ": dict.fromkeys(THREAD_VARIABLES, "1"),
    # What nobody looks at: pages, profiles and copies of results.
    "distributed.scheduler.http.routes": [],
    "distributed.worker.http.routes": [],
    "distributed.worker.profile.enabled": False,
    "distributed.admin.system-monitor.gil.enabled": False,
    "distributed.scheduler.active-memory-manager.start": False,
    "distributed.scheduler.work-stealing": False,
}
"""Of the scheduler and the workers that pcnav starts itself."""

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Workers:
    """What runs are spread over.

    Raises `InputError` for a number of processes or an address that cannot be meant.
    """

    jobs: int | None = None
    """Processes of this machine: None takes one per usable core, 1 stays in this process."""
    scheduler: str | None = None
    """Address of a dask scheduler, like ``tcp://host:8786``, whose workers are used instead."""

    def __post_init__(self) -> None:
        if self.jobs is not None and self.jobs < 1:
            raise InputError("--jobs", "processes", f"expected at least 1, got {self.jobs}")
        if self.scheduler is None:
            return
        if self.jobs is not None:
            expected = "expected none beside --scheduler, whose workers are what they are"
            raise InputError("--jobs", "processes", expected)
        if not _ADDRESS.fullmatch(self.scheduler):
            expected = "expected the address of a dask scheduler, like tcp://host:8786"
            raise InputError(self.scheduler, "scheduler", expected)


EVERY_CORE = Workers()
"""One process per usable core of this machine."""


def usable_cores() -> int:
    """Cores this process may run on."""
    try:
        return len(os.sched_getaffinity(0))
    except AttributeError:  # macOS and Windows do not say
        return os.cpu_count() or 1


@contextmanager
def connected(workers: Workers, runs: int, requirements: Requirements) -> "Iterator[Client | None]":
    """A client of the workers that so many runs are worth; None is this process.

    Whatever ends the block ends the processes started here with all that they are doing, and takes
    back what a scheduler has not begun. Raises `InputError` when a scheduler or its workers cannot
    be used.
    """
    if workers.scheduler is not None:
        with _remote(workers.scheduler, requirements) as client:
            yield client
        return
    jobs = min(usable_cores(), _MAX_JOBS) if workers.jobs is None else workers.jobs
    jobs = min(jobs, runs)
    if jobs <= 1:
        with one_thread_each():
            yield None
        return
    with _local(jobs) as client:
        yield client


@contextmanager
def _local(jobs: int) -> "Iterator[Client]":
    import dask
    from distributed import Client, LocalCluster

    with (
        one_thread_each(),
        dask.config.set(_SETTINGS),
        tempfile.TemporaryDirectory(prefix="pcnav-", ignore_cleanup_errors=True) as scratch,
        _quiet(),
    ):
        before = set(multiprocessing.active_children())
        with _interrupts_kept_from_threads():
            # The workers come later: starting them takes seconds, in which a user may interrupt.
            cluster = LocalCluster(
                n_workers=0,
                threads_per_worker=1,
                processes=True,
                host="127.0.0.1",
                dashboard_address=None,
                worker_dashboard_address=None,
                # Dask reserves a fixed port for pages even when it shows none.
                scheduler_kwargs={"dashboard_address": "127.0.0.1:0"},
                # The system judges memory: a run may need what its neighbours leave.
                memory_limit=0,
                local_directory=scratch,
                silence_logs=logging.CRITICAL,
            )
        try:
            with Client(cluster, set_as_default=False) as client:
                cluster.scale(jobs)
                _wait_for_workers(client, THIS_MACHINE)
                yield client
        except BaseException:
            _end_now(cluster, before)
            raise
        finally:
            cluster.close()


def _end_now(cluster: "LocalCluster", before: set[multiprocessing.process.BaseProcess]) -> None:
    """End the workers in the middle of what they do: asked politely they finish it."""
    for nanny in cluster.workers.values():
        # It would start a new process for one that ends.
        nanny.close_gracefully()
    for child in set(multiprocessing.active_children()) - before:
        child.kill()


@contextmanager
def _remote(address: str, requirements: Requirements) -> "Iterator[Client]":
    from distributed import Client
    from distributed.versions import VersionMismatchWarning

    with _quiet():
        try:
            _greet(address)
            with warnings.catch_warnings():
                # The workers are compared with this process below, by what matters.
                warnings.simplefilter("ignore", VersionMismatchWarning)
                client = Client(address, timeout=_ANSWER_WITHIN_S, set_as_default=False)
        # Whatever answers there, or nothing: distributed raises what it meets.
        except Exception as error:
            expected = f"expected a dask scheduler that answers within {_ANSWER_WITHIN_S:g} s"
            raise InputError(address, "scheduler", expected) from error
        with client:
            _wait_for_workers(client, address)
            check_workers(client, requirements)
            yield client


def _greet(address: str) -> None:
    """Raises ``OSError`` unless something that speaks dask's protocol is there.

    A client would wait for ever for one that takes the connection and says nothing.
    """
    from distributed import Security
    from distributed.comm.core import connect

    arguments = Security().get_connection_args("client")

    async def greet() -> None:
        comm = await connect(address, timeout=_ANSWER_WITHIN_S, **arguments)
        await comm.close()

    async def within_time() -> None:
        await asyncio.wait_for(greet(), _ANSWER_WITHIN_S)

    # A thread of its own: this one may have an event loop that runs, as in a notebook.
    with ThreadPoolExecutor(1) as thread:
        thread.submit(asyncio.run, within_time()).result()


def _wait_for_workers(client: "Client", where: str) -> None:
    try:
        client.wait_for_workers(1, timeout=_TELL_AFTER_S)
        return
    except TimeoutError:
        _log.info("waiting for a worker of %s", where)
    try:
        client.wait_for_workers(1, timeout=WORKERS_WITHIN_S - _TELL_AFTER_S)
    except TimeoutError as error:
        expected = f"expected a worker within {WORKERS_WITHIN_S:g} s, none came"
        raise InputError(where, "workers", expected) from error


@contextmanager
def _quiet() -> Iterator[None]:
    """Within the block the libraries of the cluster keep to themselves what they log.

    Whatever matters comes back as a result or an exception, and is said in a line of ours.
    """
    loggers = [logging.getLogger(name) for name in ("distributed", "tornado", "asyncio")]
    before = [logger.level for logger in loggers]
    for logger in loggers:
        logger.setLevel(logging.CRITICAL + 1)
    try:
        yield
    finally:
        for logger, level in zip(loggers, before, strict=True):
            logger.setLevel(level)


@contextmanager
def _interrupts_kept_from_threads() -> Iterator[None]:
    """Threads started within, and their processes, never see the interrupt key.

    The terminal interrupts every process; the first thread of this one tells the others. One that
    comes within the block is delivered at its end.
    """
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    # Whichever thread starts it first has its interrupts let through again, and so have the
    # processes that this thread starts.
    resource_tracker.ensure_running()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
