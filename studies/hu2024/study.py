"""The study of Hu 2024 as a list of verbs: identify, follow, compare, repeat, disturb."""

from pcnav.batch.engine import run_all
from pcnav.batch.monte_carlo import Case, Run, run_seed, runs_of
from pcnav.files.text_table import TextTable, number

from ..folder import Chapter, Study
from ..progress import Progress
from ..work import Work
from . import paper
from .chapters import (
    Consistency,
    Rmse,
    consistency_chapter,
    consistency_of,
    filter_chapter,
    identification_chapter,
    inside_share,
    rmse_of,
)
from .following import BLOCKS, JudgedRun, run_case
from .identification import IdentificationBatch, IdentificationErrors, Method, run_identification

RUNS = paper.IDENTIFICATION_RUNS
_BATCH = 125
"""Identification runs at once."""
_BATCH_UNITS = 5.0
"""A full batch takes as long as so many runs of the filter."""
_PER_FILTER_RUN, _PER_FIGURE_RUN, _PER_FAULT_RUN = 5, 50, 25
"""Identification runs for one run of the filter, of Figs. 6-11, with faults."""
_FEWEST = 2


def study(runs: int, work: Work) -> Study:
    """Rebuild Figs. 5-11.

    ``runs`` are those of every noise level of Fig. 5, a fifth of them test the filter's
    consistency. Raises `InputError` when the shipped pipeline is missing or bad, `RunError` when a
    run fails.
    """
    batches = _batches(runs)
    planned = _planned(runs)
    units = _BATCH_UNITS * runs * len(paper.LEVELS_RAD) / _BATCH
    progress = Progress(round(units) + len(planned), work.on_progress)
    share = units / len(batches)
    # The longest work first, so that no core waits for the last of it.
    identified = run_all(run_identification, batches, work.workers, lambda: progress.add(share))
    judged = run_all(run_case, planned, work.workers, lambda: progress.add(1.0))
    by_case: dict[str, list[JudgedRun]] = {}
    for run in judged:
        by_case.setdefault(run.case, []).append(run)
    return _study(identified, by_case, runs)


def _batches(count: int) -> list[IdentificationBatch]:
    seeds = [run_seed(paper.NAME, index) for index in range(count)]
    return [
        IdentificationBatch(level, tuple(seeds[start : start + _BATCH]))
        for level in paper.LEVELS_RAD
        for start in range(0, count, _BATCH)
    ]


