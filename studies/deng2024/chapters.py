"""The chapters on the filter: Figs. 2-6 and its consistency."""

import numpy as np

from pcnav.core.arrays import FloatArray
from pcnav.estimators.attitude_inertia.rotation_model import INERTIA, OMEGA, THETA
from pcnav.evaluation.observability.told import ROTATION
from pcnav.files.text_table import TextTable, number

from ..folder import Chapter, StudyFigure
from ..panels import Panel, Scale, curves_of, panels_figure
from . import paper
from .consistency import CaseResult
from .curves import Row, truth_figure
from .filters import FilterRun, continuous

RATIO_NAMES = ROTATION.names[INERTIA]
_DEGREES = float(np.degrees(1.0))


def filter_chapter(measured: FloatArray, runs: list[FilterRun]) -> Chapter:
    """Figs. 2-5: attitudes measured (n, 3, 3), then estimates of quaternion, rate and ratios."""
    motion = runs[0].motion
    truth_q = continuous(motion.R_world_body)
    seen_q = continuous(measured)
    ratios = np.array(motion.ratios)
    times_s = motion.times_s
    measured_rows = [Row(f"q{k + 1}", truth_q[:, k], {"measured": seen_q[:, k]}) for k in range(4)]
    quaternion_rows = [
        Row(f"q{k + 1}", truth_q[:, k], {run.name: run.quaternion_xyzw[:, k] for run in runs})
        for k in range(4)
    ]
    rate_rows = [
        Row(
            f"rate {axis}, deg/s",
            _DEGREES * motion.omega_body[:, k],
            {run.name: _DEGREES * run.omega_body[:, k] for run in runs},
        )
        for k, axis in enumerate("xyz")
    ]
    figures = (
        _figure("fig2", "Fig. 2 b: measured quaternion", times_s, measured_rows),
        _figure("fig3", "Fig. 3: quaternion", times_s, quaternion_rows),
        _figure("fig4", "Fig. 4: angular rate", times_s, rate_rows),
        _figure("fig5", "Fig. 5: inertia ratios", times_s, _ratio_rows(ratios, runs)),
    )
    text = (
        "The paper shows that all states converge to the truth, the ratios last. Q and R are "
        "printed without units; the interval of the attitudes, the length of the run and the "
        "first covariance are not printed. Q lets the ratios wander by a few hundredths at every "
        "step, which bounds how well they can be known however long one looks.",
    )
    table = _error_table("fig3to5", runs)
    return Chapter("Filter in nutation (Figs. 2-5)", text, (table,), figures)


def spin_chapter(runs: list[FilterRun]) -> Chapter:
    """Fig. 6."""
    motion = runs[0].motion
    ratios = np.array(motion.ratios)
    drawn = _ratio_rows(ratios, runs)
    figure = _figure("fig6", "Fig. 6: inertia ratios in a spin", motion.times_s, drawn)
    rows = []
    for run in runs:
        for k, name in enumerate(RATIO_NAMES):
            error, sd = run.errors[-1, INERTIA][k], run.sd[:, INERTIA][:, k]
            verdict = "converges" if sd[-1] < 0.25 * sd[0] else "does not converge"
            numbers = tuple(number(float(value)) for value in (error, sd[0], sd[-1]))
            rows.append((run.name, name, verdict, *numbers))
    table = TextTable(
        "fig6",
        "Inertia ratios at the end of the spin",
        ("filter", "ratio", "by its own sd", "error", "sd at the start", "sd at the end"),
        tuple(rows),
        text_columns=3,
    )
    text = (
        "The paper shows ratios that do not converge. By rank three of the five cannot: of a spin "
        "about y, Jxy and Jyz show, the other three stay where the first guess put them.",
    )
    return Chapter("Filter in a spin (Fig. 6)", text, (table,), (figure,))


def consistency_chapter(results: list[CaseResult]) -> Chapter:
    """NEES of many runs."""
    rows = []
    for result in results:
        low, high = result.bounds
        case = result.case
        rows.append(
            (
                case.name,
                "whole arc, then filter" if case.whole_arc_start else "filter from the guess",
                number(result.over(0.0)),
                number(result.over(result.settled_from_s)),
                f"{low:.3f} to {high:.3f}",
                f"{100.0 * result.share_inside(result.settled_from_s):.0f} %",
                f"{float(np.max(np.median(result.nees, axis=1))) / 11.0:.2f}",
            )
        )
    runs = results[0].case.runs
    table = TextTable(
        "nees",
        f"NEES per state of {runs} runs",
        (
            "case",
            "start",
            "mean, all times",
            f"mean from {results[0].settled_from_s:g} s on",
            "95 % bounds",
            f"inside from {results[0].settled_from_s:g} s on",
            "largest median",
        ),
        tuple(rows),
        "1 is right. The bounds are those of the mean over the runs at one time. The median of a "
        "right NEES is 0.94 per state.",
        text_columns=2,
    )
    first = results[0]
    fitted = {r.case.name: r.mean_nees for r in results if r.case.whole_arc_start}
    times_s = first.case.motion.times_s
    bounds = np.full((2, len(times_s)), np.array(first.bounds)[:, None])
    figure = panels_figure(
        "nees",
        "NEES per state",
        "Of the filters that start with a fit of the whole arc.",
        times_s,
        [
            Panel(
                "NEES per state",
                curves_of(fitted),
                Scale.FROM_ZERO,
                bands={"95 % bounds": (bounds[0], bounds[1])},
            )
        ],
        row_in=2.3,
    )
    text = (
        "The inertia enters the motion nonlinearly and is hardly known at first: a filter that "
        "starts from the guess, as printed, drops terms above its noise and ends sure of a wrong "
        "inertia. pcnav fits the young arc as one. While the ratios are still uncertain by more "
        "than some hundredths the posterior is curved, which no covariance tells: a few runs lie "
        "above the bounds then, and with them the mean.",
        "In a spin the covariance stays somewhat too small. The estimate wobbles a little, by "
        "noise, and a filter that linearises there takes the wobble for one that tells the "
        "ratios: at the estimate the rank is 11.",
    )
    return Chapter("Consistency", text, (table,), (figure,))


def _figure(key: str, title: str, time_s: FloatArray, rows: list[Row]) -> StudyFigure:
    return truth_figure(key, title, "Broad: truth.", time_s, rows)


def _ratio_rows(truth: FloatArray, runs: list[FilterRun]) -> list[Row]:
    return [
        Row(
            name,
            np.full(len(runs[0].motion.times_s), truth[k]),
            {run.name: run.ratios[:, k] for run in runs},
        )
        for k, name in enumerate(RATIO_NAMES)
    ]


def _error_table(key: str, runs: list[FilterRun]) -> TextTable:
    rows = tuple(
        (
            run.name,
            "converge, the ratios last",
            number(_DEGREES * run.rms(THETA)),
            number(_DEGREES * run.rms(OMEGA)),
            number(run.rms(INERTIA)),
            number(float(np.max(np.abs(run.errors[-1, INERTIA])))),
        )
        for run in runs
    )
    return TextTable(
        key,
        "Errors over the second half of the run",
        (
            "filter",
            "paper",
            "attitude RMS, deg",
            "rate RMS, deg/s",
            "ratios RMS",
            "largest of a ratio at the end",
        ),
        rows,
        f"Attitudes every {paper.INTERVAL_S:g} s for {paper.DURATION_S:g} s.",
        text_columns=2,
    )
