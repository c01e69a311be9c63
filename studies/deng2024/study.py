"""The study of Deng 2024 as a list of verbs: rank, filter, judge, look longer."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from pcnav.config.pipeline_file import Pipeline
from pcnav.config.scenario import BodyTable, ScenarioTable
from pcnav.dynamics.rigid_body import ratios_from_inertia
from pcnav.estimators.attitude_inertia.rotation_model import INERTIA
from pcnav.files.text_table import TextTable

from ..folder import Study
from ..tables import Claim, cell, verdict
from ..text import study_text
from ..work import Work
from . import paper
from .arcs import arc_case, arc_figure, arc_motions, arc_table, comparison_table
from .consistency import CaseResult, monte_carlo_cases, nees_figure, nees_table, run_case
from .estimates import Estimates
from .filters import error_table, filter_figures, filter_runs, measured, ratio_figure, spin_table
from .ranks import RankCase, rank_figure, rank_states, rank_tables, ranked

RUNS = 100
_MIN_FOR_LONG = 10
"""With fewer runs arcs are cut: a look at the machinery."""
_QUICK_S = 20.0
_ARC_S, _QUICK_ARC_S = 1000.0, 40.0
"""Of the last chapter."""


def study(runs: int, work: Work) -> Study:
    """Rebuild ranks (21), (23) and Figs. 2-6.

    Raises `RunError` when a run fails.
    """
    quick = runs < _MIN_FOR_LONG
    duration_s = _QUICK_S if quick else paper.DURATION_S
    motions = paper.nutation(duration_s), paper.spin(duration_s)
    results = work.plan(run_case, monte_carlo_cases(runs, duration_s)).results
    ranks = work.plan(ranked, rank_states()).results
    filtered = work.plan(filter_runs, motions).results
    arcs = work.plan(arc_case, arc_motions(_QUICK_ARC_S if quick else _ARC_S)).results
    work.run()
    in_nutation, in_spin = filtered
    seen = measured(motions[0], paper.HALF_ANGLE_SD_RAD, seed=1)
    text = study_text(Path(__file__).parent)
    cut = "Because of the few runs asked for, the motions were cut." if quick else ""
    return Study(
        title=text.title,
        lead=text.lead,
        headline=_headline(ranks, results),
        chapters=(
            text.chapter("What is shown", [_verdict(ranks, in_spin, results)], cut=cut),
            text.chapter("Rank (section 2)", rank_tables(ranks), [rank_figure(ranks)]),
            text.chapter(
                "Filter in nutation (Figs. 2-5)",
                [error_table(in_nutation)],
                filter_figures(seen, in_nutation),
            ),
            text.chapter(
                "Filter in a spin (Fig. 6)",
                [spin_table(in_spin)],
                [ratio_figure("fig6", "Fig. 6: inertia ratios in a spin", in_spin)],
            ),
            text.chapter("Consistency", [nees_table(results)], [nees_figure(results)]),
            text.chapter(
                "Arcs of finite length",
                [arc_table(arcs), comparison_table(results[0])],
                [arc_figure(arcs)],
            ),
        ),
        summary_keys=("verdict", "ranks", "arcs"),
        pipelines={"deng2024": _pipeline(duration_s)},
        runs=runs,
    )


def _verdict(
    ranks: Sequence[RankCase], spin: Sequence[Estimates], results: Sequence[CaseResult]
) -> TextTable:
    claims = []
    for case in ranks[:5]:
        full = case.state.stated == "11"
        expected = "11" if full else "below 11; 8 by an independent computation"
        rank = case.last.rank
        claims.append(
            Claim("", f"rank: {case.state.name}", expected, rank, rank == (11 if full else 8))
        )
    sds = [run.sd[:, 0, INERTIA] for run in spin]
    stuck = [int(np.sum(sd[-1] > 0.5 * sd[0])) for sd in sds]
    ours = f"{min(stuck)} to {max(stuck)} of 5 do not, by filter"
    quantity = "inertia ratios in the spin (Fig. 6)"
    claims.append(Claim("", quantity, "do not converge", ours, min(stuck) >= 1))
    for result in results[:3]:
        settled = replace(result.judged[0], mean=np.array(result.settled_nees))
        name = f"NEES per state from {result.settled_from_s:g} s on: {result.case.name}"
        met = settled.verdict == "inside"
        claims.append(Claim("", name, result.bounds, f"{settled.mean:.3f}", met))
    return verdict("Expected against ours", claims, None, "expected", text_columns=4)


def _headline(
    ranks: Sequence[RankCase], results: Sequence[CaseResult]
) -> tuple[tuple[str, str], ...]:
    rank_of = {case.state.name: f"{case.last.rank} of 11" for case in ranks}
    return (
        ("rank in nutation", rank_of["printed, nutation"]),
        ("rank in a spin", rank_of["printed, spin"]),
        ("NEES per state, nutation", cell(results[0].settled_nees)),
    )


def _pipeline(duration_s: float) -> Pipeline:
    inertia = paper.inertia_of_printed(paper.NUTATION_RATIOS)
    a, b, c, d, e = ratios_from_inertia(inertia).tolist()
    return Pipeline(
        scenario=ScenarioTable(
            frames=round(duration_s / paper.INTERVAL_S) + 1, frame_rate_hz=1.0 / paper.INTERVAL_S
        ),
        body=BodyTable(omega_body_deg_s=paper.NUTATION_RATE_DEG_S, inertia_ratios=(a, b, c, d, e)),
    )
