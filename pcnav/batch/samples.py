"""What a statistic is taken of: numbers of one run, by frame or one for the whole run.

A quantity says which numbers of a run's record it is about; only these are kept of a record, so
that the frames of many runs never lie in memory together.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from pcnav.batch.case import BatchRun
from pcnav.batch.record import RunRecord
from pcnav.core.arrays import BoolArray, FloatArray, IntArray

SECOND_HALF = 0.5


@dataclass(frozen=True)
class Window:
    """Which frames of a run the errors are taken over.

    A filter's beginning is another question than what it settles at: unless told otherwise the
    first half of a run is left out.
    """

    from_s: float | None = None
    """From so long after the first frame on; None for the second half of each run."""

    def frames(self, time_s: FloatArray) -> BoolArray:
        """(n,) which frames belong to it."""
        if not len(time_s):
            return np.zeros(0, dtype=np.bool_)
        elapsed = time_s - time_s[0]
        start = SECOND_HALF * elapsed[-1] if self.from_s is None else self.from_s
        return np.asarray(elapsed >= start)

    @property
    def text(self) -> str:
        """In words, for a table's note."""
        if self.from_s is None:
            return "the second half of each run"
        if not self.from_s:
            return "whole runs"
        return f"the frames from {self.from_s:g} s after the first on"


SETTLED = Window()
"""The second half of each run."""


@dataclass(frozen=True)
class Sample:
    """Numbers of one run; without those that do not exist."""

    values: FloatArray
    """(k,)"""
    weights: FloatArray
    """(k,) in a mean."""


SampleOf = Callable[[RunRecord, Window], Sample]
"""Takes a quantity's numbers from a record."""


@dataclass(frozen=True)
class CellSamples:
    """The numbers of all runs that one cell of a table is about."""

    runs: tuple[BatchRun, ...]
    """Those that came to an end, in order."""
    failed: tuple[BatchRun, ...]
    samples: dict[str, tuple[Sample, ...]]
    """By quantity, one sample per run of `runs`."""

    @property
    def strata(self) -> tuple[str, ...]:
        """The case of each run: runs are drawn again within their case."""
        return tuple(run.case.name for run in self.runs)


def collect(
    records: Iterable[RunRecord], quantities: dict[str, SampleOf], window: Window
) -> CellSamples:
    """The samples of some quantities of records that are read one after the other."""
    runs: list[BatchRun] = []
    failed: list[BatchRun] = []
    samples: dict[str, list[Sample]] = {name: [] for name in quantities}
    for record in records:
        if record.failure is not None:
            failed.append(record.run)
            continue
        runs.append(record.run)
        for name, sample_of in quantities.items():
            samples[name].append(sample_of(record, window))
    kept = {name: tuple(of_runs) for name, of_runs in samples.items()}
    return CellSamples(tuple(runs), tuple(failed), kept)


def known(values: FloatArray, weights: FloatArray | None = None) -> Sample:
    """A sample of values (n,), those that are not finite left out."""
    weights = np.ones(len(values)) if weights is None else weights
    finite = np.isfinite(values) & np.isfinite(weights)
    return Sample(values[finite], weights[finite])


def column(name: str) -> SampleOf:
    """Values frame by frame within the window."""
    return lambda record, window: known(numbers(record, name)[_within(record, window)])


def columns_ratio(name: str, other: str) -> SampleOf:
    """One column over another, frame by frame within the window."""

    def sample(record: RunRecord, window: Window) -> Sample:
        inside = _within(record, window)
        below = numbers(record, other)[inside]
        ratio = np.full(len(below), np.nan)
        np.divide(numbers(record, name)[inside], below, out=ratio, where=below > 0.0)
        return known(ratio)

    return sample


def per_degree(name: str, degrees: int | str) -> SampleOf:
    """A squared normalised error over its degrees of freedom: a number, or those of a column.

    In a mean each frame weighs as many times as it has degrees of freedom.
    """

    def sample(record: RunRecord, window: Window) -> Sample:
        inside = _within(record, window)
        squared = numbers(record, name)[inside]
        if isinstance(degrees, str):
            of_frame = numbers(record, degrees)[inside]
        else:
            of_frame = np.full(len(squared), float(degrees))
        used = of_frame > 0.0
        return known(squared[used] / of_frame[used], of_frame[used])

    return sample


def per_cent_known(name: str) -> SampleOf:
    """100 for each frame within the window that has a value in the column, 0 for the others."""
    return lambda record, window: known(
        100.0 * np.isfinite(numbers(record, name)[_within(record, window)])
    )


def value(name: str, scale: float = 1.0) -> SampleOf:
    """The one value that the whole run has."""
    return lambda record, _: known(np.array([scale * record.values.get(name, np.nan)]))


def per_cent_without(name: str) -> SampleOf:
    """100 for a run that has no such value, 0 for one that has."""
    return lambda record, _: known(
        np.array([0.0 if np.isfinite(record.values.get(name, np.nan)) else 100.0])
    )


def numbers(record: RunRecord, name: str) -> FloatArray:
    """(n,) a column of a record; nan where it has none of that name."""
    found = record.columns.get(name)
    if isinstance(found, np.ndarray):
        return found
    return np.full(record.frames, np.nan)


def pooled(samples: Sequence[Sample]) -> tuple[FloatArray, FloatArray, IntArray]:
    """Values, weights and the index of their run (n,), sorted by value."""
    values = np.concatenate([sample.values for sample in samples] or [np.empty(0)])
    weights = np.concatenate([sample.weights for sample in samples] or [np.empty(0)])
    run = np.repeat(np.arange(len(samples)), [len(sample.values) for sample in samples])
    order = np.argsort(values, kind="stable")
    return values[order], weights[order], run[order]


def _within(record: RunRecord, window: Window) -> BoolArray:
    return window.frames(numbers(record, "time_s"))
