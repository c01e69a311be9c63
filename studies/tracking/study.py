"""The study of the tracker as a list of verbs: start, black out, repeat, disturb, compare."""

from dataclasses import dataclass, field

from pcnav.files.text_table import TextTable
from pcnav.simulation.random_truth import satellite

from ..folder import Chapter, Study
from ..progress import Progress
from ..work import Work
from . import consistency, faults, starts
from .bars import Bar
from .blackouts import BlackoutResult, Phases, blackout_chapter, planned_blackouts
from .consistency import ConsistencyResult, consistency_chapter, planned_runs
from .faults import FaultResult, fault_chapter, planned_faults
from .starts import StartResult, planned_starts, start_chapter

RUNS = 100
"""Monte Carlo runs of the consistency chapter unless told otherwise; the others follow from it."""
_STARTS_PER_RUN = 3
_RUNS_PER_BLACKOUT = 10
_RUNS_PER_FAULT = 20
_FEWEST = 2
_QUICK_RUNS = 5


@dataclass(frozen=True)
class Lengths:
    """Frames of the runs."""

    consistency: int = consistency.FRAMES
    faults: int = faults.FRAMES
    blackout: Phases = field(default_factory=Phases)


_QUICK = Lengths(consistency=16, faults=8, blackout=Phases(before=8, after=6))
"""With fewer runs than `_QUICK_RUNS`: a look at the machinery."""


def study(runs: int, work: Work) -> Study:
    """Measure the tracker on simulated sequences and judge it by its bars.

    Raises `InputError` when a shipped satellite or pipeline is missing or bad, `RunError` when a
    run fails.
    """
    lengths = _QUICK if runs < _QUICK_RUNS else Lengths()
    cold = planned_starts(_STARTS_PER_RUN * runs)
    dark = planned_blackouts(max(_FEWEST, runs // _RUNS_PER_BLACKOUT))
    repeated = planned_runs(runs)
    disturbed = planned_faults(max(_FEWEST, runs // _RUNS_PER_FAULT))
    seen = lengths.blackout.before + lengths.blackout.after
    units = starts.FRAMES * len(cold) + seen * len(dark)
    units += lengths.consistency * len(repeated) + lengths.faults * len(disturbed)
    progress = Progress(units, work.on_progress)
    started = start_chapter(cold, work.workers, progress)
    blackouts = blackout_chapter(dark, lengths.blackout, work.workers, progress)
    consistent = consistency_chapter(repeated, lengths.consistency, work.workers, progress)
    faulty = fault_chapter(disturbed, lengths.faults, work.workers, progress)
    bars = (*started.bars, *blackouts.bars, *consistent.bars, *faulty.bars)
    return Study(
        title="The tracker against its bars",
        lead="Cold starts, blackouts, consistency and faults on simulated sequences with random "
        "truth; nothing but the target, the settings and the frames enters an estimate.",
        headline=_headline(bars, started, blackouts, consistent, faulty),
        chapters=(
            Chapter("Bars", _text(lengths), (_verdict(bars),)),
            started.chapter,
            blackouts.chapter,
            consistent.chapter,
            faulty.chapter,
        ),
        summary_keys=("verdict",),
        pipelines={name: satellite(name).pipeline for name in starts.SATELLITES},
        runs=runs,
    )


def _verdict(bars: tuple[Bar, ...]) -> TextTable:
    rows = tuple(
        (bar.chapter, bar.quantity, bar.bar, bar.ours, "yes" if bar.met else "no") for bar in bars
    )
    header = ("chapter", "quantity", "bar", "ours", "met")
    return TextTable("verdict", "Every bar", header, rows, text_columns=2)


def _headline(
    bars: tuple[Bar, ...],
    started: StartResult,
    blackouts: BlackoutResult,
    consistent: ConsistencyResult,
    faulty: FaultResult,
) -> tuple[tuple[str, str], ...]:
    outcomes = [start.outcome for start in started.starts]
    relocked = [blackout.relocked for blackout in blackouts.blackouts]
    slowest = max((frames for frames in relocked if frames is not None), default=0)
    missed = sum(frames is None for frames in relocked)
    silent = sum(run.silent.sum() for run in faulty.runs if run.fault != faults.WRONG_TARGET)
    return (
        ("bars met", f"{sum(bar.met for bar in bars)} of {len(bars)}"),
        ("cold starts right", f"{outcomes.count(starts.Outcome.RIGHT)} of {len(outcomes)}"),
        ("cold starts locked wrong", str(outcomes.count(starts.Outcome.WRONG))),
        (
            "frames to lock again after a blackout",
            f"{slowest} at most" if not missed else f"{missed} never",
        ),
        ("NEES and NIS means inside", f"{consistent.inside} of {consistent.judged}"),
        ("frames of silent wrong lock", str(int(silent))),
    )


def _text(lengths: Lengths) -> tuple[str, ...]:
    lines = [
        "Every number below was measured in one run of this study. Truths and noise follow from "
        "the seeds in the tables: any run can be repeated alone with the function its table names."
    ]
    if lengths == _QUICK:
        lines.append(
            "Because of the few runs asked for, sequences were cut to a few frames: this shows "
            "that the study works, not how good the tracker is."
        )
    return tuple(lines)
