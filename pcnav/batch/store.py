"""The folder of a batch: what was asked for, and the record of every run that is finished.

    OUT/grid.toml            the grid as run
    OUT/batch.json           format, version of pcnav, the runs in the order of the grid
    OUT/runs/<key>.parquet   one record a run; there is no half-written one under such a name

A batch that was interrupted goes on where its folder ends.
"""

import json
import secrets
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field, ValidationError

import pcnav
from pcnav.batch.attempt import Failure, attempt
from pcnav.batch.axes import GridRun
from pcnav.batch.cluster import Workers
from pcnav.batch.engine import outcomes
from pcnav.batch.record import (
    FORMAT,
    SUFFIX,
    UNFINISHED_SUFFIX,
    RunRecord,
    read_header,
    read_record,
    write_record,
    write_text_whole,
)
from pcnav.batch.worker_check import here
from pcnav.core.errors import InputError
from pcnav.files.regular_file import read_bytes
from pcnav.runs.provenance import library_versions_with_peers

GRID_FILE, BATCH_FILE, RUNS_FOLDER = "grid.toml", "batch.json", "runs"

_ABANDONED_AFTER_S = 60.0
"""Writing a record takes far less: what is older was left by a process that ended."""


_MAX_BYTES = 50_000_000
"""Of what tells of all runs: some 500,000 of them."""


class _Format(BaseModel):
    """What every version of the layout has."""

    format: int


class _About(_Format):
    """The content of batch.json."""

    model_config = ConfigDict(strict=True)

    pcnav: str
    identity: str
    # Names of files are made of them.
    runs: list[Annotated[str, Field(pattern=r"^[a-z0-9.-]{1,200}$")]]


@dataclass(frozen=True)
class RunStore:
    """The folder of a batch, opened. Made by `new_store` and `open_store`."""

    folder: Path
    """Absolute: processes elsewhere may have another working folder."""
    grid_toml: str
    version: str
    """Of pcnav, which made all records."""
    keys: tuple[str, ...]
    """`Run.key` of every run, in the order of the grid."""
    identity: str = field(compare=False)
    """Drawn when the folder was made: differs from that of the same name on another machine."""

    @property
    def runs_folder(self) -> Path:
        """Where the records are."""
        return self.folder / RUNS_FOLDER

    def path(self, key: str) -> Path:
        """The file of a run, there or not."""
        return self.runs_folder / (key + SUFFIX)

    def finished(self, run: GridRun) -> bool:
        """Whether the run has its record, be it of a failure."""
        return self.path(run.key).is_file()

    @property
    def missing(self) -> tuple[str, ...]:
        """The keys of the runs without a record, in the order of the grid."""
        there = {path.name for path in self.runs_folder.glob(f"*{SUFFIX}")}
        return tuple(key for key in self.keys if key + SUFFIX not in there)

    def record(self, key: str) -> RunRecord:
        """One record. Raises `InputError` where there is none, or not one of this batch."""
        path = self.path(key)
        if not path.is_file():
            raise InputError(path, "file", "expected the record of a run, there is none yet")
        return self._own(path, read_record(path))

    def headers(self) -> Iterator[RunRecord]:
        """The records there are, in the order of the grid, without their frames: quick.

        Raises `InputError` for a file that is not a record, or one of another version of pcnav.
        """
        for path in map(self.path, self.keys):
            if path.is_file():
                yield self._own(path, read_header(path))

    def discard_unused(self) -> None:
        """Remove the folder as `new_store` made it; one that holds anything else stays."""
        with suppress(OSError):
            self.runs_folder.rmdir()
            for name in (GRID_FILE, BATCH_FILE):
                (self.folder / name).unlink()
            self.folder.rmdir()

    def _own(self, path: Path, record: RunRecord) -> RunRecord:
        version, key = record.versions.get("pcnav"), record.run.key
        if version != self.version:
            expected = f"expected {self.version} as in all of this batch, found {version}"
            raise InputError(path, "version of pcnav", expected)
        if key + SUFFIX != path.name:
            raise InputError(path, "run", f"expected that of the file's name, found {key}")
        return record


def new_store(folder: Path, grid_toml: str, runs: Sequence[GridRun]) -> RunStore:
    """Make the folder of a batch, or open that of the same batch to go on with it.

    Raises `InputError` when the folder holds something else, another grid or records of another
    version of pcnav, and when it cannot be written; what was there stays.
    """
    keys, identity = tuple(run.key for run in runs), secrets.token_hex(8)
    store = RunStore(folder.resolve(), grid_toml, pcnav.__version__, keys, identity)
    if len(set(store.keys)) < len(store.keys):
        raise InputError(folder, "runs", "expected every run once")
    earlier = _earlier(store)
    if earlier is None:
        _write_anew(store, folder)
    elif earlier.version != store.version:
        expected = f"expected {store.version} as now, found {earlier.version}"
        raise InputError(folder / BATCH_FILE, "version of pcnav", expected)
    elif earlier != store:
        expected = "expected the grid of this batch: the folder holds runs of another one"
        raise InputError(folder / GRID_FILE, "grid", expected)
    _remove_unfinished(store.runs_folder)
    return store if earlier is None else earlier


