"""What the filter's runs come to: tables and figures, with what the paper states beside them."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pcnav.core.arrays import FloatArray
from pcnav.core.statistics import MeanSquared, mean_squared, root_mean_square
from pcnav.estimators.principal_axes.feature_states import (
    MOTION_SIZE,
    OMEGA,
    R_HILL,
    RATIOS,
    THETA,
    V_HILL,
)
from pcnav.files.text_table import TextTable
from pcnav.report.figures import ALERT, LINE

from ..folder import StudyFigure
from ..panels import Curve, Panel, Scale, mean_squared_panel, panels_figure
from ..tables import table, table_of
from . import paper
from .following import JudgedRun

_DEGREES = float(np.degrees(1.0))


@dataclass(frozen=True)
class Quantity:
    """A block of the state as tables and figures show it."""

    name: str
    """With its unit."""
    where: slice
    figure: str
    """Number and title."""
    labels: tuple[str, ...]
    """Of its components, with unit."""
    scale: float = 1.0
    """From SI."""

    def norms(self, run: JudgedRun) -> FloatArray:
        """(n,) of its errors."""
        return np.asarray(self.scale * np.linalg.norm(run.error[:, self.where], axis=1))

    def share_inside(self, runs: Sequence[JudgedRun]) -> float:
        """Of its errors with an estimate, inside three stated deviations."""
        error = np.concatenate([run.error[:, self.where] for run in runs])
        sd = np.concatenate([run.sd[:, self.where] for run in runs])
        known = np.isfinite(error)
        return float(np.mean(np.abs(error[known]) <= 3.0 * sd[known]))


def _xyz(unit: str) -> tuple[str, ...]:
    return tuple(f"{axis}, {unit}" for axis in "xyz")


ATTITUDE = Quantity("attitude, deg", THETA, "6: attitude error", _xyz("deg"), _DEGREES)
TURNING = (
    ATTITUDE,
    Quantity("rate, deg/s", OMEGA, "7: angular rate error", _xyz("deg/s"), _DEGREES),
    Quantity("inertia ratios p_x, p_z", RATIOS, "8: inertia ratio error", ("p_x", "p_z")),
)
QUANTITIES = (
    *TURNING,
    Quantity("position, m", R_HILL, "10: position error", _xyz("m")),
    Quantity("velocity, m/s", V_HILL, "11: velocity error", _xyz("m/s")),
)
_PAPER_SAYS = "converges, small about zero", "non-zero offsets that change over occlusions"


def error_figures(unique: JudgedRun, free: JudgedRun) -> list[StudyFigure]:
    """Figs. 6-11. Left: with the unique axes, in three stated deviations. Right: without."""
    found = [
        _figure(
            *(q.figure, q.labels, unique.time_s, q.scale * unique.error[:, q.where]),
            *(q.scale * unique.sd[:, q.where], q.scale * free.error[:, q.where]),
        )
        for q in QUANTITIES
    ]
    title, points = (
        "9: error of a feature's coordinates",
        (unique.point_error[:, 0], unique.point_sd[:, 0]),
    )
    found.append(_figure(title, _xyz("m"), unique.time_s, *points, free.point_error[:, 0]))
    return sorted(found, key=lambda figure: figure.key)


def _figure(
    numbered: str,
    labels: Sequence[str],
    time_s: FloatArray,
    unique: FloatArray,
    sd: FloatArray,
    free: FloatArray,
) -> StudyFigure:
    panels = []
    for k, label in enumerate(labels):
        left = Curve("unique axes", unique[:, k], colour=LINE)
        right = Curve("axes as they come", free[:, k], colour=ALERT)
        bands = {"3 sd stated": (-3.0 * sd[:, k], 3.0 * sd[:, k])}
        panels.append(Panel(label, [left], Scale.ABOUT_ZERO, bands=bands))
        panels.append(Panel("", [right], Scale.ABOUT_ZERO))
    number, title = numbered.split(": ")
    return panels_figure(
        f"fig{int(number):02d}",
        f"Fig. {number}: {title}",
        "Truth minus estimate. Grey: nothing is seen.",
        time_s,
        panels,
        columns=2,
        dark=paper.blackouts_s(),
    )


def last_table(
    key: str, title: str, ours: Sequence[JudgedRun], other: Sequence[JudgedRun] | None = None
) -> TextTable:
    """RMS errors over the last 50 s, all runs together."""
    from_s = float(ours[0].time_s[-1]) - paper.LAST_S
    values = [_last_errors(runs, from_s) for runs in (ours, other) if runs is not None]
    rows, header = [], ["error norm"]
    for name in values[0]:
        cells: list[object] = [name]
        for errors, paper_says in zip(values, _PAPER_SAYS, strict=False):
            cells += [root_mean_square(errors[name]), np.nanmax(errors[name])]
            cells += [paper_says] if other is not None else []
        rows.append(cells)
    if other is None:
        header += ["RMS", "largest"]
    else:
        for which in ("unique", "free"):
            header += [f"{which}: RMS", f"{which}: largest", "paper shows"]
    points = "Of the points the root mean square over them at each frame."
    note = f"{len(ours)} runs, t >= {from_s:g} s. {points}"
    return table(key, title, header, rows, note)


def _last_errors(runs: Sequence[JudgedRun], from_s: float) -> dict[str, FloatArray]:
    """All errors from a time on, by quantity."""

    def late(errors: Sequence[FloatArray]) -> FloatArray:
        return np.concatenate(
            [each[run.time_s >= from_s] for each, run in zip(errors, runs, strict=True)]
        )

    found = {q.name: late([q.norms(run) for run in runs]) for q in QUANTITIES}
    found["inertia ratio p_y"] = late([np.abs(run.middle_ratio_error) for run in runs])
    found["points, m"] = late([point_rms(run) for run in runs])
    return found


def point_rms(run: JudgedRun) -> FloatArray:
    """(n,) root mean square of the points' errors; nan before the start."""
    square = np.sum(run.point_error**2, axis=-1)
    known = np.isfinite(square)
    count = known.sum(axis=1)
    total = np.where(known, square, 0.0).sum(axis=1)
    mean = np.divide(total, count, out=np.full(len(total), np.nan), where=count > 0)
    return np.asarray(np.sqrt(mean), np.float64)


