"""The study of the tracker as a list of verbs: start, black out, repeat, disturb, compare."""

from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

from pcnav.simulation.random_truth import satellite

from ..folder import Study
from ..tables import verdict
from ..text import study_of
from ..work import Work
from . import (
    abroad,
    another_cad,
    any_shape,
    blackouts,
    calibrated,
    consistency,
    faults,
    few_returns,
    foreign_mass,
    foretold,
    starts,
)
from .blackouts import Phases

RUNS = 100
"""Monte Carlo runs of the consistency chapter unless told otherwise; the others follow from it."""
_STARTS_PER_RUN, _RUNS_PER_BLACKOUT, _RUNS_PER_FAULT, _RUNS_PER_ABROAD, _RUNS_PER_SHAPE = (
    3,
    10,
    20,
    50,
    5,
)
_RUNS_PER_FEW = 3
_RUNS_PER_CAD = 20
_RUNS_PER_FOREIGN = 8
_RUNS_PER_CALIBRATION, _RUNS_PER_FORETOLD = 2, 16
_QUICK_RUNS = 5


@dataclass(frozen=True)
class Lengths:
    """Frames of the runs."""

    consistency: int = consistency.FRAMES
    calibrated: int = calibrated.FRAMES
    faults: int = faults.FRAMES
    abroad: int = abroad.FRAMES
    another_cad: int = another_cad.FRAMES
    blackout: Phases = field(default_factory=Phases)


_QUICK = Lengths(
    consistency=16,
    calibrated=8,
    faults=8,
    abroad=5,
    another_cad=12,
    blackout=Phases(before=8, after=6),
)
"""With fewer runs than `_QUICK_RUNS`: a look at the machinery."""
_CUT = (
    "Because of the few runs asked for, sequences were cut to a few frames: this shows that the "
    "study works, not how good the tracker is."
)


