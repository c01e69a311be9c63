"""The study of Hu 2024 as a list of verbs: identify, follow, compare, repeat, disturb."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from pcnav.batch.monte_carlo import Case, Run, RunBatch, batches, runs_of
from pcnav.core.arrays import joined
from pcnav.files.text_table import TextTable

from ..folder import Study
from ..tables import cell, table
from ..text import study_of
from ..work import Work
from . import disturbed, errors, identification, paper
from .disturbed import Claimed
from .errors import Consistency, percent
from .following import Following, Judged, cases, run_case
from .identification import Method, Rmse

RUNS = paper.IDENTIFICATION_RUNS
"""Of every noise level of Fig. 5; a fifth of them test the filter's consistency."""
_BATCH = 125
"""Identification runs at once, which take as long as five runs of the filter."""
_WORK = 5.0 / _BATCH
_PER_FILTER_RUN, _PER_FIGURE_RUN, _PER_FAULT_RUN, _PER_DISTURBED_RUN = 5, 50, 25, 12.5
"""Identification runs for one run of the filter, of Figs. 6-11, with faults, disturbed."""
_FEWEST = 2


def study(runs: int, work: Work) -> Study:
    """Rebuild Figs. 5-11.

    Raises `InputError` when the shipped pipeline is missing or bad, `RunError` when a run fails.
    """
    # The longest work first, so that no core waits for the last of it.
    identified = work.plan(identification.run_identification, identification_batches(runs))
    followed = work.plan(run_case, filter_runs(runs))
    work.run()
    rmse = identification.rmse_of(identified.by_case)
    by_case = {name: joined(parts, alike=("time_s",)) for name, parts in followed.by_case.items()}
    unique, free, wrong = (by_case[name] for name in ("unique axes", "free axes", "wrong matches"))
    claimed = disturbed.claimed_by(by_case)
    matched, twice = (Consistency.of(by_case[name]) for name in ("matched", "pixels used twice"))
    stereo = paper.pipeline().stereo
    ends = [cell(curves[Method.ARC][-1]) for curves in rmse.values()]
    return study_of(
        Path(__file__).parent,
        runs,
        [
            _verdict(rmse, by_case, matched, claimed),
            identification.rmse_table("fig05", rmse, Method.ARC),
            identification.rmse_table("fig05_printed", rmse, Method.PRINTED),
            errors.comparison_table("fig06_11", unique, free),
            errors.blackout_table(unique),
            errors.inside_table(unique, free),
            errors.nees_table(matched, twice),
            errors.last_table("matched", by_case["matched"]),
            disturbed.disturbed_table(claimed),
            errors.match_table(wrong),
            errors.last_table("wrong_matches", wrong),
        ],
        [
            identification.rmse_figure("fig05_arc", rmse, Method.ARC),
            identification.rmse_figure("fig05_printed", rmse, Method.PRINTED),
            *errors.error_figures(unique, free),
            errors.nees_figure(matched),
            disturbed.disturbed_figure(claimed),
        ],
        shown=("verdict", "fig06_11", "disturbed"),
        pipelines={paper.NAME: paper.pipeline()},
        best=ends[0],
        worst=ends[-1],
        attitude_inside=percent(errors.ATTITUDE.share_inside(unique)),
        nees=matched.whole[-1],
        stereo=stereo,
        resolution_rad=stereo.pixel_sigma_px / stereo.focal_px,
        dark=", ".join(f"{start:g} to {end:g} s" for start, end in paper.blackouts_s()),
        paper=paper,
        shown_runs=len(unique),
        matched_runs=len(by_case["matched"]),
        fault_runs=len(wrong),
        disturbed_runs=len(claimed[0].runs),
        last_from_s=errors.last_from_s(unique),
    )


def identification_batches(count: int) -> list[RunBatch[float]]:
    """So many runs of every resolution."""
    levels = [Case(f"{level:g} rad", level, _WORK) for level in paper.LEVELS_RAD]
    return batches(runs_of(paper.NAME, levels, count), _BATCH)


def filter_runs(count: int) -> list[Run[Following]]:
    """The filter's runs; all cases meet the same points and noise as far as they go."""
    found = cases()

    def some(per: float, *names: str) -> list[Run[Following]]:
        return runs_of(paper.NAME, [found[name] for name in names], max(_FEWEST, int(count / per)))

    return [
        *disturbed.disturbed_runs(max(_FEWEST, int(count / _PER_DISTURBED_RUN))),
        *some(_PER_FILTER_RUN, "matched"),
        *some(_PER_FAULT_RUN, "wrong matches", "pixels used twice"),
        *some(_PER_FIGURE_RUN, "unique axes", "free axes"),
    ]


def _verdict(
    rmse: Rmse,
    by_case: Mapping[str, Judged],
    matched: Consistency,
    claimed: Sequence[Claimed],
) -> TextTable:
    unprinted = "not printed"
    least = min(q.share_inside(by_case["unique axes"]) for q in errors.QUANTITIES)
    free = by_case["free axes"]
    renamed = min(q.share_inside(free, label_free=True) for q in errors.QUANTITIES)
    offsets = max(q.share_inside(free) for q in errors.TURNING)
    _, wrong_used, _, wrong = by_case["wrong matches"].matches.sum(axis=0)
    used = wrong_used / max(wrong, 1)
    whole, motion, inside = matched.whole[-1], matched.motion[-1], matched.share_inside
    fall = identification.falls(rmse, Method.ARC)
    rise = identification.rises_with_noise(rmse, Method.ARC)
    levels = "all four levels"
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
            "offsets without: attitude, rate, ratios inside 3 sd",
            "no: offsets",
            f"{percent(offsets)} of the best quantity",
            offsets < 0.9,
        ),
        (
            "the same but for the names of the axes",
            unprinted,
            f"{percent(renamed)} of the worst quantity",
            renamed > 0.99,
        ),
        ("NEES at the end, whole state", unprinted, whole, bool(whole.inside)),
        ("NEES at the end, motion", unprinted, motion, bool(motion.inside)),
        ("times with the NEES inside", unprinted, f"{100.0 * inside:.0f} %", inside >= 0.9),
        ("wrong matches used", unprinted, f"{100.0 * used:.2f} %", used < 0.01),
        *(row for each in claimed for row in _claimed_rows(each)),
    )
    return table("verdict", ("quantity", "paper", "ours", "met"), rows, text_columns=4)


def _claimed_rows(claimed: Claimed) -> list[tuple[object, ...]]:
    unprinted, turns, inside = "not printed", claimed.half_turns, claimed.share_inside
    times = f"times with the NEES inside where locked, disturbance {claimed.name}"
    return [
        (f"half turns called locked, disturbance {claimed.name}", unprinted, turns, turns == 0),
        (times, unprinted, f"{100.0 * inside:.0f} %", inside >= 0.9),
    ]