def _planned(count: int) -> list[Run[str]]:
    """The filter's runs; all cases meet the same points and noise as far as they go."""

    def some(per: int, *names: str) -> list[Run[str]]:
        cases = [Case(name, name) for name in names]
        return runs_of(paper.NAME, cases, max(_FEWEST, count // per))

    return [
        *some(_PER_FILTER_RUN, "matched"),
        *some(_PER_FAULT_RUN, "wrong matches", "pixels used twice"),
        *some(_PER_FIGURE_RUN, "unique axes", "free axes"),
    ]


def _study(
    identified: list[IdentificationErrors], by_case: dict[str, list[JudgedRun]], count: int
) -> Study:
    rmse = rmse_of(identified)
    matched, unique, free = (by_case[name] for name in ("matched", "unique axes", "free axes"))
    wrong = by_case["wrong matches"]
    consistent = consistency_of(matched)
    return Study(
        title="Hu, Wu, Meng and Wu 2024, rebuilt",
        lead="Relative Motion Estimation Algorithm for Noncooperative Targets Considering Multiple "
        "Solutions of Rotational Parameters: every figure, with what the paper states of it.",
        headline=_headline(rmse, unique, consistent),
        chapters=(
            Chapter("What is shown", (), (_verdict(rmse, by_case, consistent), _settings())),
            identification_chapter(rmse, count),
            filter_chapter(unique, free),
            consistency_chapter(matched, wrong, by_case["pixels used twice"]),
        ),
        summary_keys=("verdict", "fig06_11"),
        pipelines={paper.NAME: paper.pipeline()},
        runs=count,
    )


def _headline(
    rmse: Rmse, unique: list[JudgedRun], consistent: Consistency
) -> tuple[tuple[str, str], ...]:
    levels = sorted(rmse.by_level)
    best, worst = (rmse.by_level[level][Method.ARC][-1] for level in (levels[0], levels[-1]))
    where, _ = BLOCKS["attitude, deg"]
    return (
        ("RMSE of the axes after 30 s, deg", f"{number(best)} to {number(worst)}"),
        ("attitude inside 3 sd, unique axes", f"{100.0 * inside_share(unique, where):.1f} %"),
        ("NEES at the end", str(consistent.whole[-1])),
    )


def _verdict(rmse: Rmse, by_case: dict[str, list[JudgedRun]], consistent: Consistency) -> TextTable:
    unique, free = by_case["unique axes"], by_case["free axes"]
    wrong = by_case["wrong matches"]
    least = min(inside_share(unique, where) for where, _ in BLOCKS.values())
    turning = [BLOCKS[name][0] for name in tuple(BLOCKS)[:3]]
    most = max(inside_share(free, where) for where in turning)
    used = sum(run.accepted_wrong for run in wrong) / max(sum(run.wrong for run in wrong), 1)
    whole, motion = consistent.whole[-1], consistent.motion[-1]
    falls, rises = rmse.falls(Method.ARC), rmse.rises_with_noise(Method.ARC)
    rows = (
        ("RMSE of the axes falls with time", "all four levels", _yes(falls), _yes(falls)),
        ("RMSE of the axes rises with noise", "all four levels", _yes(rises), _yes(rises)),
        (
            "errors inside 3 sd with unique axes",
            "all",
            f"{100.0 * least:.1f} % of the worst quantity",
            _yes(least > 0.99),
        ),
        (
            "errors inside 3 sd without: attitude, rate, ratios",
            "no: offsets",
            f"{100.0 * most:.1f} % of the best quantity",
            _yes(most < 0.9),
        ),
        ("NEES at the end, whole state", "not printed", str(whole), _yes(_inside(whole.verdict))),
        ("NEES at the end, motion", "not printed", str(motion), _yes(_inside(motion.verdict))),
        (
            "times with the NEES inside",
            "not printed",
            f"{100.0 * consistent.share_inside():.0f} %",
            _yes(consistent.share_inside() >= 0.9),
        ),
        ("wrong matches used", "not printed", f"{100.0 * used:.2f} %", _yes(used < 0.01)),
    )
    return TextTable(
        "verdict",
        "What the paper claims, and what was asked beyond",
        ("quantity", "paper", "ours", "met"),
        rows,
        text_columns=4,
    )


def _inside(verdict: str) -> bool:
    return verdict == "inside"


def _yes(met: bool) -> str:
    return "yes" if met else "no"


def _settings() -> TextTable:
    dark = ", ".join(f"{start:g} to {end:g} s" for start, end in paper.blackouts_s())
    rows = (
        ("baseline of the rig", "not printed", f"{paper.pipeline().stereo.baseline_m:g} m"),
        (
            "pointing of the rig",
            "not printed",
            "at the target: the printed velocity carries it past the chaser at 5 m and 180 m away",
        ),
        (
            "resolution in Figs. 6-11",
            "one of four, not said which",
            f"{paper.resolution_rad():g} rad",
        ),
        ("times of the blackouts", "in a figure; 20 s each", dark),
        ("disturbance force", "2e-6 m^2/s^4", "2e-6 m^2/s^3 as a power spectral density"),
        ("disturbance torque", "2.5e-5 rad^2/s^4", "2.5e-5 rad^2/s^3 likewise, scaled by (22)"),
        ("truth", "not said", "without disturbance in Figs. 5-11"),
        (
            "inertia ratios in the state",
            "p_x, p_y, p_z",
            "p_x and p_z; p_y follows from them",
        ),
        (
            "measurements",
            "attitude and points, of the same pixels",
            "the pixels, each once",
        ),
        (
            "signs of the axes",
            "x axis only",
            "x and y axes: with one sign two frames are left",
        ),
    )
    return TextTable(
        "settings",
        "Settings that are open or changed",
        ("setting", "paper", "ours"),
        rows,
        text_columns=3,
    )
