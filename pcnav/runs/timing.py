"""When the frames of a run that followed its recording were answered: timing.csv."""

import csv
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np

from pcnav.files.csv_table import read_csv
from pcnav.runs.result_files import TIMING_FILE

TIMING_COLUMNS = ("time_s", "delay_s", "processor_s", "answer")


class AnswerTime(StrEnum):
    """How a frame was answered."""

    IN_TIME = "in_time"
    LATE = "late"
    BEHIND = "behind"
    """Late, as frames that were there before the start were still being caught up on."""
    EARLIER = "earlier"
    """Was there before the start: nobody knows since when."""
    PASSED_OVER = "passed_over"
    """Not answered: it had waited for longer than the budget, and there was a later one."""


@dataclass(frozen=True)
class Timing:
    """One row."""

    time_s: float
    """Of the frame."""
    answer: AnswerTime
    delay_s: float = np.nan
    """From when all of the frame was there to when its estimate was written."""
    processor_s: float = np.nan
    """Processor time on it."""


class TimingFile:
    """timing.csv, each row handed to the system at once; a context manager."""

    def __init__(self, folder: Path) -> None:
        self._file = (folder / TIMING_FILE).open("w", encoding="utf-8", newline="")
        self._table = csv.writer(self._file, lineterminator="\n")
        self._table.writerow(TIMING_COLUMNS)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._file.close()

    def add(self, row: Timing) -> None:
        """Append a row."""
        numbers = ("" if np.isnan(x) else f"{x:.6f}" for x in (row.delay_s, row.processor_s))
        self._table.writerow([float(row.time_s), *numbers, str(row.answer)])
        self._file.flush()


def read_timing(folder: Path) -> Mapping[float, Timing]:
    """The rows of a result folder by the times of their frames. Raises `InputError`."""
    # A process that was killed may have left half a row.
    table = read_csv(folder / TIMING_FILE, TIMING_COLUMNS, TIMING_COLUMNS[3:], growing=True)
    numbers = table.numbers(TIMING_COLUMNS[:3]).tolist()
    rows = zip(numbers, table.words("answer"), strict=True)
    return {row[0]: Timing(row[0], AnswerTime(word), *row[1:]) for row, word in rows}


def timing_sentences(rows: Iterable[Timing], budget_s: float) -> tuple[str, tuple[str, ...]]:
    """What the answers took, in a sentence, and what is to be warned of."""
    found = list(rows)
    words = [row.answer for row in found]
    counts = {word: words.count(word) for word in AnswerTime}
    delays = np.array([row.delay_s for row in found if row.answer is not AnswerTime.EARLIER])
    cost = np.array([row.processor_s for row in found])
    told = f"{len(found)} frames: {counts[AnswerTime.IN_TIME]} answered within {budget_s:g} s"
    told += f", {counts[AnswerTime.LATE]} late"
    if counts[AnswerTime.EARLIER]:
        told += f", {counts[AnswerTime.EARLIER]} were there before"
    if np.isfinite(delays).any():
        told += f"; {np.nanmedian(delays):.3f} s after they came, at most {np.nanmax(delays):.3f} s"
    if np.isfinite(cost).any():
        told += f"; {1e3 * np.nanmedian(cost):.0f} ms of processor time a frame"
    late = (
        (AnswerTime.LATE, f"were answered later than {budget_s:g} s after they came"),
        (AnswerTime.BEHIND, "were late because earlier frames were still being caught up on"),
        (AnswerTime.PASSED_OVER, f"had waited for more than {budget_s:g} s and were passed over"),
    )
    warned = (
        f"{counts[word]} of {len(found)} frames {text}" for word, text in late if counts[word]
    )
    return told, tuple(warned)
