"""What a command wrote, as small tables of text that `git diff` shows well.

Every file becomes a table: columns of cells by name. Numbers keep `DIGITS` digits, well beyond what
is compared, so that the same number is always the same text. A long table keeps some of its rows,
evenly spaced, and beside it totals of all of them: a change in any row is seen, and the rows that
are kept show where it began.
"""

import csv
import json
import math
import re
import tomllib
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from tests.golden.left_out import is_file_left_out, without_left_out

Table = dict[str, list[str]]
"""Cells by column, all columns of one length."""
Contents = dict[str, Table]
"""Tables by the path of their file within an output folder."""

DIGITS = 12
MOST_ROWS, MOST_FRAMES = 100, 30
"""Of a table that is kept whole, and of one over time."""
TIME = "time_s"
"""The first column of a table over time."""
MEAN, RMS = ".mean", ".rms"
"""What the totals of a column of numbers are called after it."""
TEXT = "line"
"""The one column of what a command printed."""
_TOTALS = ".totals.json"

_FRAME, _IMAGE = "frame", "image"
_OF_KEYS = (".json", ".toml")


def contents(folder: Path, name: str) -> Contents:
    """Every file of a folder that holds numbers, each path under ``name``."""
    found: Contents = {}
    for path in sorted(folder.rglob("*")):
        where = f"{name}/{path.relative_to(folder).as_posix()}"
        if path.is_dir():
            images = sorted(path.glob("*.png"))
            if images:
                found |= _thinned(f"{where}.png.csv", _image_sums(images))
        elif path.suffix in _READERS and not is_file_left_out(path, where):
            table = without_left_out(where, _READERS[path.suffix](path))
            is_keys = path.suffix in _OF_KEYS and _FRAME not in table
            found |= _thinned(_with_suffix(where, ".json" if is_keys else ".csv"), table)
    return found


def printed(text: str, name: str) -> Contents:
    """What a command printed, without the lines and spaces that lay its tables out."""
    lines = re.sub("[\u2500-\u257f]", " ", text).splitlines()
    return {f"{name}.txt": {TEXT: [" ".join(line.split()) for line in lines if line.strip()]}}


def cell(value: object) -> str:
    """The text of a value: a number to `DIGITS` digits, nothing for one that is absent."""
    if value is None:
        return ""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, float | np.floating):
        return "" if math.isnan(value) else f"{value:.{DIGITS}g}"
    return str(value)


def number(text: str) -> float | None:
    """The number that a cell is, or None for words, for nothing and for what is not finite."""
    try:
        value = float(text)
    except ValueError:
        return None
    return value if math.isfinite(value) else None


def write_contents(folder: Path, tables: Contents) -> None:
    """Write tables to a folder: keys and values as JSON, text as lines, the rest as CSV."""
    for name, table in tables.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("w", encoding="utf-8", newline="") as file:
            if path.suffix == ".txt":
                file.writelines(f"{line}\n" for line in table[TEXT])
            elif path.suffix == ".json":
                file.write(json.dumps({key: cells[0] for key, cells in table.items()}, indent=0))
                file.write("\n")
            else:
                rows = csv.writer(file, lineterminator="\n")
                rows.writerows([table.keys(), *zip(*table.values(), strict=True)])


