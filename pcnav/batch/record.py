"""What is kept of one run: a Parquet file of its own, written whole or not at all.

One row is one frame. Everything else (the case, the seed, values of the run as a whole, the
failure, versions, the command that repeats the run) is JSON under one key of the file's schema, so
that any reader of Parquet sees the frames and this module sees all of it.
"""

import json
import math
import os
import secrets
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, BinaryIO, Literal

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from pydantic import BaseModel, ConfigDict, Field, Strict, ValidationError

from pcnav.batch.axes import GridRun, grid_case
from pcnav.batch.monte_carlo import Case, Run
from pcnav.core.arrays import FloatArray
from pcnav.core.errors import InputError
from pcnav.files.regular_file import require_regular

FORMAT = 2
"""Number of the layout described here; a file with another one is refused."""
SUFFIX = ".parquet"
UNFINISHED_SUFFIX = ".part"

_KEY = b"pcnav"
_TIME = "time_s"

_STATUS = "status"
"""The one column of words."""
_MAX_BYTES = 500_000_000

Column = FloatArray | list[str]
"""One value a frame."""


class _Format(BaseModel):
    """What every version of the layout has."""

    format: int


class _About(_Format):
    """The JSON of a record."""

    model_config = ConfigDict(strict=True)

    case: str
    axes: Annotated[tuple[tuple[str, str | bool | int | float], ...], Strict(False)]
    index: Annotated[int, Field(ge=0, lt=2**31)]
    seed: Annotated[int, Field(ge=0, lt=2**128)]
    values: dict[str, float | Literal["nan", "inf", "-inf"]]
    failure: str | None
    versions: dict[str, str]
    command: str


@dataclass(frozen=True)
class RunRecord:
    """All that is kept of one run."""

    run: GridRun
    columns: Mapping[str, Column]
    """Values frame by frame, all of one length, by name; the unit ends the name."""
    values: Mapping[str, float]
    """Values of the run as a whole; nan where there is none."""
    failure: str | None
    """Why the run has no result, in one line; such a run has no columns."""
    versions: Mapping[str, str]
    """Of pcnav and the libraries that made the numbers."""
    command: str
    """What repeats this run alone."""

    @property
    def frames(self) -> int:
        """Number of rows."""
        return len(next(iter(self.columns.values()), ()))

    def numbers(self, name: str) -> FloatArray:
        """(n,) a column of numbers; nan where there is none of that name."""
        found = self.columns.get(name)
        return found if isinstance(found, np.ndarray) else np.full(self.frames, np.nan)


def write_record(folder: Path, record: RunRecord, mark: str = "") -> Path:
    """Write a record into a folder under its run's key; returns the file, an earlier one replaced.

    ``mark`` is that of `write_whole`. Raises ``ValueError`` for columns that differ in length and
    ``OSError`` when the file system refuses; nothing is then left.
    """
    path, table = folder / (record.run.key + SUFFIX), _table(record)
    write_whole(path, lambda file: pq.write_table(table, file, compression="zstd"), mark)
    return path


def write_whole(path: Path, write: Callable[[BinaryIO], object], mark: str = "") -> None:
    """Write a file that appears under its name when all of it is on the disk.

    Whoever finds it may trust it. ``mark`` is in the name that the file has until then: whoever
    ends the process in the middle finds by it what to remove. Raises ``OSError``, which names the
    file; nothing is then left.
    """
    ending = f"{mark}{secrets.token_hex(4)}{UNFINISHED_SUFFIX}"
    unfinished = path.with_name(f".{path.stem}-{ending}")
    try:
        with unfinished.open("wb") as file:
            write(file)
            file.flush()
            os.fsync(file.fileno())
        unfinished.replace(path)
        _sync_folder(path.parent)
    except OSError as error:
        # What the libraries in between raise does not always name the file.
        raise OSError(error.errno, error.strerror or str(error), str(path)) from error
    finally:
        # There is none after a successful move.
        unfinished.unlink(missing_ok=True)


def write_text_whole(path: Path, text: str) -> None:
    """`write_whole` of a text."""
    write_whole(path, lambda file: file.write(text.encode()))


