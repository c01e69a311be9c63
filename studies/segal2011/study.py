"""The study of Segal 2011 as a list of verbs: draw, filter, compare, pick, couple."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from pcnav.batch.monte_carlo import batches, runs_of
from pcnav.core.arrays import IntArray
from pcnav.files.text_table import TextTable

from ..folder import Study
from ..pipelines import shipped
from ..tables import Claim, cell, verdict
from ..text import study_text
from ..work import Work
from . import paper
from .draws import Draw, physical_share
from .errors import (
    ATTITUDE,
    Filter,
    bank_figure,
    bank_table,
    coupling_figures,
    coupling_table,
    estimates_of,
    plain_figures,
    plain_table,
)
from .picking import SEPARATED, Picks, picking_table, picks_of
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


def study(runs: int, work: Work) -> Study:
    """Rebuild Figs. 2-6.

    Raises `InputError` when the shipped pipeline is missing or bad, `RunError` when a run fails.
    """
    pipeline = shipped(STUDY)
    few = max(_FEWEST, runs // _PLAIN_SHARE)
    quick = runs < _QUICK_RUNS
    motion = paper.true_motion(duration_s=_QUICK_S if quick else paper.DURATION_S)
    banks, couplings, motions = bank_cases(motion), coupling_cases(motion), motion_cases(motion)
    # All at once keeps every core busy to the end.
    planned = runs_of(STUDY, banks, runs) + runs_of(STUDY, [*couplings, *motions], few)
    results = work.plan(run_batch, batches(planned, RUNS_PER_BATCH))
    work.run()
    found = {name: Found.joined(parts) for name, parts in results.by_case.items()}
    physical, printed = found["physical draws"], found["draws as printed"]
    picks = [picks_of("as printed", banks[0], physical, _WITH_TRUTH, _TRUTH)]
    picks += [picks_of(case.name, case, found[case.name], np.arange(5), 4) for case in motions]
    known = Filter.of(physical, _TRUTH, few)
    filters = {"coupled": known} | {
        case.name: Filter.of(found[case.name], 0, few) for case in couplings
    }
    rng = np.random.default_rng(0)
    share = {f"{draw.name.lower()}_share": physical_share(draw, _SHARE_DRAWS, rng) for draw in Draw}
    cut = (
        "Because of the few runs asked for, the arc was cut: this shows that the study works, not "
        "what the estimator can do."
    )
    text, times_s = study_text(Path(__file__).parent), motion.times_s
    settings = text.table(
        "settings",
        "Settings",
        text_columns=3,
        anomaly_deg=cell(np.degrees(paper.ORBIT.true_anomaly_rad)),
        interval_s=paper.FRAME_INTERVAL_S,
        duration_s=paper.DURATION_S,
        bank=paper.BANK,
    )
    return Study(
        title=text.title,
        lead=text.lead,
        headline=_headline(physical, picks),
        chapters=(
            text.chapter(
                "What is shown",
                [_verdict(physical, printed, picks, filters), settings],
                cut=cut if quick else "",
            ),
            text.chapter(
                "The filter that knows the inertia",
                [plain_table(known, times_s)],
                plain_figures(known, times_s),
            ),
            text.chapter(
                "The bank against a random inertia",
                [
                    bank_table("bank_physical", "physical", physical),
                    bank_table("bank_printed", "as printed", printed),
                ],
                [
                    bank_figure("figure4", "Fig. 4", ", physical draws", physical, times_s),
                    bank_figure(
                        "figure4_printed", "Fig. 4, draws as printed", "", printed, times_s
                    ),
                ],
                **{name: cell(100.0 * value) for name, value in share.items()},
            ),
            text.chapter(
                "Is the true inertia found?",
                [picking_table(picks)],
                separated=SEPARATED,
                bank=paper.BANK,
            ),
            text.chapter(
                "Kinematic coupling",
                [coupling_table(filters)],
                coupling_figures(filters, times_s),
            ),
        ),
        summary_keys=("verdict", "picking"),
        pipelines={STUDY: pipeline},
        runs=runs,
    )


def _verdict(
    physical: Found, printed: Found, picks: Sequence[Picks], filters: Mapping[str, Filter]
) -> TextTable:
    claims = []
    for draws, found in (("physical draws", physical), ("draws as printed", printed)):
        estimates = estimates_of(found)
        for p in (50, 90):
            random, bank = (
                float(np.percentile(estimates[name][-1, :, ATTITUDE], p))
                for name in ("random inertia", "bank, most probable")
            )
            quantity = f"attitude at the end, {p} %, {draws}"
            ours = f"{cell(bank)} deg, random inertia {cell(random)} deg"
            claims.append(Claim("", quantity, "the bank is better (Fig. 4)", ours, bank < random))
    for each in picks:
        if np.any(each.observable):
            quantity = f"true inertia picked where observable: {each.name}"
            claims.append(Claim("", quantity, "at least 95 %", _picked(each), _share(each) >= 95.0))
    with_it, *others = (float(np.median(each.errors[-1, :, 0])) for each in filters.values())
    for name, without in zip(list(filters)[1:], others, strict=True):
        quantity = f"median position error at the end, coupled against {name}"
        ours = f"{cell(with_it)} m against {cell(without)} m"
        expected = "the coupling is better (Fig. 5)"
        claims.append(Claim("", quantity, expected, ours, with_it < without))
    return verdict("Expected against ours", claims, None, "expected", text_columns=4)


def _share(picks: Picks) -> float:
    return 100.0 * float(np.mean(picks.right[picks.observable]))


def _picked(picks: Picks) -> str:
    return f"{cell(_share(picks))} % of {int(picks.observable.sum())} runs"


def _headline(physical: Found, picks: Sequence[Picks]) -> tuple[tuple[str, str], ...]:
    estimates, shown = estimates_of(physical), []
    for label, name in (
        ("random inertia", "random inertia"),
        ("bank of five", "bank, most probable"),
    ):
        low, high = np.percentile(estimates[name][-1, :, ATTITUDE], (50, 90))
        shown.append((f"attitude, 50 and 90 %: {label}", f"{cell(low)} and {cell(high)} deg"))
    picked = _picked(picks[0]) if np.any(picks[0].observable) else "never observable"
    return (*shown, ("true inertia picked where observable", picked))