def study(runs: int, work: Work) -> Study:
    """Measure the tracker on simulated sequences and judge it by its bars.

    Raises `InputError` when a shipped satellite or pipeline is missing or bad, `RunError` when a
    run fails.
    """
    lengths = _QUICK if runs < _QUICK_RUNS else Lengths()
    phases = lengths.blackout
    per_case = (_RUNS_PER_BLACKOUT, _RUNS_PER_FAULT, _RUNS_PER_ABROAD)
    few, fewer, fewest = (max(2, runs // per) for per in per_case)
    black_out = partial(blackouts.run_blackout, phases=phases)
    track = partial(consistency.run_consistency, frames=lengths.consistency)
    go_abroad = partial(abroad.run_abroad, frames=lengths.abroad)
    scenes = abroad.QUICK_CASES if lengths == _QUICK else abroad.CASES
    disturb = partial(faults.run_fault, frames=lengths.faults)
    cold = work.repeat(
        starts.run_start, starts.NAME, starts.CASES, _STARTS_PER_RUN * runs, starts.FRAMES
    )
    dark = work.repeat(black_out, blackouts.NAME, blackouts.CASES, few, phases.seen)
    repeated = work.repeat(
        track, consistency.NAME, {consistency.NAME: ()}, runs, lengths.consistency
    )
    foreign_track = partial(foreign_mass.run_foreign, frames=lengths.consistency)
    foreigners = foreign_mass.QUICK_CASES if lengths == _QUICK else foreign_mass.CASES
    foreign = work.repeat(
        *(foreign_track, foreign_mass.NAME, foreigners),
        *(max(2, runs // _RUNS_PER_FOREIGN), lengths.consistency),
    )
    foretell = partial(foretold.run_foretold, frames=lengths.consistency)
    future = work.repeat(
        *(foretell, foretold.NAME, foreigners),
        *(max(2, runs // _RUNS_PER_FORETOLD), lengths.consistency),
    )
    errs = partial(calibrated.run_calibration, frames=lengths.calibrated)
    off = work.repeat(
        *(errs, calibrated.NAME, calibrated.CASES),
        *(max(2, runs // _RUNS_PER_CALIBRATION), lengths.calibrated),
    )
    disturbed = work.repeat(disturb, faults.NAME, faults.CASES, fewer, lengths.faults)
    away = work.repeat(go_abroad, abroad.NAME, scenes, fewest, lengths.abroad)
    shapes = any_shape.QUICK_CASES if lengths == _QUICK else any_shape.CASES
    shaped = work.repeat(
        any_shape.run_shape, any_shape.NAME, shapes, max(2, runs // _RUNS_PER_SHAPE), starts.FRAMES
    )
    few_cases = few_returns.QUICK_CASES if lengths == _QUICK else few_returns.CASES
    small = work.repeat(
        few_returns.run_few,
        *(few_returns.NAME, few_cases),
        *(max(2, runs // _RUNS_PER_FEW), few_returns.FRAMES),
    )
    differ = partial(another_cad.run_other, frames=lengths.another_cad)
    differences = another_cad.QUICK_CASES if lengths == _QUICK else another_cad.CASES
    several = max(2, runs // _RUNS_PER_CAD)
    other = work.repeat(differ, another_cad.NAME, differences, several, lengths.another_cad)
    work.run()
    judged = consistency.Judged.of(repeated.results)
    claims = [
        *(claim for own in cold.by_case.values() for claim in starts.claims(own)),
        *(claim for own in dark.by_case.values() for claim in blackouts.claims(own)),
        *consistency.claims(judged),
        *foreign_mass.claims(foreign.by_case),
        *foretold.claims(future.by_case),
        *calibrated.claims(off.by_case),
        *faults.claims(disturbed.by_case),
        *abroad.claims(away.by_case),
        *any_shape.claims(shaped.results),
        *few_returns.claims(small.results),
        *another_cad.claims(other.by_case),
    ]
    relocked = [each.relocked for each in dark.results]
    missed = relocked.count(None)
    slowest = max((frames for frames in relocked if frames is not None), default=0)
    means = judged.mean_claims
    silent = [run for run in disturbed.results if run.fault != faults.WRONG_TARGET]
    return study_of(
        Path(__file__).parent,
        runs,
        [
            verdict(claims, "chapter", "bar"),
            *starts.tables(cold.by_case),
            *blackouts.tables(dark.by_case),
            *consistency.tables(judged),
            *foreign_mass.tables(foreign.by_case),
            *foretold.tables(future.by_case),
            *calibrated.tables(off.by_case),
            *faults.tables(disturbed.by_case),
            *abroad.tables(away.by_case),
            *any_shape.tables(shaped.by_case),
            *few_returns.tables(small.by_case),
            *another_cad.tables(other.by_case),
        ],
        [
            *starts.start_figures(cold.by_case),
            *blackouts.figures(dark.by_case),
            *consistency.figures(judged),
        ],
        shown=("verdict",),
        pipelines={name: satellite(name).pipeline for name in starts.SATELLITES},
        met=sum(claim.met for claim in claims),
        claims=len(claims),
        right=starts.count(cold.results, starts.Outcome.RIGHT),
        starts=len(cold.results),
        wrong=starts.count(cold.results, starts.Outcome.WRONG),
        relocked=f"{missed} never" if missed else f"{slowest} at most",
        inside=sum(claim.met for claim in means),
        judged=len(means),
        outside=0.05 * len(means),
        silent=faults.silent_frames(silent),
        abroad_wrong=abroad.wrong_frames(away.by_case),
        abroad=abroad,
        shapes=len(shaped.by_case),
        shape_right=starts.count(shaped.results, starts.Outcome.RIGHT),
        shape_wrong=starts.count(shaped.results, starts.Outcome.WRONG),
        shape_starts=len(shaped.results),
        few_started=few_returns.started_of_known(small.results),
        few_wrong=sum(start.wrong > 0 for start in small.results),
        few_starts=len(small.results),
        few=few_returns,
        cut=_CUT if lengths == _QUICK else "",
        start=starts,
        blackout=blackouts,
        phases=phases,
        consistency=consistency,
        calibrated=calibrated,
        frames=lengths.consistency,
        estimated=judged.estimated,
        beyond=len(judged.beyond),
    )
