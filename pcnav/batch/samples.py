"""Numbers of one run that a metric is taken of: by frame within a window, or one for the run."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from pcnav.batch.record import RunRecord
from pcnav.core.arrays import BoolArray, FloatArray


@dataclass(frozen=True)
class EvaluationWindow:
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
        return np.asarray(elapsed >= (0.5 * elapsed[-1] if self.from_s is None else self.from_s))

    @property
    def text(self) -> str:
        """In words, for a table's note."""
        if self.from_s is None:
            return "the second half of each run"
        if not self.from_s:
            return "whole runs"
        return f"the frames from {self.from_s:g} s after the first on"


SETTLED = EvaluationWindow()
"""The second half of each run."""


@dataclass(frozen=True)
class Sample:
    """Numbers of one run; without those that do not exist."""

    values: FloatArray
    """(k,)"""
    weights: FloatArray
    """(k,) in a mean."""

    @classmethod
    def known(cls, values: FloatArray, weights: FloatArray | None = None) -> "Sample":
        """Of values (n,), those that are not finite left out."""
        weights = np.ones(len(values)) if weights is None else weights
        finite = np.isfinite(values) & np.isfinite(weights)
        return cls(values[finite], weights[finite])


SampleOf = Callable[[RunRecord, EvaluationWindow], Sample]
"""Takes a quantity's numbers from a record; only these are kept of it."""


def column(name: str) -> SampleOf:
    """Values frame by frame within the window."""
    return lambda record, window: Sample.known(within(record, window, name))


def columns_ratio(name: str, other: str) -> SampleOf:
    """One column over another, frame by frame within the window."""

    def sample(record: RunRecord, window: EvaluationWindow) -> Sample:
        above, below = within(record, window, name), within(record, window, other)
        positive = below > 0.0
        return Sample.known(above[positive] / below[positive])

    return sample


def per_degree(name: str) -> SampleOf:
    """A squared normalised error over its degrees of freedom: those of the column ``name_dof``, or
    of all frames the value of that name.

    In a mean each frame weighs as many times as it has degrees of freedom.
    """
    degrees = f"{name}_dof"

    def sample(record: RunRecord, window: EvaluationWindow) -> Sample:
        squared = within(record, window, name)
        if degrees in record.columns:
            of_frame = within(record, window, degrees)
        else:
            of_frame = np.full(len(squared), record.values.get(degrees, np.nan))
        used = of_frame > 0.0
        return Sample.known(squared[used] / of_frame[used], of_frame[used])

    return sample


def per_cent_known(name: str) -> SampleOf:
    """100 for each frame within the window that has a value in the column, 0 for the others."""
    return lambda record, window: Sample.known(100.0 * np.isfinite(within(record, window, name)))


def value(name: str, scale: float = 1.0) -> SampleOf:
    """The one value that the whole run has."""
    return lambda record, _: Sample.known(np.array([scale * record.values.get(name, np.nan)]))


def per_cent_without(name: str) -> SampleOf:
    """100 for a run that has no such value, 0 for one that has."""
    return lambda record, _: Sample.known(
        np.array([0.0 if np.isfinite(record.values.get(name, np.nan)) else 100.0])
    )


def within(record: RunRecord, window: EvaluationWindow, name: str) -> FloatArray:
    """(k,) a column of a record in the frames of a window; nan where it has none of that name."""
    inside = window.frames(record.numbers("time_s"))
    return record.numbers(name)[inside]
