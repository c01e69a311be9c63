"""Monte Carlo: runs of named cases, each repeatable alone by its seed.

A case has a name and settings, a run of it an index and a seed: that is all that a function needs
to make it, in whatever process. Where many runs are one array, `batches` of runs are made together.
"""

import hashlib
import re
import zlib
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import groupby
from typing import Generic, TypeVar

import numpy as np

_MAX_SLUG, _HASH_DIGITS = 60, 10

Settings = TypeVar("Settings", covariant=True)


@dataclass(frozen=True)
class Case(Generic[Settings]):
    """What the runs of one kind have in common."""

    name: str
    settings: Settings
    """Whatever the function needs to know; it can be sent to another process."""
    work: float = 1.0
    """Units of work that one of its runs takes, for the progress."""

    def __str__(self) -> str:
        return self.name


@dataclass(frozen=True)
class Run(Generic[Settings]):
    """One run of a case."""

    case: Case[Settings]
    index: int
    """Counted from 0."""
    seed: int
    """Fixes all that is drawn."""

    @property
    def work(self) -> float:
        """Units of work."""
        return self.case.work

    @property
    def key(self) -> str:
        """Unique and stable, fit for a file's name: some words to read, a hash, the index."""
        # Of ``axis=value`` the value.
        words = re.sub(r"(^| )[^ =]+=", r"\1", self.case.name)
        slug = re.sub(r"[^a-z0-9.]+", "-", words.lower()).strip("-.")[:_MAX_SLUG].rstrip("-.")
        digest = hashlib.sha256(self.case.name.encode()).hexdigest()[:_HASH_DIGITS]
        return f"{slug}-{digest}-{self.index:03d}"

    def __str__(self) -> str:
        return f"{self.case.name}, run {self.index} (seed {self.seed})"


@dataclass(frozen=True)
class RunBatch(Generic[Settings]):
    """Successive runs of a case that are computed together."""

    runs: tuple[Run[Settings], ...]
    """One at least."""

    @property
    def case(self) -> Case[Settings]:
        """Of all its runs."""
        return self.runs[0].case

    @property
    def seeds(self) -> tuple[int, ...]:
        """One a run."""
        return tuple(run.seed for run in self.runs)

    @property
    def work(self) -> float:
        """Units of work of all its runs."""
        return sum(run.work for run in self.runs)

    def __str__(self) -> str:
        first, last = self.runs[0], self.runs[-1]
        return f"{self.case.name}, runs {first.index} to {last.index} (from seed {first.seed})"


def run_seed(name: str, index: int) -> int:
    """Seed of a run, from a name and its index alone: the same on every machine."""
    sequence = np.random.SeedSequence(zlib.crc32(name.encode()), spawn_key=(index,))
    return int(sequence.generate_state(1)[0])


def runs_of(name: str, cases: Iterable[Case[Settings]], count: int) -> list[Run[Settings]]:
    """So many runs of every case, case after case.

    The seeds depend on the name and the index: all cases meet the same draws, so that they can be
    compared run by run.
    """
    seeds = [run_seed(name, index) for index in range(count)]
    return [Run(case, index, seed) for case in cases for index, seed in enumerate(seeds)]


def batches(runs: Iterable[Run[Settings]], size: int) -> list[RunBatch[Settings]]:
    """Runs of the same case in batches of so many; the last of a case may have fewer."""
    found = []
    for _, members in groupby(runs, key=lambda run: run.case.name):
        own = tuple(members)
        found += [RunBatch(own[k : k + size]) for k in range(0, len(own), size)]
    return found
