"""What is not recorded: wall times, memory, versions and paths, which differ from run to run."""

from collections.abc import Mapping
from fnmatch import fnmatchcase
from pathlib import Path

FILES: Mapping[str, str] = {
    "result/pipeline.toml": "holds versions and paths of this machine",
    "attitudes/pipeline.toml": "holds versions and paths of this machine",
    "*/grid.toml": "holds digests of files that the tables do not depend on",
    "*/batch.json": "holds versions, and digests as above",
    "pivot/statistics.csv": "repeats that of the batch",
}
"""By pattern of output/file.

Pages, figures and copies of the tables in other formats are not read at all: see `contents`.
"""

COLUMNS: Mapping[str, str] = {
    "*/cost.csv/ms_per_frame*": "wall time",
    "*/cost.csv/frame_*_ms*": "wall time",
    "*/cost.csv/peak_memory_mb*": "memory of the process",
    "study/tables/table_1.csv/our time, ms": "wall time",
    "study/tables/cold_starts.csv/seconds": "wall time",
    "study/tables/shape_starts.csv/seconds": "wall time",
}
"""By pattern of output/file/column."""

ROWS: Mapping[str, str] = {
    "study/tables/verdict.csv/*: slowest start, s": "wall time",
    "study/tables/verdict.csv/*median start, s": "wall time",
    "study/tables/verdict.csv/slowest start, s": "wall time",
}
"""By pattern of output/file/cell: rows with such a cell."""


def is_file_left_out(path: Path, where: str) -> bool:
    """Whether a file, at ``where`` within the outputs, is not recorded."""
    # A recording carries a copy of the target's mesh and of the catalogue beside it.
    if path.suffix == ".toml" and path.with_suffix(".obj").exists():
        return True
    return any(fnmatchcase(where, pattern) for pattern in FILES)


def without_left_out(where: str, table: Mapping[str, list[str]]) -> dict[str, list[str]]:
    """The columns and rows of a table that are recorded."""
    table = {
        column: cells
        for column, cells in table.items()
        if not any(fnmatchcase(f"{where}/{column}", pattern) for pattern in COLUMNS)
    }
    if not any(fnmatchcase(where, pattern.rpartition("/")[0]) for pattern in ROWS):
        return table
    rows = [
        row
        for row in zip(*table.values(), strict=True)
        if not any(fnmatchcase(f"{where}/{text}", pattern) for text in row for pattern in ROWS)
    ]
    return {column: [row[k] for row in rows] for k, column in enumerate(table)}
