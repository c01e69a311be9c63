"""The runs of the study: which motions, settings and hypotheses, and their results put together."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from pcnav.batch.cluster import Workers
from pcnav.batch.engine import run_all
from pcnav.batch.monte_carlo import run_seed
from pcnav.config.inertia_bank import InertiaBankTable
from pcnav.core.arrays import FloatArray, IntArray

from ..progress import Progress
from . import paper
from .draws import Draw, draw_hypotheses, moments_only
from .monte_carlo import Batch, BatchErrors, run_batch
from .paper import Motion

STUDY = "segal2011"
_RUNS_PER_BATCH = 20
"""So many filters are one array that it stays in the processor's cache."""
_DRAW_STREAM = 1
VAGUE_ATTITUDE_SD_DEG = 5.0
"""That of the shipped settings, about each axis: how much the picks owe to the study's 1 degree."""


@dataclass(frozen=True)
class Case:
    """Runs of one kind."""

    name: str
    runs: int
    hypotheses: Callable[[np.random.Generator], FloatArray]
    """(h, 3, 3) of a run; the generator is the run's own."""
    motion: Motion
    table: InertiaBankTable = paper.BANK
    blend: int = 0

    def batches(self) -> list[Batch]:
        """To be run in any order; the same truths in every case."""
        made = []
        for first in range(0, self.runs, _RUNS_PER_BATCH):
            indices = range(first, min(first + _RUNS_PER_BATCH, self.runs))
            seeds = tuple(run_seed(STUDY, index) for index in indices)
            inertia = np.stack(
                [self.hypotheses(np.random.default_rng([seed, _DRAW_STREAM])) for seed in seeds]
            )
            made.append(Batch(self.name, self.motion, self.table, seeds, inertia, self.blend))
        return made


@dataclass(frozen=True)
class CaseResult:
    """What the runs of a case found, runs along the second axis."""

    found: BatchErrors
    inertia: FloatArray
    """(runs, h, 3, 3)"""
    motion: Motion
    table: InertiaBankTable

    @property
    def runs(self) -> int:
        """How many."""
        return len(self.inertia)

    def picked(self, among: IntArray, printed: bool = False) -> IntArray:
        """(frames, runs) index of the most probable of some hypotheses at every frame."""
        logs = self.found.log_printed if printed else self.found.log_innovation
        return np.asarray(among[np.argmax(logs[..., among], axis=-1)], dtype=np.intp)

    def errors_of(self, hypothesis: IntArray) -> FloatArray:
        """(frames, runs, 5) errors of the hypothesis (frames, runs) that is believed."""
        return np.asarray(
            np.take_along_axis(self.found.errors, hypothesis[..., None, None], axis=2)[:, :, 0]
        )


def run_cases(cases: list[Case], workers: Workers, progress: Progress) -> list[CaseResult]:
    """Run the batches of all cases over the cores."""
    batches = [batch for case in cases for batch in case.batches()]
    # One call for all keeps every core busy to the end; a batch's share is that of its filters.
    share = work_of(cases) / max(len(batches), 1)
    found = iter(run_all(run_batch, batches, workers, lambda: progress.add(share)))
    results = []
    for case in cases:
        own = [next(found) for _ in case.batches()]
        inertia = np.concatenate([batch.inertia for batch in case.batches()])
        results.append(CaseResult(_joined(own), inertia, case.motion, case.table))
    return results


def work_of(cases: list[Case]) -> int:
    """Units of work: filters times frames, in thousands."""
    filters = (
        case.runs * len(case.hypotheses(np.random.default_rng(0))) * len(case.motion.times_s)
        for case in cases
    )
    return max(1, sum(filters) // 1000)


def _joined(parts: list[BatchErrors]) -> BatchErrors:
    return BatchErrors(
        errors=np.concatenate([part.errors for part in parts], axis=1),
        blended=np.concatenate([part.blended for part in parts]),
        log_innovation=np.concatenate([part.log_innovation for part in parts], axis=1),
        log_printed=np.concatenate([part.log_printed for part in parts], axis=1),
        nees=np.concatenate([part.nees for part in parts], axis=1),
    )


def truth_only(_: np.random.Generator) -> FloatArray:
    """The true inertia as the one hypothesis."""
    return paper.TARGET_INERTIA[None]


def drawn_and_truth(rng: np.random.Generator) -> FloatArray:
    """Five physical draws, then the truth."""
    drawn = draw_hypotheses(Draw.PHYSICAL, paper.HYPOTHESES, rng)
    return np.concatenate([drawn, paper.TARGET_INERTIA[None]])


def drawn_as_printed(rng: np.random.Generator) -> FloatArray:
    """Five draws as printed."""
    return draw_hypotheses(Draw.PRINTED, paper.HYPOTHESES, rng)


def four_and_truth(rng: np.random.Generator) -> FloatArray:
    """Four physical draws, then the truth."""
    return drawn_and_truth(rng)[1:]


def four_moments_and_truth(rng: np.random.Generator) -> FloatArray:
    """Four bodies with the true principal axes, then the truth."""
    return np.concatenate([moments_only(4, rng), paper.TARGET_INERTIA[None]])


def coupling_cases(runs: int, motion: Motion) -> list[Case]:
    """The true inertia, without coupled errors, and without a lever arm."""
    plain = paper.BANK.model_copy(update={"kinematic_coupling": False})
    no_arm = paper.BANK.model_copy(update={"mass_centre_sd_m": 1e-3})
    return [
        Case("errors in body axes", runs, truth_only, motion, plain),
        Case("no lever arm", runs, truth_only, motion, no_arm),
    ]


def motion_cases(runs: int, motion: Motion) -> list[Case]:
    """The printed motion with axes known worse, and others: faster, and about a principal axis."""
    _, axes = np.linalg.eigh(paper.TARGET_INERTIA)
    duration, interval = float(motion.times_s[-1]), float(motion.times_s[1])

    def moving(omega: FloatArray) -> Motion:
        return paper.true_motion(omega_body=omega, duration_s=duration, interval_s=interval)

    spin = moving(np.radians(0.5) * axes[:, 2])
    fast = Case("three times the printed rate", runs, four_and_truth, moving(3.0 * paper.OMEGA_0))
    spinning = Case("spin about the largest moment, 0.5 deg/s", runs, four_and_truth, spin)
    moments = "same spin, hypotheses that differ in moments only"
    vague = paper.BANK.model_copy(update={"attitude_sd_deg": VAGUE_ATTITUDE_SD_DEG})
    name = f"as printed, attitude known to {VAGUE_ATTITUDE_SD_DEG:g} deg"
    worse = Case(name, runs, four_and_truth, motion, vague)
    half = paper.true_motion(duration_s=0.5 * duration, interval_s=interval)
    return [
        worse,
        replace(worse, name=f"{name}, half the arc", motion=half),
        fast,
        spinning,
        replace(spinning, name=moments, hypotheses=four_moments_and_truth),
    ]
