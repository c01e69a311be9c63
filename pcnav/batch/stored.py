"""Runs whose records go to the folder of a batch as they end, written by whoever ran them."""

from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

from pcnav.batch.axes import GridRun
from pcnav.batch.cluster import Workers
from pcnav.batch.engine import Failure, attempt, outcomes
from pcnav.batch.record import SUFFIX, RunRecord, read_header, write_record
from pcnav.batch.store import BATCH_FILE, RunStore
from pcnav.batch.worker_check import here
from pcnav.runs.provenance import library_versions_with_peers

OnBatchProgress = Callable[[int, int, int], None]
"""Told how many runs are done, of how many, and how many of those done failed."""


@dataclass(frozen=True)
class _Task:
    """One run, and what repeats it."""

    run: GridRun
    command: str

    def __str__(self) -> str:
        return str(self.run)


@dataclass(frozen=True)
class _Refused:
    """A record that the file system did not take: the arguments of an ``OSError``."""

    number: int | None
    reason: str
    file: str


@dataclass(frozen=True)
class _Recorded:
    """A record that is in the folder. Nothing else goes back over the network."""

    failed: bool


def run_stored(
    function: Callable[[GridRun], RunRecord],
    runs: Sequence[GridRun],
    store: RunStore,
    workers: Workers,
    command: Callable[[GridRun], str],
    on_progress: OnBatchProgress = lambda done, total, failed: None,
) -> None:
    """Run what has no record yet; afterwards every run has one, be it of a failure.

    Args:
        function: defined at the top of a module or made of such a class, so that another process
            can find it. What it raises goes into the record of a failure.
        runs: some or all of the store's.
        store: the folder of the batch, to be seen by every worker.
        workers: what to spread over.
        command: what repeats a run alone, for the record of a failure.
        on_progress: told in this process at the beginning and after every run.

    May be interrupted at any time and called again: finished runs are not repeated. Raises
    ``OSError`` when a record cannot be written, and `InputError` when a cluster cannot be used.
    """
    tasks = [_Task(run, command(run)) for run in runs if not store.finished(run)]
    done = len(runs) - len(tasks)
    earlier = {header.run for header in store.headers() if header.failure is not None}
    failed = len(earlier.intersection(runs))
    on_progress(done, len(runs), failed)
    requirements = here(store.folder / BATCH_FILE, store.identity)
    recording = _Recording(function, store.runs_folder)
    with closing(outcomes(recording, tasks, workers, requirements)) as ended:
        for k, outcome in ended:
            answer = outcome
            if isinstance(answer, Failure):
                # Its processes ended, so that none of them could say so.
                answer = recording.write(_failed(tasks[k], answer))
            if isinstance(answer, _Refused):
                raise OSError(answer.number, answer.reason, answer.file)
            done, failed = done + 1, failed + answer.failed
            on_progress(done, len(runs), failed)


@dataclass(frozen=True)
class _Recording:
    """Runs and leaves the record in the folder; called in whatever process has the task."""

    function: Callable[[GridRun], RunRecord]
    folder: Path

    def __call__(self, task: _Task) -> _Recorded | _Refused:
        path = self.folder / (task.run.key + SUFFIX)
        if path.is_file():
            # A worker may end after the record and before its answer, and the task comes back.
            return _Recorded(read_header(path).failure is not None)
        record = attempt(self.function, task.run)
        if isinstance(record, Failure):
            record = _failed(task, record)
        return self.write(record)

    def write(self, record: RunRecord) -> _Recorded | _Refused:
        try:
            write_record(self.folder, record)
        except OSError as error:
            file = error.filename or self.folder
            return _Refused(error.errno, error.strerror or str(error), str(file))
        return _Recorded(record.failure is not None)


def _failed(task: _Task, failure: Failure) -> RunRecord:
    return RunRecord(task.run, {}, {}, failure.summary, library_versions_with_peers(), task.command)
