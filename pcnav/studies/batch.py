"""Many independent runs over processes: results in order, each run repeatable alone."""

import multiprocessing
import os
import signal
import traceback
import zlib
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from typing import TypeVar

import numpy as np

Item = TypeVar("Item")
Result = TypeVar("Result")

_THREAD_VARIABLES = (
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "VECLIB_MAXIMUM_THREADS",
)
_MOST_JOBS = 8
"""A process holds the libraries and a satellite, some 400 MB: more are not started unasked."""


class RunError(RuntimeError):
    """A run that failed; the message names it."""


@dataclass(frozen=True)
class Run:
    """One run of a case: what it is called and the seed that repeats it."""

    case: str
    index: int
    seed: int

    def __str__(self) -> str:
        return f"{self.case}, run {self.index} (seed {self.seed})"


def run_seed(name: str, index: int) -> int:
    """Seed of a run, from its name and index alone: the same on every machine."""
    sequence = np.random.SeedSequence(zlib.crc32(name.encode()), spawn_key=(index,))
    return int(sequence.generate_state(1)[0])


def runs_of(name: str, cases: Sequence[str], count: int) -> list[Run]:
    """So many runs of every case, case after case.

    The seeds depend on the name and the index: all cases meet the same truths, so that they can
    be compared.
    """
    seeds = [run_seed(name, index) for index in range(count)]
    return [Run(case, index, seed) for case in cases for index, seed in enumerate(seeds)]


def usable_cores() -> int:
    """Cores this process may run on."""
    try:
        return len(os.sched_getaffinity(0))
    except AttributeError:  # macOS and Windows do not say
        return os.cpu_count() or 1


def run_all(
    function: Callable[[Item], Result],
    items: Sequence[Item],
    jobs: int | None = None,
    on_done: Callable[[], None] = lambda: None,
) -> list[Result]:
    """``function`` of every item, in the order of the items.

    Args:
        function: defined at the top of a module, so that another process can find it.
        items: what it is called with; ``str(item)`` names a run that fails.
        jobs: processes; None takes one per core, 1 stays in this process.
        on_done: told in this process after every run.

    The processes are started afresh, not forked: a fork copies the locks of whatever threads the
    libraries keep. Each does its linear algebra on one thread. Raises `RunError` when a run
    fails; those not begun by then are dropped.
    """
    jobs = min(usable_cores(), _MOST_JOBS) if jobs is None else jobs
    jobs = min(jobs, len(items))
    if jobs <= 1:
        return [_checked(_attempt(function, item), item, on_done) for item in items]
    found: dict[int, Result] = {}
    with _one_thread_each(), _pool(jobs) as pool:
        attempt = partial(_attempt, function)
        futures = {pool.submit(attempt, item): k for k, item in enumerate(items)}
        for future in as_completed(futures):
            k = futures[future]
            try:
                result = future.result()
            except BrokenProcessPool as error:
                raise RunError(f"{items[k]}: its process ended abruptly") from error
            found[k] = _checked(result, items[k], on_done)
    return [found[k] for k in range(len(items))]


@dataclass(frozen=True)
class _Failure:
    """What a run raised, as text: not every exception survives the way between processes."""

    summary: str
    details: str


def _attempt(function: Callable[[Item], Result], item: Item) -> Result | _Failure:
    try:
        return function(item)
    except Exception as error:
        return _Failure(f"{type(error).__name__}: {error}", traceback.format_exc())


def _checked(result: Result | _Failure, item: object, on_done: Callable[[], None]) -> Result:
    if isinstance(result, _Failure):
        failed = RunError(f"{item}: {result.summary}")
        failed.add_note(result.details)
        raise failed
    on_done()
    return result


@contextmanager
def _pool(jobs: int) -> Iterator[ProcessPoolExecutor]:
    """Processes that a failure or an interrupt leaves no work to."""
    context = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(jobs, mp_context=context, initializer=_ignore_interrupts)
    try:
        yield pool
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


def _ignore_interrupts() -> None:
    # The terminal interrupts every process; the first one tells the others.
    signal.signal(signal.SIGINT, signal.SIG_IGN)


@contextmanager
def _one_thread_each() -> Iterator[None]:
    """Processes started within keep their linear algebra on one thread.

    The libraries read these variables as they are loaded, so they must be set before.
    """
    before = {name: os.environ.get(name) for name in _THREAD_VARIABLES}
    os.environ.update(dict.fromkeys(_THREAD_VARIABLES, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value