def read_contents(folder: Path) -> Contents:
    """Read back what `write_contents` wrote."""
    return {
        path.relative_to(folder).as_posix(): _recorded(path)
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


def _recorded(path: Path) -> Table:
    text = path.read_text(encoding="utf-8")
    if path.suffix == ".txt":
        return {TEXT: text.splitlines()}
    if path.suffix == ".json":
        return {key: [value] for key, value in json.loads(text).items()}
    return _read_csv(path)


def _with_suffix(name: str, suffix: str) -> str:
    """The name under which a table is kept: as keys and values (.json) or as rows (.csv)."""
    return name if name.endswith(suffix) else name + suffix


def _thinned(name: str, table: Table) -> Contents:
    """The table, and totals of all its rows where it is too long to be kept whole."""
    rows = len(next(iter(table.values()), []))
    most = MOST_FRAMES if next(iter(table), None) in (TIME, _FRAME, _IMAGE) else MOST_ROWS
    if rows <= most:
        return {name: table}
    kept = np.unique(np.linspace(0, rows - 1, most).round().astype(int))
    totals: dict[str, object] = {"rows": rows}
    for column, cells in table.items():
        totals |= {column + key: value for key, value in _totals(cells).items()}
    return {
        name: {column: [cells[k] for k in kept] for column, cells in table.items()},
        name + _TOTALS: {key: [cell(value)] for key, value in totals.items()},
    }


def _totals(cells: Sequence[str]) -> dict[str, object]:
    """Of numbers how many, mean and RMS; of words how often each appears."""
    words = Counter(text for text in cells if text and number(text) is None)
    totals: dict[str, object] = {f".{text}": count for text, count in sorted(words.items())}
    values = [value for value in map(number, cells) if value is not None]
    if values:
        totals[".numbers"] = len(values)
        totals[MEAN] = math.fsum(values) / len(values)
        totals[RMS] = math.sqrt(math.fsum(value**2 for value in values) / len(values))
    return totals


def _read_csv(path: Path) -> Table:
    with path.open(encoding="utf-8", newline="") as file:
        header, *rows = csv.reader(file)
    return _table(header, rows)


def _read_tum(path: Path) -> Table:
    """Poses as evo and others write them, which have no header."""
    header = (TIME, "p_x", "p_y", "p_z", "q_x", "q_y", "q_z", "q_w")
    return _table(header, [line.split() for line in path.read_text(encoding="utf-8").splitlines()])


def _table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> Table:
    """Columns by name; of those with the same name the later ones are numbered."""
    seen: Counter[str] = Counter()
    table: Table = {}
    for k, column in enumerate(header):
        seen[column] += 1
        name = column if seen[column] == 1 else f"{column} ({seen[column]})"
        table[name] = [_as_cell(row[k]) for row in rows]
    return table


def _as_cell(text: str) -> str:
    value = number(text)
    # Whole numbers may be longer than a float holds.
    return text if value is None or re.fullmatch(r"-?\d+", text) else cell(value)


def _read_json(path: Path) -> Table:
    """One row a frame where the keys are those of frames, else one row of all values."""
    about = json.loads(path.read_text(encoding="utf-8"))
    if isinstance(about, dict) and about and all(key.isdigit() for key in about):
        flat = [dict(_flat({_FRAME: int(key), "": value})) for key, value in about.items()]
        return {key: [cell(row.get(key)) for row in flat] for key in flat[0]}
    return {key: [cell(value)] for key, value in _flat(about)}


def _read_toml(path: Path) -> Table:
    about = tomllib.loads(path.read_text(encoding="utf-8"))
    return {key: [cell(value)] for key, value in _flat(about)}


def _flat(value: Any, name: str = "") -> Iterable[tuple[str, object]]:
    """Every value in nested tables and lists by its dotted name."""
    if isinstance(value, dict | list):
        items = value.items() if isinstance(value, dict) else enumerate(value)
        for key, inner in items:
            yield from _flat(inner, ".".join(part for part in (name, str(key)) if part))
    else:
        yield name, value


def _read_npz(path: Path) -> Table:
    """Lists as they are; of every covariance what no change of it leaves alone.

    Trace and norm are led by the states with the largest units. The correlations are not: their
    norm, and a sum of them with weights all different, which a swap of two states changes.
    """
    table: Table = {}
    with np.load(path) as arrays:
        for name in sorted(arrays.files, key=lambda name: arrays[name].ndim):
            if arrays[name].ndim == 1:
                table[name] = [cell(value) for value in arrays[name]]
                continue
            sd = np.sqrt(np.diagonal(arrays[name], axis1=1, axis2=2))
            scale = np.divide(1.0, sd, out=np.zeros_like(sd), where=sd > 0.0)
            correlations = arrays[name] * scale[:, :, None] * scale[:, None, :]
            weights = np.cos(1.0 + np.arange(correlations[0].size)).reshape(correlations[0].shape)
            columns = {
                "trace": np.sum(sd**2, axis=1),
                "norm": np.linalg.norm(arrays[name], axis=(1, 2)),
                "norm_of_correlations": np.linalg.norm(correlations, axis=(1, 2)),
                "weighted_correlations": np.sum(correlations * weights, axis=(1, 2)),
            }
            for key, values in columns.items():
                table[f"{name}.{key}"] = [cell(value) for value in values]
    return table


def _image_sums(images: Sequence[Path]) -> Table:
    """Of every image of a folder the pixels that are not zero, their mean and their RMS."""
    table: Table = {_IMAGE: [], "pixels": [], "mean": [], "rms": []}
    for path in images:
        values = np.asarray(Image.open(path), dtype=np.float64)
        seen = values[values != 0.0]
        sums = (seen.size, seen.sum() / max(seen.size, 1), np.sqrt(np.mean(values**2)))
        for cells, value in zip(table.values(), (path.stem, *sums), strict=True):
            cells.append(cell(value))
    return table


_READERS: Mapping[str, Callable[[Path], Table]] = {
    ".csv": _read_csv,
    ".json": _read_json,
    ".npz": _read_npz,
    ".toml": _read_toml,
    ".tum": _read_tum,
}
