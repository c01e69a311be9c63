"""The study of Hu 2024 as a list of verbs: identify, follow, compare, repeat, disturb."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from pcnav.batch.monte_carlo import Case, Run, RunBatch, batches, runs_of
from pcnav.files.text_table import TextTable

from ..folder import Study
from ..tables import Claim, cell, verdict
from ..text import study_text
from ..work import Work
from . import paper
from .errors import (
    ATTITUDE,
    QUANTITIES,
    TURNING,
    Consistency,
    blackout_table,
    error_figures,
    inside_table,
    last_table,
    match_table,
    nees_figure,
    nees_table,
    percent,
)
from .following import Following, JudgedRun, cases, run_case
from .identification import Method, run_identification
from .rmse import Rmse, falls, rises_with_noise, rmse_figures, rmse_of, rmse_tables

RUNS = paper.IDENTIFICATION_RUNS
"""Of every noise level of Fig. 5; a fifth of them test the filter's consistency."""
_BATCH = 125
"""Identification runs at once, which take as long as five runs of the filter."""
_WORK = 5.0 / _BATCH
_PER_FILTER_RUN, _PER_FIGURE_RUN, _PER_FAULT_RUN = 5, 50, 25
"""Identification runs for one run of the filter, of Figs. 6-11, with faults."""
_FEWEST = 2


def study(runs: int, work: Work) -> Study:
    """Rebuild Figs. 5-11.

    Raises `InputError` when the shipped pipeline is missing or bad, `RunError` when a run fails.
    """
    # The longest work first, so that no core waits for the last of it.
    identified = work.plan(run_identification, identification_batches(runs))
    followed = work.plan(run_case, filter_runs(runs))
    work.run()
    rmse, by_case = rmse_of(identified.by_case), followed.by_case
    matched, unique, free = (by_case[name] for name in ("matched", "unique axes", "free axes"))
    wrong, last = by_case["wrong matches"], "Errors over the last 50 s"
    dark = ", ".join(f"{start:g} to {end:g} s" for start, end in paper.blackouts_s())
    text = study_text(Path(__file__).parent)
    settings = text.table(
        "settings",
        "Settings that are open or changed",
        text_columns=3,
        stereo=paper.pipeline().stereo,
        resolution_rad=paper.resolution_rad(),
        dark=dark,
    )
    return Study(
        title=text.title,
        lead=text.lead,
        headline=_headline(rmse, unique, Consistency.of(matched)),
        chapters=(
            text.chapter("What is shown", [_verdict(rmse, by_case), settings]),
            text.chapter(
                "Identification of the principal axes (Fig. 5)",
                rmse_tables(rmse, runs),
                rmse_figures(rmse, runs),
            ),
            text.chapter(
                "The filter with and without unique axes (Figs. 6-11)",
                [
                    last_table("fig06_11", f"{last}, with and without unique axes", unique, free),
                    blackout_table(unique),
                    inside_table(unique, free),
                ],
                error_figures(unique[0], free[0]),
            ),
            text.chapter(
                "Beyond the paper: consistency, wrong matches",
                [
                    nees_table(matched, by_case["pixels used twice"]),
                    last_table("matched", f"{last}, matched disturbances", matched),
                    match_table(wrong),
                    last_table("wrong_matches", f"{last}, 10 points, 10 % wrong matches", wrong),
                ],
                [nees_figure(matched)],
                calm=paper.CALM,
            ),
        ),
        summary_keys=("verdict", "fig06_11"),
        pipelines={paper.NAME: paper.pipeline()},
        runs=runs,
    )


def identification_batches(count: int) -> list[RunBatch[float]]:
    """So many runs of every resolution."""
    levels = [Case(f"{level:g} rad", level, _WORK) for level in paper.LEVELS_RAD]
    return batches(runs_of(paper.NAME, levels, count), _BATCH)


def filter_runs(count: int) -> list[Run[Following]]:
    """The filter's runs; all cases meet the same points and noise as far as they go."""
    found = cases()

    def some(per: int, *names: str) -> list[Run[Following]]:
        return runs_of(paper.NAME, [found[name] for name in names], max(_FEWEST, count // per))

    return [
        *some(_PER_FILTER_RUN, "matched"),
        *some(_PER_FAULT_RUN, "wrong matches", "pixels used twice"),
        *some(_PER_FIGURE_RUN, "unique axes", "free axes"),
    ]


def _headline(
    rmse: Rmse, unique: Sequence[JudgedRun], consistent: Consistency
) -> tuple[tuple[str, str], ...]:
    ends = [cell(curves[Method.ARC][-1]) for curves in rmse.values()]
    return (
        ("RMSE of the axes after 30 s, deg", f"{ends[0]} to {ends[-1]}"),
        ("attitude inside 3 sd, unique axes", percent(ATTITUDE.share_inside(unique))),
        ("NEES at the end", str(consistent.whole[-1])),
    )


def _verdict(rmse: Rmse, by_case: Mapping[str, Sequence[JudgedRun]]) -> TextTable:
    unique, free = by_case["unique axes"], by_case["free axes"]
    least = min(q.share_inside(unique) for q in QUANTITIES)
    most = max(q.share_inside(free) for q in TURNING)
    _, wrong_used, _, wrong = np.sum([run.matches for run in by_case["wrong matches"]], axis=0)
    used = wrong_used / max(wrong, 1)
    consistent = Consistency.of(by_case["matched"])
    whole, motion, inside = consistent.whole[-1], consistent.motion[-1], consistent.share_inside
    fall, rise = falls(rmse, Method.ARC), rises_with_noise(rmse, Method.ARC)
    unprinted, levels = "not printed", "all four levels"
    rows = (
        ("RMSE of the axes falls with time", levels, fall, fall),
        ("RMSE of the axes rises with noise", levels, rise, rise),
        (
            "errors inside 3 sd with unique axes",
            "all",
            f"{percent(least)} of the worst quantity",
            least > 0.99,
        ),
        (
            "errors inside 3 sd without: attitude, rate, ratios",
            "no: offsets",
            f"{percent(most)} of the best quantity",
            most < 0.9,
        ),
        ("NEES at the end, whole state", unprinted, whole, bool(whole.inside)),
        ("NEES at the end, motion", unprinted, motion, bool(motion.inside)),
        ("times with the NEES inside", unprinted, f"{100.0 * inside:.0f} %", inside >= 0.9),
        ("wrong matches used", unprinted, f"{100.0 * used:.2f} %", used < 0.01),
    )
    title = "What the paper claims, and what was asked beyond"
    claims = [Claim("", *row) for row in rows]
    return verdict(title, claims, None, "paper", text_columns=4)
