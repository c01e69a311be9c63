"""The study of the tracker as a list of verbs: start, black out, repeat, disturb, compare."""

from dataclasses import dataclass, field
from pathlib import Path

from pcnav.simulation.random_truth import satellite

from ..folder import Study
from ..tables import verdict
from ..text import study_text
from ..work import Work
from . import blackouts, consistency, faults, starts
from .blackouts import Phases

RUNS = 100
"""Monte Carlo runs of the consistency chapter unless told otherwise; the others follow from it."""
_STARTS_PER_RUN, _RUNS_PER_BLACKOUT, _RUNS_PER_FAULT = 3, 10, 20
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
    phases = lengths.blackout
    some = max(_FEWEST, runs // _RUNS_PER_BLACKOUT), max(_FEWEST, runs // _RUNS_PER_FAULT)
    cold = work.plan(starts.start, starts.start_runs(_STARTS_PER_RUN * runs))
    dark = work.plan(blackouts.black_out, blackouts.blackout_runs(some[0], phases))
    repeated = work.plan(consistency.track, consistency.consistency_runs(runs, lengths.consistency))
    disturbed = work.plan(faults.disturb, faults.fault_runs(some[1], lengths.faults))
    work.run()
    judged = consistency.Judged.of(repeated.results)
    claims = [
        *starts.claims(cold.by_case),
        *blackouts.claims(dark.by_case),
        *consistency.claims(judged),
        *faults.claims(disturbed.by_case),
    ]
    text = study_text(Path(__file__).parent)
    cut = (
        "Because of the few runs asked for, sequences were cut to a few frames: this shows that "
        "the study works, not how good the tracker is."
    )
    right, wrong = (
        starts.count(cold.results, each) for each in (starts.Outcome.RIGHT, starts.Outcome.WRONG)
    )
    relocked = [each.relocked for each in dark.results]
    missed = relocked.count(None)
    slowest = max((frames for frames in relocked if frames is not None), default=0)
    means = judged.mean_claims
    silent = [run for run in disturbed.results if run.fault != faults.WRONG_TARGET]
    return Study(
        title=text.title,
        lead=text.lead,
        headline=(
            ("bars met", f"{sum(claim.met for claim in claims)} of {len(claims)}"),
            ("cold starts right", f"{right} of {len(cold.results)}"),
            ("cold starts locked wrong", str(wrong)),
            (
                "frames to lock again after a blackout",
                f"{missed} never" if missed else f"{slowest} at most",
            ),
            ("NEES and NIS means inside", f"{sum(m.met for m in means)} of {len(means)}"),
            ("frames of silent wrong lock", str(faults.silent_frames(silent))),
        ),
        chapters=(
            text.chapter(
                "Bars",
                [verdict("Every bar", claims, "chapter", "bar")],
                cut=cut if lengths == _QUICK else "",
            ),
            starts.chapter(text, cold.by_case),
            blackouts.chapter(text, dark.by_case, phases),
            consistency.chapter(text, judged),
            faults.chapter(text, disturbed.by_case),
        ),
        summary_keys=("verdict",),
        pipelines={name: satellite(name).pipeline for name in starts.SATELLITES},
        runs=runs,
    )
