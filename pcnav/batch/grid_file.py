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

from pcnav.batch.axes import (
    AXES,
    ESTIMATOR_AXIS,
    AxisValue,
    GridCase,
    grid_case,
    named_axis,
)
from pcnav.config.table import Positive, Table
from pcnav.core.errors import InputError
from pcnav.files.toml_file import checked, read_toml

BATCH_TABLE = "batch"
"""The table that a grid file has and a pipeline file has not."""

_Axes = dict[str, Any]
"""Axis to list of values, or to a value in [base]; checked in `cases_of`, which names the block.
A path may be quoted, ``"features.count"``, or not."""


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
    found = read_toml(path)
    if BATCH_TABLE not in found:
        expected = "expected a grid of cases with this table; a pipeline is for `pcnav run`"
        raise InputError(path, BATCH_TABLE, expected)
    return checked(path, GridFile, found)


def cases_of(file: GridFile, path: Path) -> tuple[GridCase, ...]:
    """Every case of a grid file, block after block, the last axis of a cross varying fastest.

    All have the same axes. Raises `InputError`, naming ``path``, for an axis that is unknown,
    empty, given twice, or missing in a block; for a value that it cannot have; and for a case
    given twice.
    """
    base = {axis: _value(path, "base", axis, v) for axis, v in _flat(file.base).items()}
    blocks = [_rows(path, f"grid.{k}", block) for k, block in enumerate(file.grid, 1)]
    used = dict.fromkeys([ESTIMATOR_AXIS, *base, *(axis for rows in blocks for axis in rows[0])])
    order = [*(axis for axis in AXES if axis in used), *(axis for axis in used if axis not in AXES)]
    found: dict[str, int] = {}
    cases = []
    for k, rows in enumerate(blocks, 1):
        for row in rows:
            values = base | row
            missing = [axis for axis in order if axis not in values]
            if missing:
                expected = "expected this axis in the block or in [base], as every case has it"
                raise InputError(path, f"grid.{k}.{missing[0]}", expected)
            case = grid_case((axis, values[axis]) for axis in order)
            if case.name in found:
                before = f"is in grid.{found[case.name]} too"
                raise InputError(path, f"grid.{k}", f"expected no case twice: {case} {before}")
            found[case.name] = k
            cases.append(case)
    return tuple(cases)


def _rows(path: Path, field: str, block: BlockTable) -> list[dict[str, AxisValue]]:
    """The values of each case of a block, those of [base] apart."""
    crossed, zipped = (
        {axis: _list(path, f"{field}.{how}", axis, values) for axis, values in _flat(axes).items()}
        for how, axes in (("cross", block.cross), ("zip", block.zip))
    )
    if not crossed and not zipped:
        raise InputError(path, field, "expected an axis in cross or zip")
    both = sorted(set(crossed) & set(zipped))
    if both:
        raise InputError(path, f"{field}.zip.{both[0]}", "expected an axis once, cross has it too")
    if len(set(map(len, zipped.values()))) > 1:
        lengths = ", ".join(f"{axis} has {len(values)}" for axis, values in zipped.items())
        raise InputError(path, f"{field}.zip", f"expected lists of one length, {lengths}")
    return list(_combined(crossed, zipped))


def _combined(
    crossed: dict[str, list[AxisValue]], zipped: dict[str, list[AxisValue]]
) -> Iterator[dict[str, AxisValue]]:
    for together in zip(*zipped.values(), strict=True) if zipped else [()]:
        for apart in itertools.product(*crossed.values()):
            yield dict(zip((*zipped, *crossed), (*together, *apart), strict=True))


def _flat(axes: _Axes) -> _Axes:
    """With the paths of keys that TOML reads as tables within tables, written without quotes."""
    found: _Axes = {}
    for axis, value in axes.items():
        deeper = _flat(value) if isinstance(value, dict) else {"": value}
        found |= {f"{axis}.{key}".rstrip("."): each for key, each in deeper.items()}
    return found


def _list(path: Path, field: str, axis: str, values: object) -> list[AxisValue]:
    if not isinstance(values, list) or not values:
        got = "an empty one" if values == [] else repr(values)
        raise InputError(path, f"{field}.{axis}", f"expected a list of values, got {got}")
    return [_value(path, field, axis, value) for value in values]


def _value(path: Path, field: str, axis: str, value: object) -> AxisValue:
    try:
        return named_axis(axis).value_of(value)
    except ValueError as error:
        raise InputError(path, f"{field}.{axis}", str(error)) from error
