"""Chapters of the study: percentiles of the plain filter, of the bank, and of the coupling."""

import numpy as np

from pcnav.core.arrays import FloatArray, IntArray
from pcnav.files.text_table import TextTable, number

from ..folder import Chapter, StudyFigure
from .campaign import CaseResult
from .figures import Panel, panels_figure, percentile_curves
from .monte_carlo import QUANTITIES

PLAIN, BANK = (50, 70, 90), (45, 50, 70, 90, 95)
"""Percentiles of Figs. 2, 3, 5, 6 and of Fig. 4."""
ATTITUDE = 2
_CURVES_ONLY = "The paper shows curves and prints no number; its axes are not in the text."
_DRAWN: IntArray = np.arange(5)
_NAMES = ("relative position", "translational velocity", "relative attitude", "angular velocity")


def plain_chapter(result: CaseResult, hypothesis: int, runs: int) -> Chapter:
    """Figs. 2 and 3: the filter that knows the true inertia, over the first runs."""
    errors = result.found.errors[:, :runs, hypothesis]
    time = result.motion.times_s
    nees = result.found.nees[:, :runs, hypothesis].mean(axis=1)
    rows = [
        (
            f"{time[k]:g}",
            *(number(float(v)) for q in range(5) for v in np.percentile(errors[k, :, q], PLAIN)),
            number(float(nees[k])),
        )
        for k in _some_frames(time)
    ]
    header = ("time, s", *(f"{name}: {p} %" for name in QUANTITIES for p in PLAIN), "mean NEES")
    table = TextTable(
        "plain",
        "Figs. 2 and 3: errors with the true inertia",
        header,
        tuple(rows),
        f"{runs} runs. {_CURVES_ONLY} Errors of the points are root mean squares over the ten. NEES"
        " is that of the 12 errors of the motion, 12 where the stated covariance is right; it falls"
        " below because the filters allow for disturbances that the truth does not have.",
    )
    return Chapter(
        "The filter that knows the inertia",
        (
            "Position and points begin with the prior of the mass centre and improve as the turn "
            "of the target shows what it turns about. Along the axis of rotation only the orbit "
            "shows it, and the attitude of the body axes within the points is seen through Euler's "
            "equation alone: both take the whole arc.",
        ),
        (table,),
        (
            _motion_figure("figure2", "Fig. 2", errors, time),
            _points_figure("figure3", errors, time),
        ),
    )


def _motion_figure(key: str, title: str, errors: FloatArray, time: FloatArray) -> StudyFigure:
    panels = [
        Panel(f"({letter}) {name}", QUANTITIES[q], percentile_curves(errors[..., q], PLAIN))
        for q, (letter, name) in enumerate(zip("abcd", _NAMES, strict=True))
    ]
    caption = f"Norms of the errors, percentiles over {errors.shape[1]} runs. {_CURVES_ONLY}"
    return panels_figure(key, title, caption, time, panels)


def _points_figure(key: str, errors: FloatArray, time: FloatArray) -> StudyFigure:
    panel = Panel("feature points", QUANTITIES[4], percentile_curves(errors[..., 4], PLAIN))
    caption = f"Root mean square error of the ten points. {_CURVES_ONLY}"
    return panels_figure(key, "Fig. 3", caption, time, [panel], columns=1)


def estimates_of(result: CaseResult) -> dict[str, FloatArray]:
    """(frames, runs, 5) errors of what can be made of five drawn hypotheses.

    Of the weighted mean, the last frame alone.
    """
    return {
        "random inertia": result.found.errors[:, :, 0],
        "bank, most probable": result.errors_of(result.picked(_DRAWN)),
        "bank, most probable by (12)": result.errors_of(result.picked(_DRAWN, printed=True)),
        "bank, weighted mean": result.found.blended[None],
    }


def bank_chapter(physical: CaseResult, printed: CaseResult, share: dict[str, float]) -> Chapter:
    """Fig. 4: five hypotheses against one of them chosen at random."""
    tables = [_bank_table("bank_physical", "physical", physical)]
    tables.append(_bank_table("bank_printed", "as printed", printed))
    figures = [_bank_figure("figure4", "Fig. 4", "physical draws", physical)]
    figures.append(_bank_figure("figure4_printed", "Fig. 4, draws as printed", "", printed))
    return Chapter(
        "The bank against a random inertia",
        (
            "The paper draws its five hypotheses as the true inertia plus a Wishart matrix of scale"
            " I I^T / 3 (17). The square of an inertia is some hundred times the inertia, so the "
            "hypotheses keep next to nothing of the truth, and "
            f"{number(100.0 * share['as printed'])} % of them are the inertia of a body at all. "
            "They are followed here as printed, for Euler's equation takes any positive definite "
            "matrix, and besides with scale I / 3, of which "
            f"{number(100.0 * share['physical'])} % are bodies and the others are drawn again. "
            "In both the truth is not among the five: what is left in the errors is the distance "
            "of the nearest hypothesis.",
            "The random inertia is the first of the same five draws, in the same run on the same "
            "pixels.",
        ),
        tuple(tables),
        tuple(figures),
    )