def open_store(folder: Path) -> RunStore:
    """Open the folder of a batch to read it, whatever version made it.

    Raises `InputError` when it is not such a folder, or of another format.
    """
    path = folder / BATCH_FILE
    for name in (BATCH_FILE, GRID_FILE):
        if not (folder / name).exists():
            raise InputError(folder, "folder", f"expected that of a batch, with {name}")
    text = read_bytes(path, _MAX_BYTES)
    try:
        found = _Format.model_validate_json(text).format
        if found != FORMAT:
            raise InputError(path, "format", f"expected {FORMAT}, found {found}")
        about = _About.model_validate_json(text)
        grid_toml = read_bytes(folder / GRID_FILE, _MAX_BYTES).decode("utf-8")
    except InputError:
        raise
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        field = ".".join(map(str, first["loc"])) or "file"
        expected = f"expected what a batch was made of ({first['msg']})"
        raise InputError(path, field, expected) from error
    except ValueError as error:
        raise InputError(folder / GRID_FILE, "file", "expected a text file") from error
    return RunStore(folder.resolve(), grid_toml, about.pcnav, tuple(about.runs), about.identity)


def _earlier(store: RunStore) -> RunStore | None:
    """The batch that the folder holds already, if any."""
    folder = store.folder
    if folder.exists() and not folder.is_dir():
        raise InputError(folder, "folder", "expected a folder, this is a file")
    if (folder / BATCH_FILE).exists():
        earlier = open_store(folder)
        _refuse_other_libraries(earlier)
        return earlier
    # A batch that ended before its first file may have left these.
    ours = {GRID_FILE, RUNS_FOLDER, *(path.name for path in folder.glob(f".*{UNFINISHED_SUFFIX}"))}
    foreign = [path.name for path in folder.glob("*") if path.name not in ours]
    if foreign:
        expected = f"expected an empty or new folder or one of a batch, this has {min(foreign)}"
        raise InputError(folder, "folder", expected)
    return None


def _refuse_other_libraries(store: RunStore) -> None:
    """Runs made from now on must not differ from the earlier ones by a library's version."""
    now = library_versions_with_peers()
    for header in store.headers():
        for name, theirs in header.versions.items():
            if now.get(name, theirs) != theirs and store.version == now["pcnav"]:
                expected = f"expected {now[name]} as now, found {theirs}"
                raise InputError(store.path(header.run.key), f"version of {name}", expected)


def _write_anew(store: RunStore, shown: Path) -> None:
    about = {
        "format": FORMAT,
        "pcnav": store.version,
        "identity": store.identity,
        "runs": store.keys,
    }
    text = json.dumps(about, indent=1) + "\n"
    try:
        store.runs_folder.mkdir(parents=True, exist_ok=True)
        write_text_whole(store.folder / GRID_FILE, store.grid_toml)
        # Last: a folder with this file has all it needs.
        write_text_whole(store.folder / BATCH_FILE, text)
    except OSError as error:
        expected = f"expected a place that can be written ({error.strerror})"
        raise InputError(shown, "folder", expected) from error


def _remove_unfinished(folder: Path) -> None:
    """Remove what processes that ended in the middle of a record left."""
    for path in folder.glob(f".*{UNFINISHED_SUFFIX}"):
        # Another process may be writing or removing it.
        with suppress(OSError):
            if time.time() - path.stat().st_mtime > _ABANDONED_AFTER_S:
                path.unlink()


OnBatchProgress = Callable[[int, int, int], None]
"""Called with how many runs are done, of how many, and how many of those done failed."""


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
        command: what repeats a run alone, for the record of a failure; to be found likewise.
        on_progress: called in this process at the beginning and after every run.

    May be interrupted at any time and called again: finished runs are not repeated. Raises
    ``OSError`` when a record cannot be written, and `InputError` when a cluster cannot be used.
    """
    missing = [run for run in runs if not store.finished(run)]
    done = len(runs) - len(missing)
    earlier = {header.run for header in store.headers() if header.failure is not None}
    failed = len(earlier.intersection(runs))
    on_progress(done, len(runs), failed)
    requirements = here(store.folder / BATCH_FILE, store.identity)
    recording = _Recording(function, command, store.runs_folder)
    try:
        with closing(outcomes(recording, missing, workers, requirements)) as ended:
            for k, outcome in ended:
                answer = outcome
                if isinstance(answer, Failure):
                    # Its processes ended, so that none of them could say so.
                    answer = recording.failure(missing[k], answer)
                if isinstance(answer, OSError):
                    raise answer
                done, failed = done + 1, failed + answer
                on_progress(done, len(runs), failed)
    finally:
        # The workers of a cluster go on with what they have begun.
        if workers.scheduler is None:
            recording.remove_unfinished()


@dataclass(frozen=True)
class _Recording:
    """Runs and leaves the record in the folder; called in whatever process has the run.

    Nothing goes back over the network but whether it failed, or why it cannot be recorded.
    """

    function: Callable[[GridRun], RunRecord]
    command: Callable[[GridRun], str]
    folder: Path
    mark: str = field(default_factory=lambda: secrets.token_hex(4))
    """In the names of the unfinished files of this batch, and of no other's in the folder."""

    def __call__(self, run: GridRun) -> bool | OSError:
        path = self.folder / (run.key + SUFFIX)
        if path.is_file():
            # A worker may end after the record and before its answer, and the run comes back.
            return read_header(path).failure is not None
        record = attempt(self.function, run)
        return self.failure(run, record) if isinstance(record, Failure) else self._write(record)

    def failure(self, run: GridRun, why: Failure) -> bool | OSError:
        """Leave the record of a failure."""
        versions, command = library_versions_with_peers(), self.command(run)
        return self._write(RunRecord(run, {}, {}, why.summary, versions, command))

    def _write(self, record: RunRecord) -> bool | OSError:
        try:
            write_record(self.folder, record, self.mark)
        except OSError as error:
            return error
        return record.failure is not None

    def remove_unfinished(self) -> None:
        """Remove what processes that were ended in the middle of a record left."""
        for path in self.folder.glob(f".*-{self.mark}*{UNFINISHED_SUFFIX}"):
            with suppress(OSError):
                path.unlink()
