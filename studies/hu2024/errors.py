"""What the filter's runs come to: tables and figures, with what the paper states beside them."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pcnav.core.arrays import FloatArray
from pcnav.core.statistics import MeanSquared, mean_squared, root_mean_square
from pcnav.estimators.principal_axes.feature_states import (
    PA_MOTION_SIZE,
    PA_OMEGA,
    PA_R_HILL,
    PA_RATIOS,
    PA_THETA,
    PA_V_HILL,
)
from pcnav.files.text_table import TextTable
from pcnav.report.figures import ALERT, LINE
from pcnav.report.panels import Curve, Panel, Scale, panels_figure

from ..blocks import ShownBlock
from ..folder import StudyFigure
from ..panels import mean_squared_panel
from ..tables import table, table_of
from . import paper
from .following import Judged

_DEGREES = float(np.degrees(1.0))


@dataclass(frozen=True)
class Quantity(ShownBlock):
    """A block of the state as tables and figures show it."""

    figure: str
    """Key of its figure."""
    components: str = "xyz"

    @property
    def labels(self) -> list[str]:
        """Of its components, with unit."""
        if self.unit == "1":
            return [f"p_{letter}" for letter in self.components]
        return [f"{letter}, {self.unit}" for letter in self.components]

    def norms(self, runs: Judged) -> FloatArray:
        """(runs, n) of its errors."""
        return np.asarray(np.linalg.norm(self.shown(runs.error), axis=-1))

    def share_inside(self, runs: Judged, label_free: bool = False) -> float:
        """Of its errors with an estimate, inside three stated deviations; or of its errors
        whatever the axes are called."""
        error = (runs.label_free if label_free else runs.error)[..., self.rows]
        sd = runs.sd[..., self.rows]
        known = np.isfinite(error)
        return float(np.mean(np.abs(error[known]) <= 3.0 * sd[known]))


ATTITUDE = Quantity("attitude", PA_THETA, "deg", _DEGREES, "fig06")
TURNING = (
    ATTITUDE,
    Quantity("rate", PA_OMEGA, "deg/s", _DEGREES, "fig07"),
    Quantity("inertia ratios p_x, p_z", PA_RATIOS, "1", 1.0, "fig08", "xz"),
)
QUANTITIES = (
    *TURNING,
    Quantity("position", PA_R_HILL, "m", 1.0, "fig10"),
    Quantity("velocity", PA_V_HILL, "m/s", 1.0, "fig11"),
)
_PAPER_SAYS = "converges, small about zero", "non-zero offsets that change over occlusions"


def error_figures(unique: Judged, free: Judged) -> list[StudyFigure]:
    """Figs. 6-11 of the first run. Left: with the unique axes, in three stated deviations. Right:
    without."""
    point = (each[0, :, 0] for each in (unique.point_error, unique.point_sd, free.point_error))
    found = [_figure("fig09", ["x, m", "y, m", "z, m"], unique.time_s, *point)]
    for q in QUANTITIES:
        shown = (q.shown(each[0]) for each in (unique.error, unique.sd, free.error))
        found.append(_figure(q.figure, q.labels, unique.time_s, *shown))
    return found


def _figure(
    key: str,
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
    return StudyFigure(key, panels_figure(time_s, panels, columns=2, dark=paper.blackouts_s()))


def last_from_s(runs: Judged) -> float:
    """From when on errors are told in the tables."""
    return float(runs.time_s[-1]) - paper.LAST_S


def comparison_table(key: str, unique: Judged, free: Judged) -> TextTable:
    """RMS errors over the last 50 s, all runs together, with and without unique axes."""
    rows = []
    for (name, ours), other in zip(_late(unique).items(), _late(free).values(), strict=True):
        row: list[object] = [name]
        for errors, paper_says in zip((ours, other), _PAPER_SAYS, strict=True):
            row += [root_mean_square(errors), np.nanmax(errors), paper_says]
        rows.append(row)
    columns = [
        title
        for which in ("unique", "free")
        for title in (f"{which}: RMS", f"{which}: largest", "paper shows")
    ]
    return table(key, ("error norm", *columns), rows)


def last_table(key: str, runs: Judged) -> TextTable:
    """RMS errors over the last 50 s, all runs together."""
    return table_of(
        key,
        _late(runs).items(),
        {
            "error norm": lambda each: each[0],
            "RMS": lambda each: root_mean_square(each[1]),
            "largest": lambda each: np.nanmax(each[1]),
        },
    )


def _late(runs: Judged) -> dict[str, FloatArray]:
    """(runs, ...) norms of errors over the last 50 s, by quantity."""
    late = runs.time_s >= last_from_s(runs)
    found = {q.label: q.norms(runs) for q in QUANTITIES}
    found["inertia ratio p_y"] = np.abs(runs.middle_ratio_error)
    square = np.ma.masked_invalid(np.sum(runs.point_error**2, axis=-1))
    found["points, m"] = np.sqrt(square.mean(axis=-1).filled(np.nan))
    return {name: norms[:, late] for name, norms in found.items()}


def blackout_table(runs: Judged) -> TextTable:
    """How far the attitude drifts in the dark, and whether it returns."""

    def at(time_s: float) -> tuple[float, float]:
        k = min(int(np.searchsorted(runs.time_s, time_s)), len(runs.time_s) - 1)
        sd = np.linalg.norm(ATTITUDE.shown(runs.sd[:, k]), axis=1)
        return float(np.median(ATTITUDE.norms(runs)[:, k])), 3.0 * float(np.median(sd))

    rows = [
        (
            f"{start:g} to {end:g} s",
            *(at(time_s) for time_s in (start - 0.5, end - 0.2, end + 1.0, end + 5.0)),
            "returns",
        )
        for start, end in paper.blackouts_s()
    ]
    header = ("blackout", "before", "at its end", "1 s after", "5 s after", "paper")
    return table("blackouts", header, rows)


def inside_table(unique: Judged, free: Judged) -> TextTable:
    """How many errors are within what is stated."""
    return table_of(
        "inside",
        QUANTITIES,
        {
            "quantity": lambda q: q.label,
            "unique axes": lambda q: percent(q.share_inside(unique)),
            "axes as they come": lambda q: percent(q.share_inside(free)),
            "these, whatever they are called": lambda q: percent(q.share_inside(free, True)),
        },
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
    def of(runs: Judged) -> "Consistency":
        """Means over the runs at every time."""
        motion = mean_squared(runs.motion_nees, np.minimum(runs.size, PA_MOTION_SIZE))
        return Consistency(runs.time_s, mean_squared(runs.nees, runs.size), motion)

    @property
    def share_inside(self) -> float:
        """Share of the times at which the whole state's mean is inside its bounds."""
        return float(np.mean(self.whole.inside[self.whole.values > 0]))

    def at(self, time_s: float) -> tuple[MeanSquared, MeanSquared]:
        """Of the whole state and of its motion, at the last time up to one."""
        k = int(np.searchsorted(self.time_s, time_s + 1e-9)) - 1
        return self.whole[k], self.motion[k]