def _bank_table(key: str, draws: str, result: CaseResult) -> TextTable:
    rows = []
    for name, errors in estimates_of(result).items():
        for q, quantity in enumerate(QUANTITIES):
            values = np.percentile(errors[-1, :, q], BANK)
            rows.append((name, quantity, *(number(float(v)) for v in values)))
    return TextTable(
        key,
        f"Fig. 4: errors at the end of the arc, hypotheses drawn {draws}",
        ("estimate", "quantity", *(f"{p} %" for p in BANK)),
        tuple(rows),
        f"{result.runs} runs. The paper shows the attitude and states that the bank improves it; "
        "it prints no number.",
        text_columns=2,
    )


def _bank_figure(key: str, title: str, what: str, result: CaseResult) -> StudyFigure:
    estimates = estimates_of(result)
    panels = [
        Panel(
            heading,
            QUANTITIES[ATTITUDE],
            percentile_curves(estimates[name][..., ATTITUDE], BANK),
        )
        for heading, name in (
            ("(a) random inertia", "random inertia"),
            ("(b) bank", "bank, most probable"),
        )
    ]
    caption = f"Relative attitude over {result.runs} runs{', ' + what if what else ''}. "
    return panels_figure(key, title, caption + _CURVES_ONLY, result.motion.times_s, panels)


def coupling_chapter(
    results: dict[str, FloatArray], nees: dict[str, FloatArray], time: FloatArray
) -> Chapter:
    """Figs. 5 and 6: what the kinematic coupling does; errors (frames, runs, 5) by name."""
    rows = []
    for name, errors in results.items():
        for q, quantity in enumerate(QUANTITIES):
            values = np.percentile(errors[-1, :, q], PLAIN)
            rows.append((name, quantity, *(number(float(v)) for v in values)))
        mean = float(np.mean(nees[name][-1]))
        rows.append((name, "mean NEES (12 expected)", number(mean), "", ""))
    table = TextTable(
        "coupling",
        "Figs. 5 and 6: errors at the end of the arc with and without the coupling",
        ("filter", "quantity", *(f"{p} %" for p in PLAIN)),
        tuple(rows),
        "The paper shows curves and states that the coupling improves the position; it prints no "
        "number.",
        text_columns=2,
    )
    figures = []
    for q, (letter, label) in enumerate(
        zip(("5a", "5b", "5c", "5d", "6"), QUANTITIES, strict=True)
    ):
        panels = [
            Panel(name, label, percentile_curves(errors[..., q], PLAIN))
            for name, errors in results.items()
        ]
        caption = f"Percentiles over {errors.shape[1]} runs. {_CURVES_ONLY}"
        title = f"Fig. {letter}"
        figures.append(panels_figure(f"figure{letter}", title, caption, time, panels, len(panels)))
    return Chapter(
        "Kinematic coupling",
        (
            "Equation (25) is the second derivative of (2), with the lever arm from the mass centre"
            " where rho_i is printed: a filter that measures points of a rigid body through (2) "
            "has the coupling already, and (25) adds no physics to it. The paper does not say what "
            "its uncoupled filter leaves out. Two readings are compared with the coupled one.",
            "In the first the filter is exact, but its errors are those of mass centre velocity, "
            "rate and points in body axes, instead of those of the positions rho_i, which (25) "
            "moves, and of the field of velocities that they share. The difference is only in what "
            "the linearisation drops: products of the errors of mass centre, attitude and rate, "
            "which are far above the noise of the pixels. That filter takes their absence for "
            "knowledge, and its stated covariance is wrong by orders of magnitude.",
            "In the second there is no lever arm: the middle of the points is taken to move as the "
            "mass centre does, and rotation and translation are not coupled at all.",
        ),
        (table,),
        tuple(figures),
    )


def _some_frames(time: FloatArray) -> list[int]:
    last = len(time) - 1
    return sorted({0, min(1, last), *(round(part * last) for part in (0.1, 0.25, 0.5, 0.75, 1.0))})