def blackout_table(runs: Sequence[JudgedRun]) -> TextTable:
    """How far the attitude drifts in the dark, and whether it returns."""

    def at(time_s: float) -> tuple[float, float]:
        rows = [min(int(np.searchsorted(run.time_s, time_s)), len(run.time_s) - 1) for run in runs]
        sd = [np.linalg.norm(run.sd[k, THETA]) for run, k in zip(runs, rows, strict=True)]
        error = [ATTITUDE.norms(run)[k] for run, k in zip(runs, rows, strict=True)]
        return float(np.median(error)), 3.0 * _DEGREES * float(np.median(sd))

    rows = [
        (
            f"{start:g} to {end:g} s",
            *(at(time_s) for time_s in (start - 0.5, end - 0.2, end + 1.0, end + 5.0)),
            "returns",
        )
        for start, end in paper.blackouts_s()
    ]
    header = ("blackout", "before", "at its end", "1 s after", "5 s after", "paper")
    note = f"Attitude error / three stated deviations (norms, deg), medians of {len(runs)} runs."
    return table("blackouts", "Through the blackouts", header, rows, note)


def inside_table(unique: Sequence[JudgedRun], free: Sequence[JudgedRun]) -> TextTable:
    """How many errors are within what is stated."""
    return table_of(
        "inside",
        "Share of the errors inside three stated deviations",
        QUANTITIES,
        {
            "quantity": lambda q: q.name,
            "unique axes": lambda q: percent(q.share_inside(unique)),
            "axes as they come": lambda q: percent(q.share_inside(free)),
            "expected": lambda q: "all / no",
        },
        "All components of all frames with an estimate.",
    )


def percent(share: float) -> str:
    """A share in words."""
    return f"{100.0 * share:.1f} %"


@dataclass(frozen=True)
class Consistency:
    """NEES of many runs."""

    time_s: FloatArray
    """(n,)"""
    whole: MeanSquared
    """(n,) of the whole state."""
    motion: MeanSquared
    """(n,) of its 14 components of motion and inertia."""

    @staticmethod
    def of(runs: Sequence[JudgedRun]) -> "Consistency":
        """Means over the runs at every time."""
        size = np.stack([run.size for run in runs])
        whole = mean_squared(np.stack([run.nees for run in runs]), size)
        motion = np.stack([run.motion_nees for run in runs])
        return Consistency(
            runs[0].time_s, whole, mean_squared(motion, np.minimum(size, MOTION_SIZE))
        )

    @property
    def share_inside(self) -> float:
        """Share of the times at which the whole state's mean is inside its bounds."""
        return float(np.mean(self.whole.inside[self.whole.values > 0]))

    def at(self, time_s: float) -> tuple[MeanSquared, MeanSquared]:
        """Of the whole state and of its motion, at the last time up to one."""
        k = int(np.searchsorted(self.time_s, time_s + 1e-9)) - 1
        return self.whole[k], self.motion[k]


_TABLE_TIMES_S = (15.0, 29.0, 49.0, 60.0, 79.0, 99.0, 129.0, 149.0, 175.0, 199.9)


def nees_figure(matched: Sequence[JudgedRun]) -> StudyFigure:
    """Of the whole state over time."""
    consistent = Consistency.of(matched)
    return panels_figure(
        "nees",
        "Consistency of the filter",
        f"Whole state, {len(matched)} runs. Grey: nothing is seen.",
        consistent.time_s,
        [mean_squared_panel("NEES over dof", consistent.whole)],
        row_in=2.1,
        dark=paper.blackouts_s(),
    )


def nees_table(matched: Sequence[JudgedRun], twice: Sequence[JudgedRun]) -> TextTable:
    """At some times, and what using the pixels twice does to it."""
    consistent, printed = Consistency.of(matched), Consistency.of(twice)
    return table_of(
        "nees",
        "Mean NEES per degree of freedom (95 % bounds)",
        _TABLE_TIMES_S,
        {
            "time": lambda t: f"{t:g} s",
            "whole state": lambda t: consistent.at(t)[0],
            "motion and inertia": lambda t: consistent.at(t)[1],
            "pixels used twice": lambda t: printed.at(t)[0].mean,
        },
        f"{len(matched)} runs; {len(twice)} with the pixels used twice, as printed.",
    )


def match_table(runs: Sequence[JudgedRun]) -> TextTable:
    """What became of wrong matches."""
    refused, used, right, wrong = np.sum([run.matches for run in runs], axis=0)
    rows = (
        ("wrong matches used", f"{used} of {wrong}"),
        ("right matches refused", f"{refused} of {right}"),
        ("mean NEES of the whole state, last frame", Consistency.of(runs).whole[-1]),
        ("runs that lost the target", sum("lost" in run.status for run in runs)),
    )
    note = f"{len(runs)} runs. Half of the wrong matches are another feature's pixels."
    return table("matches", "10 points, 10 % wrong matches", ("what", "ours"), rows, note)
