"""The study of Segal 2011 as a list of verbs: draw, filter, compare, pick, couple."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from pcnav.batch.monte_carlo import batches, runs_of
from pcnav.core.arrays import IntArray, joined
from pcnav.files.text_table import TextTable

from ..folder import Study
from ..pipelines import shipped
from ..tables import cell, table
from ..text import study_of
from ..work import Work
from . import errors, paper
from .draws import Draw, physical_share
from .errors import ATTITUDE, Filter, estimates_of
from .picking import OBSERVABLE_SD, SEPARATED, Picks, picking_table, picks_of
from .runs import (
    RUNS_PER_BATCH,
    STUDY,
    Found,
    bank_cases,
    coupling_cases,
    motion_cases,
    run_batch,
)

RUNS = 1000
"""Of Fig. 4; a tenth of them make Figs. 2, 3, 5 and 6 and the motions that are not printed."""
_PLAIN_SHARE = 10
_FEWEST = 2
_QUICK_RUNS = 10
_QUICK_S = 80.0
"""With fewer runs than `_QUICK_RUNS` the arc is cut to so long: a look at the machinery."""
_TRUTH = 5
"""Place of the true inertia after the five draws."""
_WITH_TRUTH: IntArray = np.arange(1, 6)
_SHARE_DRAWS = 20_000
_CUT = (
    "Because of the few runs asked for, the arc was cut: this shows that the study works, not what "
    "the estimator can do."
)


def study(runs: int, work: Work) -> Study:
    """Rebuild Figs. 2-6.

    Raises `InputError` when the shipped pipeline is missing or bad, `RunError` when a run fails.
    """
    few = max(_FEWEST, runs // _PLAIN_SHARE)
    quick = runs < _QUICK_RUNS
    motion = paper.true_motion(duration_s=_QUICK_S if quick else paper.DURATION_S)
    banks, couplings, motions = bank_cases(motion), coupling_cases(motion), motion_cases(motion)
    # All at once keeps every core busy to the end.
    planned = runs_of(STUDY, banks, runs) + runs_of(STUDY, [*couplings, *motions], few)
    results = work.plan(run_batch, batches(planned, RUNS_PER_BATCH))
    work.run()
    found = {name: joined(parts, axis=1) for name, parts in results.by_case.items()}
    physical, printed = found["physical draws"], found["draws as printed"]
    picks = [picks_of("as printed", banks[0], physical, _WITH_TRUTH, _TRUTH)]
    picks += [picks_of(case.name, case, found[case.name], np.arange(5), 4) for case in motions]
    known, times_s = Filter.of(physical, _TRUTH, few), motion.times_s
    filters = {"coupled": known}
    filters |= {case.name: Filter.of(found[case.name], 0, few) for case in couplings}
    rng = np.random.default_rng(0)
    printed_percent, physical_percent = (
        cell(100.0 * physical_share(draw, _SHARE_DRAWS, rng)) for draw in Draw
    )
    return study_of(
        Path(__file__).parent,
        runs,
        [
            _verdict(physical, printed, picks, filters),
            errors.plain_table(known, times_s),
            errors.bank_table("bank_physical", physical),
            errors.bank_table("bank_printed", printed),
            picking_table(picks),
            errors.coupling_table(filters),
        ],
        [
            *errors.plain_figures(known, times_s),
            errors.bank_figure("figure4", physical, times_s),
            errors.bank_figure("figure4_printed", printed, times_s),
            *errors.coupling_figures(filters, times_s),
        ],
        shown=("verdict", "picking"),
        pipelines={STUDY: shipped(STUDY)},
        random=_spread(physical, "random inertia"),
        bank_of_five=_spread(physical, "bank, most probable"),
        picked=_picked(picks[0]) if np.any(picks[0].observable) else "never observable",
        cut=_CUT if quick else "",
        paper=paper,
        anomaly_deg=cell(np.degrees(paper.ORBIT.true_anomaly_rad)),
        few=few,
        physical_share=physical_percent,
        printed_share=printed_percent,
        separated=SEPARATED,
        observable_sd=OBSERVABLE_SD,
    )


def _verdict(
    physical: Found, printed: Found, picks: Sequence[Picks], filters: Mapping[str, Filter]
) -> TextTable:
    rows: list[tuple[object, ...]] = []
    for draws, found in (("physical draws", physical), ("draws as printed", printed)):
        estimates = estimates_of(found)
        for p in (50, 90):
            random, bank = (
                np.percentile(estimates[name][-1, :, ATTITUDE], p)
                for name in ("random inertia", "bank, most probable")
            )
            quantity = f"attitude at the end, {p} %, {draws}"
            ours = f"{cell(bank)} deg, random inertia {cell(random)} deg"
            rows.append((quantity, "the bank is better (Fig. 4)", ours, bank < random))
    for each in picks:
        if np.any(each.observable):
            quantity = f"true inertia picked where observable: {each.name}"
            rows.append((quantity, "at least 95 %", _picked(each), _share(each) >= 95.0))
    with_it, *others = (np.median(each.errors[-1, :, 0]) for each in filters.values())
    for name, without in zip(list(filters)[1:], others, strict=True):
        quantity = f"median position error at the end, coupled against {name}"
        ours = f"{cell(with_it)} m against {cell(without)} m"
        rows.append((quantity, "the coupling is better (Fig. 5)", ours, with_it < without))
    return table("verdict", ("quantity", "expected", "ours", "met"), rows, text_columns=4)


def _share(picks: Picks) -> float:
    return 100.0 * float(np.mean(picks.right[picks.observable]))


def _picked(picks: Picks) -> str:
    return f"{cell(_share(picks))} % of {int(picks.observable.sum())} runs"


def _spread(physical: Found, name: str) -> str:
    """Of the attitude at the end."""
    low, high = np.percentile(estimates_of(physical)[name][-1, :, ATTITUDE], (50, 90))
    return f"{cell(low)} and {cell(high)} deg"