_TABLE_TIMES_S = (15.0, 29.0, 49.0, 60.0, 79.0, 99.0, 129.0, 149.0, 175.0, 199.9)


def nees_figure(consistent: Consistency) -> StudyFigure:
    """Of the whole state over time."""
    panel = mean_squared_panel("NEES over dof", consistent.whole)
    dark = paper.blackouts_s()
    return StudyFigure("nees", panels_figure(consistent.time_s, [panel], row_in=2.1, dark=dark))


def nees_table(consistent: Consistency, twice: Consistency) -> TextTable:
    """At some times, and what using the pixels twice does to it."""
    return table_of(
        "nees",
        _TABLE_TIMES_S,
        {
            "time": lambda t: f"{t:g} s",
            "whole state": lambda t: consistent.at(t)[0],
            "motion and inertia": lambda t: consistent.at(t)[1],
            "pixels used twice": lambda t: twice.at(t)[0].mean,
        },
    )


def match_table(runs: Judged) -> TextTable:
    """What became of wrong matches."""
    refused, used, right, wrong = runs.matches.sum(axis=0)
    rows = (
        ("wrong matches used", f"{used} of {wrong}"),
        ("right matches refused", f"{refused} of {right}"),
        ("mean NEES of the whole state, last frame", Consistency.of(runs).whole[-1]),
        ("runs that lost the target", runs.lost.sum()),
    )
    return table("matches", ("what", "ours"), rows)
