"""What a batch is made of: cases, each a value on every axis, and the runs of each.

A run's seed follows from the batch's seed, the case's scenario and the run's index, never from the
place in the batch: a run alone is the run in the batch, and all estimators of a scenario meet the
same frames.
"""

import hashlib
import re
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

AxisValue = str | float | int
"""What a case has on an axis."""

ESTIMATOR_AXIS = "estimator"
"""The one axis that changes no frame."""

_MAX_SLUG = 60
_HASH_DIGITS = 10
_DIGITS = 12
"""Of a number in a case's name: values closer than this are the same case."""


@dataclass(frozen=True)
class Case:
    """One combination of axis values."""

    axes: tuple[tuple[str, AxisValue], ...]
    """Axis and value, in the order in which the axes are shown."""

    @property
    def name(self) -> str:
        """Like ``satellite=boxsat range_m=10 estimator=pcnav``."""
        return _named(self.axes)

    @property
    def scenario(self) -> str:
        """The name without the estimator, axes in alphabetical order: what fixes the frames."""
        return _named(sorted(axis for axis in self.axes if axis[0] != ESTIMATOR_AXIS))

    def value(self, axis: str) -> AxisValue:
        """What the case has on an axis. Raises ``LookupError`` for an axis it does not have."""
        for name, value in self.axes:
            if name == axis:
                return value
        raise LookupError(f"{self.name} has no axis {axis}")

    def __str__(self) -> str:
        return self.name


@dataclass(frozen=True)
class BatchRun:
    """One Monte Carlo run of a case."""

    case: Case
    index: int
    """Counted from 0."""
    seed: int
    """Fixes truth and noise."""

    @property
    def key(self) -> str:
        """Unique and stable, fit for a file's name: some words to read, a hash, the index."""
        name = self.case.name
        words = "-".join(shown_value(value) for _, value in self.case.axes)
        slug = re.sub(r"[^a-z0-9.]+", "-", words.lower()).strip("-.")[:_MAX_SLUG].rstrip("-.")
        digest = hashlib.sha256(name.encode()).hexdigest()[:_HASH_DIGITS]
        return f"{slug}-{digest}-{self.index:03d}"

    def __str__(self) -> str:
        return f"{self.case.name}, run {self.index} (seed {self.seed})"


def batch_seed(seed: int, case: Case, index: int) -> int:
    """Seed of a run: of the batch's seed, the case's scenario and the run's index alone."""
    digest = hashlib.sha256(case.scenario.encode()).digest()
    words = np.frombuffer(digest, dtype="<u4").tolist()
    sequence = np.random.SeedSequence([seed, *words], spawn_key=(index,))
    return int(sequence.generate_state(1)[0])


def batch_runs(cases: Iterable[Case], runs: int, seed: int) -> list[BatchRun]:
    """So many runs of every case, case after case."""
    return [
        BatchRun(case, index, batch_seed(seed, case, index))
        for case in cases
        for index in range(runs)
    ]


def _named(axes: Iterable[tuple[str, AxisValue]]) -> str:
    return " ".join(f"{axis}={shown_value(value)}" for axis, value in axes)


def shown_value(value: AxisValue) -> str:
    """A value as it stands in a case's name."""
    return value if isinstance(value, str) else f"{value:.{_DIGITS}g}"
