"""Monte Carlo: a function over many runs of named cases, each run repeatable alone by its seed.

    cases = [Case("0.1 px", Settings(noise_px=0.1)), Case("0.5 px", Settings(noise_px=0.5))]
    runs = runs_of("my study", cases, 100)
    found = monte_carlo(one_run, runs, workers, progress.add)
    found["0.1 px"]     # what one_run(run) returned for its 100 runs, in order

The function finds in a run the settings of its case and a seed. Where many runs are one array, it
is given `batches` of runs instead of single ones.
"""

import hashlib
import re
import zlib
from collections.abc import Callable, Iterable, Sequence
from contextlib import closing
from dataclasses import dataclass
from itertools import groupby
from typing import Any, Generic, Protocol, TypeVar

import numpy as np

from pcnav.batch.cluster import EVERY_CORE, Workers
from pcnav.batch.engine import results

_MAX_SLUG, _HASH_DIGITS = 60, 10

Settings = TypeVar("Settings", covariant=True)
Result = TypeVar("Result")


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


class Item(Protocol):
    """What a function is called with: a run, or a batch of runs."""

    @property
    def case(self) -> Case[Any]: ...
    @property
    def work(self) -> float: ...


AnyItem = TypeVar("AnyItem", bound=Item)


def work_of(items: Iterable[Item]) -> float:
    """Units of work in all."""
    return sum(item.work for item in items)


def monte_carlo(
    function: Callable[[AnyItem], Result],
    items: Sequence[AnyItem],
    workers: Workers = EVERY_CORE,
    on_done: Callable[[float], None] = lambda work: None,
) -> dict[str, list[Result]]:
    """``function`` of every run or batch of runs: results by the name of the case, in order.

    Args:
        function: defined at the top of a module, or a `functools.partial` of such a one, so that
            another process can find it. The same run gives the same result in any process.
        items: of `runs_of` or `batches`, or made one by one.
        workers: processes of this machine, or a dask cluster.
        on_done: told in this process the units of work of every item that is done.

    Raises `RunError` when a run fails, which ends all others, and `InputError` when a cluster
    cannot be used.
    """
    found: dict[int, Result] = {}
    with closing(results(function, items, workers)) as ended:
        for k, result in ended:
            found[k] = result
            on_done(items[k].work)
    by_case: dict[str, list[Result]] = {}
    for k, item in enumerate(items):
        by_case.setdefault(item.case.name, []).append(found[k])
    return by_case
