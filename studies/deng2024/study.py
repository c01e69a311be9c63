"""The study of Deng 2024 as a list of verbs: rank, filter, judge, look longer."""

import numpy as np

from pcnav.batch.engine import run_all
from pcnav.config.pipeline_file import Pipeline
from pcnav.config.scenario import BodyTable, ScenarioTable
from pcnav.dynamics.rigid_body import ratios_from_inertia
from pcnav.files.text_table import TextTable, number

from ..folder import Chapter, Study
from ..progress import Progress
from ..work import Work
from . import paper
from .arcs import ARC_S, arc_cases, arc_chapter
from .chapters import consistency_chapter, filter_chapter, spin_chapter
from .consistency import Case, CaseResult, run_case
from .filters import FilterRun, fitted_run, measured, printed_run
from .ranks import RankCase, rank_cases, rank_chapter

RUNS = 100
_MIN_FOR_LONG = 10
"""With fewer runs arcs are cut: a look at the machinery."""
_QUICK_S, _QUICK_ARC_S = 20.0, 40.0
_MONTE_CARLO_INTERVAL_S = 1.0
_MONTE_CARLO_SD_DEG = 0.5
_PARTS = 3
"""Units of work beside the Monte Carlo cases."""


def study(runs: int, work: Work) -> Study:
    """Rebuild ranks (21), (23) and Figs. 2-6.

    Raises `RunError` when a run fails.
    """
    duration_s = paper.DURATION_S if runs >= _MIN_FOR_LONG else _QUICK_S
    cases = monte_carlo_cases(runs, duration_s)
    progress = Progress(len(cases) + _PARTS, work.on_progress)
    results = run_all(run_case, cases, work.workers, lambda: progress.add(1))
    ranks = rank_cases()
    progress.add(1)
    nutation, spin = paper.nutation(duration_s), paper.spin(duration_s)
    attitudes = measured(nutation, paper.HALF_ANGLE_SD_RAD, seed=1)
    in_nutation = _filter_runs(nutation)
    in_spin = _filter_runs(spin)
    progress.add(1)
    arcs = arc_cases(ARC_S if duration_s == paper.DURATION_S else _QUICK_ARC_S)
    progress.add(1)
    return Study(
        title="Deng, Wang, Ge et al. 2024, rebuilt",
        lead="What attitudes alone make observable of a free body, and the filter on them.",
        headline=_headline(ranks, results),
        chapters=(
            Chapter("What is shown", _text(duration_s), (_verdict(ranks, in_spin, results),)),
            rank_chapter(ranks),
            filter_chapter(attitudes, in_nutation),
            spin_chapter(in_spin),
            consistency_chapter(results),
            arc_chapter(arcs, results[0]),
        ),
        summary_keys=("verdict", "ranks", "arcs"),
        pipelines={"deng2024": _pipeline(duration_s)},
        runs=runs,
    )


def monte_carlo_cases(runs: int, duration_s: float) -> list[Case]:
    """Nutation with a narrow and a wide prior, the filter from the guess, and the spin."""
    nutation = paper.nutation(duration_s, _MONTE_CARLO_INTERVAL_S)
    spin = paper.spin(duration_s, _MONTE_CARLO_INTERVAL_S)
    sd = _MONTE_CARLO_SD_DEG
    return [
        Case("nutation, ratios known to 0.05", nutation, 1.0, 0.05, sd, True, runs),
        Case("nutation, ratios known to 0.3", nutation, 5.0, 0.3, sd, True, runs),
        Case("spin, ratios known to 0.1", spin, 1.0, 0.1, sd, True, runs),
        Case("nutation, known to 0.05, filter alone", nutation, 1.0, 0.05, sd, False, runs),
        Case("nutation, known to 0.3, filter alone", nutation, 5.0, 0.3, sd, False, runs),
    ]


def _filter_runs(motion: paper.Motion) -> list[FilterRun]:
    exact = measured(motion, 0.0, seed=1)
    noisy = measured(motion, paper.HALF_ANGLE_SD_RAD, seed=1)
    return [
        printed_run("as printed, exact attitudes", motion, exact),
        printed_run("as printed, noise of R", motion, noisy),
        fitted_run("pcnav, noise of R", motion, noisy),
    ]


def _verdict(ranks: list[RankCase], spin: list[FilterRun], results: list[CaseResult]) -> TextTable:
    rows = []
    for case in ranks[:5]:
        expected = "11" if case.stated == "11" else "below 11; 8 by an independent computation"
        met = case.last.rank == (11 if case.stated == "11" else 8)
        rows.append((f"rank: {case.name}", expected, str(case.last.rank), "yes" if met else "no"))
    stuck = [int(np.sum(run.sd[-1, 6:] > 0.5 * run.sd[0, 6:])) for run in spin]
    rows.append(
        (
            "inertia ratios in the spin (Fig. 6)",
            "do not converge",
            f"{min(stuck)} to {max(stuck)} of 5 do not, by filter",
            "yes" if min(stuck) >= 1 else "no",
        )
    )
    for result in results[:3]:
        low, high = result.bounds
        mean = result.over(result.settled_from_s)
        rows.append(
            (
                f"NEES per state from {result.settled_from_s:g} s on: {result.case.name}",
                f"{low:.3f} to {high:.3f}",
                f"{mean:.3f}",
                "yes" if low <= mean <= high else "no",
            )
        )
    header = ("quantity", "expected", "ours", "met")
    return TextTable("verdict", "Expected against ours", header, tuple(rows), text_columns=4)


def _headline(ranks: list[RankCase], results: list[CaseResult]) -> tuple[tuple[str, str], ...]:
    by_name = {case.name: str(case.last.rank) for case in ranks}
    return (
        ("rank in nutation", f"{by_name['printed, nutation']} of 11"),
        ("rank in a spin", f"{by_name['printed, spin']} of 11"),
        ("NEES per state, nutation", number(results[0].over(results[0].settled_from_s))),
    )


def _text(duration_s: float) -> tuple[str, ...]:
    lines = [
        "The paper prints ranks and curves, no numbers of errors: shapes are compared. The state "
        "is printed with eleven components, Q as well, the transition matrix with an identity of "
        "eight: eleven is meant. The printed update adds vector parts of quaternions, right only "
        "near the identity; here, and in the filter called as printed, the error turns the "
        "estimate.",
    ]
    if duration_s < paper.DURATION_S:
        lines.append("Because of the few runs asked for, the motions were cut.")
    return tuple(lines)


def _pipeline(duration_s: float) -> Pipeline:
    xx, yy, xy, xz, yz = paper.NUTATION_RATIOS
    inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, 1.0]])
    a, b, c, d, e = ratios_from_inertia(inertia).tolist()
    x, y, z = paper.NUTATION_RATE_DEG_S
    return Pipeline(
        scenario=ScenarioTable(
            frames=round(duration_s / paper.INTERVAL_S) + 1, frame_rate_hz=1.0 / paper.INTERVAL_S
        ),
        body=BodyTable(omega_body_deg_s=(x, y, z), inertia_ratios=(a, b, c, d, e)),
    )