def read_record(path: Path) -> RunRecord:
    """Read a record. Raises `InputError` when the file is not one, or one of another format."""
    table = _read(path, pq.read_table)
    found = _without_frames(path, table.schema.metadata)
    if found.failure is not None:
        return found
    columns = {name: _column(path, name, table.column(name)) for name in table.column_names}
    return replace(found, columns=columns)


def read_header(path: Path) -> RunRecord:
    """A record without its frames, its columns empty: quick. Raises `InputError` as `read_record`
    does."""
    schema = _read(path, pq.read_schema)
    found = _without_frames(path, schema.metadata)
    names = () if found.failure is not None else schema.names
    return replace(found, columns=dict.fromkeys(names, np.empty(0)))


def _read(path: Path, read: Callable[[Path], Any]) -> Any:
    require_regular(path, _MAX_BYTES)
    try:
        return read(path)
    except (pa.ArrowException, OSError) as error:
        raise _not_a_record(path, str(error)) from error


def _table(record: RunRecord) -> pa.Table:
    lengths = {name: len(column) for name, column in record.columns.items()}
    if len(set(lengths.values())) > 1:
        raise ValueError(f"columns of a record differ in length: {lengths}")
    run = record.run
    about: dict[str, object] = {
        "format": FORMAT,
        "key": run.key,
        "case": run.case.name,
        "axes": run.case.settings,
        "index": run.index,
        "seed": run.seed,
        "values": {name: _json_number(value) for name, value in record.values.items()},
        "failure": record.failure,
        "versions": dict(record.versions),
        "command": record.command,
    }
    text = json.dumps(about, allow_nan=False)
    arrays = {name: _array(column) for name, column in record.columns.items()}
    # Some readers refuse a file without a column: that of a failure has one without rows.
    arrays = arrays or {_TIME: _array(np.empty(0))}
    return pa.table(arrays).replace_schema_metadata({_KEY: text.encode()})


def _array(column: Column) -> pa.Array:
    if isinstance(column, list):
        return pa.array(column, pa.string())
    return pa.array(np.ascontiguousarray(column, dtype=np.float64), pa.float64())


def _column(path: Path, name: str, stored: pa.ChunkedArray) -> Column:
    expected = pa.string() if name == _STATUS else pa.float64()
    if stored.type != expected or stored.null_count:
        got = f"got {stored.type} and {stored.null_count} empty"
        raise InputError(path, name, f"expected a value of the type {expected} a frame, {got}")
    if name == _STATUS:
        return [str(text) for text in stored.to_pylist()]
    return np.asarray(stored.to_numpy(), dtype=np.float64)


def _without_frames(path: Path, metadata: Mapping[bytes, bytes] | None) -> RunRecord:
    """What the JSON of a file says, which must be of this format."""
    text = (metadata or {}).get(_KEY)
    if text is None:
        raise _not_a_record(path, "a Parquet file without the values of a run")
    try:
        found = _Format.model_validate_json(text).format
    except ValidationError as error:
        raise _not_a_record(path, "its values of the run cannot be read") from error
    if found != FORMAT:
        raise InputError(path, "format", f"expected {FORMAT}, found {found}")
    try:
        about = _About.model_validate_json(text)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        field = ".".join(map(str, first["loc"]))
        raise InputError(path, field, f"expected that of a run ({first['msg']})") from error
    # The name of the file is told by that of the case, and so are the values of its axes.
    if grid_case(about.axes).name != about.case:
        raise InputError(path, "axes", "expected those that the name of the case tells")
    return RunRecord(
        run=Run(Case(about.case, about.axes), about.index, about.seed),
        columns={},
        values={name: float(value) for name, value in about.values.items()},
        failure=about.failure,
        versions=about.versions,
        command=about.command,
    )


def _not_a_record(path: Path, reason: str) -> InputError:
    return InputError(path, "file", f"expected the record of a run ({reason})")


def _json_number(value: float) -> float | str:
    """JSON has no words for what is not finite: these are texts, which ``float`` reads back."""
    return float(value) if math.isfinite(value) else str(float(value))


def _sync_folder(folder: Path) -> None:
    """Make the new name last through a loss of power, where folders can be opened for that."""
    if not hasattr(os, "O_DIRECTORY"):
        return
    handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
