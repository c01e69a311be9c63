"""The study of Deng 2024 as a list of verbs: rank, filter, judge, look longer."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from pcnav.config.pipeline_file import Pipeline
from pcnav.config.scenario import BodyTable, ScenarioTable
from pcnav.dynamics.rigid_body import ratios_from_inertia
from pcnav.estimators.attitude_inertia.rotation_model import INERTIA
from pcnav.files.text_table import TextTable

from ..folder import Study
from ..tables import cell, table
from ..text import study_of
from ..work import Work
from . import consistency, filters, observability, paper

RUNS = 100
_MIN_FOR_LONG = 10
"""With fewer runs arcs are cut: a look at the machinery."""
_QUICK_S = 20.0
_ARC_S, _QUICK_ARC_S = 1000.0, 40.0
"""Of the last chapter."""
_CUT = "Because of the few runs asked for, the motions were cut."


def study(runs: int, work: Work) -> Study:
    """Rebuild ranks (21), (23) and Figs. 2-6.

    Raises `RunError` when a run fails.
    """
    quick = runs < _MIN_FOR_LONG
    duration_s, arc_s = (_QUICK_S, _QUICK_ARC_S) if quick else (paper.DURATION_S, _ARC_S)
    motions = paper.nutation(duration_s), paper.spin(duration_s)
    cases = consistency.monte_carlo_cases(runs, duration_s)
    results = work.plan(consistency.run_case, cases).results
    ranks = work.plan(observability.ranked, observability.rank_states()).results
    filtered = work.plan(filters.filter_runs, motions).results
    arcs = work.plan(observability.arc_case, observability.arc_motions(arc_s)).results
    work.run()
    in_nutation, in_spin = filtered
    rank_of = {case.state.name: case.last.rank for case in ranks}
    return study_of(
        Path(__file__).parent,
        runs,
        [
            _verdict(ranks, in_spin, results),
            *observability.rank_tables(ranks),
            filters.error_table(in_nutation),
            filters.spin_table(in_spin),
            consistency.nees_table(results),
            observability.arc_table(arcs),
            observability.comparison_table(results[0].found, cases[0].prior),
        ],
        [
            observability.rank_figure(ranks),
            *filters.filter_figures(in_nutation),
            *filters.ratio_figures("fig6", in_spin),
            consistency.nees_figure(results),
            observability.arc_figure(arcs),
        ],
        shown=("verdict", "ranks", "arcs"),
        pipelines={"deng2024": _pipeline(duration_s)},
        cut=_CUT if quick else "",
        nutation_rank=rank_of["printed, nutation"],
        spin_rank=rank_of["printed, spin"],
        nutation_nees=cell(results[0].settled_nees.mean),
        tolerance=ranks[0].last.tolerance,
        min_drawn=observability.MIN_DRAWN,
        paper=paper,
        sensor=observability.SENSOR,
        compared=cases[0].name,
    )


def _verdict(
    ranks: Sequence[observability.RankCase],
    spin: Sequence[filters.Estimates],
    results: Sequence[consistency.CaseResult],
) -> TextTable:
    rows: list[tuple[object, ...]] = []
    for case in ranks[:5]:
        full, rank = case.state.full, case.last.rank
        expected = "11" if full else "below 11; 8 by an independent computation"
        rows.append((f"rank: {case.state.name}", expected, rank, rank == (11 if full else 8)))
    sds = [run.sd[:, 0, INERTIA] for run in spin]
    stuck = [int(np.sum(sd[-1] > 0.5 * sd[0])) for sd in sds]
    ours = f"{min(stuck)} to {max(stuck)} of 5 do not, by filter"
    rows.append(("inertia ratios in the spin (Fig. 6)", "do not converge", ours, min(stuck) >= 1))
    for result in results[:3]:
        nees, name = result.settled_nees, result.case.name
        quantity = f"NEES per state from {result.settled_from_s:g} s on: {name}"
        rows.append((quantity, result.mean_bounds, f"{nees.mean:.3f}", result.is_inside))
    return table("verdict", ("quantity", "expected", "ours", "met"), rows, text_columns=4)


def _pipeline(duration_s: float) -> Pipeline:
    a, b, c, d, e = ratios_from_inertia(paper.NUTATION.inertia).tolist()
    return Pipeline(
        scenario=ScenarioTable(
            frames=round(duration_s / paper.INTERVAL_S) + 1, frame_rate_hz=1.0 / paper.INTERVAL_S
        ),
        body=BodyTable(omega_body_deg_s=paper.NUTATION.rate_deg_s, inertia_ratios=(a, b, c, d, e)),
    )
