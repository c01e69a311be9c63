"""The grid file: which cases a batch has, how many runs of each, and what they are based on.

    [batch]                     name, runs of every case, seed, frames or duration_s, pipeline
    [base]                      values of the axes that a block does not name
    [[grid]]                    one block of cases; there may be several
    cross = { axis = [...] }    every value with every value of the others
    zip = { axis = [...] }      first with first, second with second; lists of one length

A block with both takes every row of the zip with every combination of the cross.
"""

import itertools
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, Self

from pydantic import Field, model_validator

from pcnav.batch.axes import AXES
from pcnav.batch.case import ESTIMATOR_AXIS, AxisValue, Case
from pcnav.config.table import Positive, Table
from pcnav.core.errors import InputError
from pcnav.files.toml_file import read_toml, read_toml_model

BATCH_TABLE = "batch"
"""The table that tells a grid file from a pipeline file."""

_Axes = dict[str, Any]
"""Axis to list of values, or to a value in [base]; checked in `cases_of`, which names the block."""
_Values = tuple[tuple[str, AxisValue], ...]


class BatchTable(Table):
    """[batch]: what holds for all cases."""

    name: Annotated[str, Field(min_length=1)]
    runs: Annotated[int, Field(ge=1)]
    """Monte Carlo runs of every case."""
    seed: Annotated[int, Field(ge=0)] = 0
    pipeline: str | None = None
    """Pipeline file, relative to the grid file, or name of a shipped one: camera, noise, orbit and
    settings of every case. None takes the one shipped with each case's satellite."""
    frames: Annotated[int, Field(ge=2)] | None = None
    """Of every run."""
    duration_s: Positive | None = None
    """Of every run, instead of frames."""

    @model_validator(mode="after")
    def _length_is_stated_once(self) -> Self:
        if (self.frames is None) == (self.duration_s is None):
            raise ValueError("expected frames or duration_s, one of them")
        return self


class BlockTable(Table):
    """[[grid]]: the cases of one block."""

    cross: _Axes = Field(default_factory=dict)
    zip: _Axes = Field(default_factory=dict)


class AsRunTable(Table):
    """[as_run]: what a grid stood on when it was run; written by pcnav."""

    folder: str | None = None
    """That paths in the grid are relative to, where it has any; None takes that of the file."""
    pipelines_sha256: dict[str, str] = Field(default_factory=dict)
    meshes_sha256: dict[str, str] = Field(default_factory=dict)


class GridFile(Table):
    """A whole grid file."""

    batch: BatchTable
    base: _Axes = Field(default_factory=dict)
    grid: Annotated[tuple[BlockTable, ...], Field(min_length=1)]
    as_run: AsRunTable = AsRunTable()


def read_grid_file(path: Path) -> GridFile:
    """Read and check a grid file but for its axes. Raises `InputError`."""
    try:
        missing = BATCH_TABLE not in read_toml(path)
    except InputError:
        missing = False  # said in full by what reads it next
    if missing:
        expected = "expected a grid of cases with this table; a pipeline is for `pcnav run`"
        raise InputError(path, BATCH_TABLE, expected)
    return read_toml_model(path, GridFile)


def cases_of(file: GridFile, path: Path) -> tuple[Case, ...]:
    """Every case of a grid file, block after block, the last axis of a cross varying fastest.

    All have the same axes. Raises `InputError`, naming ``path``, for an axis that is unknown,
    empty, given twice, or missing in a block; for a value that it cannot have; and for a case
    given twice.
    """
    base = {axis: _value(path, "base", axis, value) for axis, value in file.base.items()}
    blocks = [_block(path, f"grid.{k + 1}", block) for k, block in enumerate(file.grid)]
    used = set(base).union(*(axes for axes, _ in blocks), {ESTIMATOR_AXIS})
    found: dict[str, int] = {}
    cases = []
    for k, (axes, rows) in enumerate(blocks):
        for axis in AXES:
            if axis in used and axis not in base and axis not in axes:
                expected = "expected this axis in the block or in [base], as every case has it"
                raise InputError(path, f"grid.{k + 1}.{axis}", expected)
        for row in rows:
            values = base | dict(row)
            case = Case(tuple((axis, values[axis]) for axis in AXES if axis in used))
            if case.name in found:
                before = f"is in grid.{found[case.name]} too"
                raise InputError(path, f"grid.{k + 1}", f"expected no case twice: {case} {before}")
            found[case.name] = k + 1
            cases.append(case)
    return tuple(cases)


def _block(path: Path, field: str, block: BlockTable) -> tuple[set[str], list[_Values]]:
    """The axes of a block and its rows of values."""
    crossed = {axis: _list(path, f"{field}.cross", axis, v) for axis, v in block.cross.items()}
    zipped = {axis: _list(path, f"{field}.zip", axis, v) for axis, v in block.zip.items()}
    if not crossed and not zipped:
        raise InputError(path, field, "expected an axis in cross or zip")
    both = sorted(set(crossed) & set(zipped))
    if both:
        raise InputError(path, f"{field}.zip.{both[0]}", "expected an axis once, cross has it too")
    lengths = {axis: len(values) for axis, values in zipped.items()}
    if len(set(lengths.values())) > 1:
        told = ", ".join(f"{axis} has {n}" for axis, n in lengths.items())
        raise InputError(path, f"{field}.zip", f"expected lists of one length, {told}")
    return set(crossed) | set(zipped), list(_rows(crossed, zipped))


def _rows(
    crossed: dict[str, list[AxisValue]], zipped: dict[str, list[AxisValue]]
) -> Iterator[_Values]:
    pairs = list(zip(*zipped.values(), strict=True)) or [()]
    for together in pairs:
        for apart in itertools.product(*crossed.values()):
            yield (
                *zip(zipped, together, strict=True),
                *zip(crossed, apart, strict=True),
            )


def _list(path: Path, field: str, axis: str, values: object) -> list[AxisValue]:
    _known(path, field, axis)
    if not isinstance(values, list) or not values:
        got = "an empty one" if values == [] else repr(values)
        raise InputError(path, f"{field}.{axis}", f"expected a list of values, got {got}")
    return [_value(path, field, axis, value) for value in values]


def _value(path: Path, field: str, axis: str, value: object) -> AxisValue:
    _known(path, field, axis)
    checked = AXES[axis].value_of(value)
    if checked is None:
        expected = f"expected {AXES[axis].expected}, got {value!r}"
        raise InputError(path, f"{field}.{axis}", expected)
    return checked


def _known(path: Path, field: str, axis: str) -> None:
    if axis not in AXES:
        expected = f"unknown axis; expected one of {', '.join(AXES)}"
        raise InputError(path, f"{field}.{axis}", expected)
