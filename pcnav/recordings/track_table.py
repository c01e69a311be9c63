"""Rows of tracks.csv: features by time, with pixels of one camera or of two.

Rows come in order of time; a time without features is one row whose other fields are empty.
"""

import csv
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from pcnav.core.arrays import FloatArray, IntArray
from pcnav.core.errors import InputError
from pcnav.files.csv_table import CsvTable

Row = tuple[float, IntArray, FloatArray]
"""A time in seconds, its features (n,) and their pixels (n, k)."""


def write_track_table(path: Path, columns: tuple[str, ...], frames: Iterable[Row]) -> None:
    """Write frames in order of time; ``columns`` are time_s, feature and those of the pixels."""
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(columns)
        for time_s, features, pixels in frames:
            if not len(features):
                writer.writerow([time_s, *[""] * (len(columns) - 1)])
            pairs = zip(features.tolist(), pixels.tolist(), strict=True)
            writer.writerows([time_s, feature, *of_it] for feature, of_it in pairs)


def checked_tracks(
    table: CsvTable, columns: tuple[str, ...]
) -> tuple[FloatArray, IntArray, FloatArray]:
    """(n,) times, (n,) features, -1 in a time without any, and (n, k) pixels of checked rows.

    Raises `InputError`, which names the line, for numbers that are not finite, times out of order
    and a feature twice at a time.
    """
    time_s = table.times()
    table.require_any()
    numbers, pixels = table.numbers(columns[1:2])[:, 0], table.numbers(columns[2:])
    empty = np.isnan(numbers) & np.isnan(pixels).all(axis=1)
    whole = empty | ((numbers >= 0.0) & (numbers == np.rint(numbers)) & (numbers < 2.0**53))
    later = np.diff(time_s, prepend=-np.inf) >= 0.0
    table.require(later, "expected times in order, this one is before the last", "time_s")
    table.require(whole, "expected a whole number from 0 on", "feature")
    for k, name in enumerate(columns[2:]):
        table.require(empty | np.isfinite(pixels[:, k]), "expected a finite number", name)
    features = np.where(empty, -1, np.where(empty, 0.0, numbers)).astype(np.intp)
    _refuse_repeated(table.path, time_s, features)
    return time_s, features, pixels


def frame_rows(time_s: FloatArray, features: IntArray) -> list[slice]:
    """The rows of each time; none of a time without features."""
    # A row begins a frame when its time differs from the one before.
    starts = np.flatnonzero(np.diff(time_s, prepend=np.nan) != 0.0).tolist()
    ends = [*starts[1:], len(time_s)]
    return [
        slice(start, start if features[start] < 0 else end)
        for start, end in zip(starts, ends, strict=True)
    ]


def _refuse_repeated(path: Path, time_s: FloatArray, features: IntArray) -> None:
    """Each feature at most once at a time, and nothing beside the row of a time without any."""
    order = np.lexsort((features, time_s))
    same_time = np.diff(time_s[order]) == 0.0
    twice = same_time & (np.diff(features[order]) == 0)
    beside_none = same_time & (features[order][:-1] < 0)
    for wrong in (twice, beside_none):
        if wrong.any():
            # Rows of a pair come in the file's order; the later one is at fault.
            row = int(order[1:][wrong].min())
            number = features[row]
            expected = "expected no other row at a time without features"
            if wrong is twice and number >= 0:
                expected = f"expected each feature once at a time, {number} is repeated"
            raise InputError(path, f"line {row + 2}, feature", f"{expected} ({time_s[row]:g} s)")
