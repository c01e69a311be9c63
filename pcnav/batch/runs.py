"""The runs of a study: cases by name, each repeatable alone by its seed."""

import zlib
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Run:
    """One run of a case: what it is called and the seed that repeats it."""

    case: str
    index: int
    seed: int

    def __str__(self) -> str:
        return f"{self.case}, run {self.index} (seed {self.seed})"


def run_seed(name: str, index: int) -> int:
    """Seed of a run, from its name and index alone: the same on every machine."""
    sequence = np.random.SeedSequence(zlib.crc32(name.encode()), spawn_key=(index,))
    return int(sequence.generate_state(1)[0])


def runs_of(name: str, cases: Sequence[str], count: int) -> list[Run]:
    """So many runs of every case, case after case.

    The seeds depend on the name and the index: all cases meet the same truths, so that they can
    be compared.
    """
    seeds = [run_seed(name, index) for index in range(count)]
    return [Run(case, index, seed) for case in cases for index, seed in enumerate(seeds)]
