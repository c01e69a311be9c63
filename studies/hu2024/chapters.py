"""What the runs come to: tables and figures, with what the paper states or shows beside them."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pcnav.core.arrays import BoolArray, FloatArray
from pcnav.core.statistics import MeanSquared, mean_squared
from pcnav.files.text_table import TextTable, number

from ..folder import Chapter
from . import paper
from .figures import Errors, errors_figure, nees_figure, rmse_figure
from .following import BLOCKS, JudgedRun
from .identification import REPORT_S, IdentificationErrors, Method


@dataclass(frozen=True)
class Rmse:
    """Fig. 5 in numbers."""

    by_level: dict[float, dict[Method, FloatArray]]
    """(report times,) RMSE in degrees by resolution (rad) and method."""

    def falls(self, method: Method) -> bool:
        """Whether every level falls from its first report to its last."""
        return all(
            bool(curves[method][-1] < curves[method][0]) for curves in self.by_level.values()
        )

    def rises_with_noise(self, method: Method) -> bool:
        """Whether at the last report more noise is a larger error."""
        last = [self.by_level[level][method][-1] for level in sorted(self.by_level)]
        return bool(np.all(np.diff(last) > 0.0))


def rmse_of(results: Sequence[IdentificationErrors]) -> Rmse:
    """RMSE (45) over all runs of each level."""
    found: dict[float, dict[Method, FloatArray]] = {}
    for level in sorted({result.resolution_rad for result in results}):
        same = [result for result in results if result.resolution_rad == level]
        found[level] = {
            method: np.degrees(
                np.sqrt(np.concatenate([each.squared[method] for each in same]).mean(axis=0))
            )
            for method in Method
        }
    return Rmse(found)


def identification_chapter(rmse: Rmse, runs: int) -> Chapter:
    """Fig. 5."""
    figures = tuple(
        rmse_figure(
            f"fig05_{key}",
            f"Fig. 5: attitude of the identified principal axes, {method}",
            f"RMSE (45) over {runs} runs per level, for arcs from the first frame on.",
            np.array(REPORT_S),
            {f"{level:g} rad": curves[method] for level, curves in rmse.by_level.items()},
        )
        for key, method in (("arc", Method.ARC), ("printed", Method.PRINTED))
    )
    tables = tuple(
        _rmse_table(key, method, rmse, runs)
        for key, method in (("fig05", Method.ARC), ("fig05_printed", Method.PRINTED))
    )
    return Chapter(
        "Identification of the principal axes (Fig. 5)",
        (
            "Each run draws its own six points and noise; the target turns without torque. Of the "
            "axes of (17) print fixes the order and one sign; here the second sign is fixed as "
            "well, or half of all comparisons would be half a turn off. As printed, three points "
            "make the frame (6), rates are its differentiated attitude and enter the least "
            "squares (13) as regressors without error: at 10 Hz a triangulated triangle is so "
            "noisy that this takes the whole arc, where it works at all. Fitting the torque-free "
            "rotation to the attitudes of all points needs neither rates nor a triangle.",
            "The baseline is not printed; 1 m is taken. The level of all curves depends on it.",
        ),
        tables,
        figures,
    )


def _rmse_table(key: str, method: Method, rmse: Rmse, runs: int) -> TextTable:
    rows = [
        (
            f"{level:g} rad",
            *(number(value) for value in curves[method]),
            "falls" if curves[method][-1] < curves[method][0] else "does not fall",
            "falls within a few seconds, before the first occlusion; more noise, larger error",
        )
        for level, curves in rmse.by_level.items()
    ]
    header = ("resolution", *(f"{t:g} s" for t in REPORT_S), "ours over time", "paper (Fig. 5)")
    return TextTable(
        key,
        f"Fig. 5: RMSE of the attitude, deg ({method})",
        header,
        tuple(rows),
        f"{runs} runs per level.",
    )


def filter_chapter(unique: list[JudgedRun], free: list[JudgedRun]) -> Chapter:
    """Figs. 6-11."""
    first, other = unique[0], free[0]
    tables = (
        last_table(
            "fig06_11", "Errors over the last 50 s, with and without unique axes", unique, free
        ),
        blackout_table(unique),
        _inside_table(unique, free),
    )
    figures = tuple(
        errors_figure(first.time_s, other.time_s, errors) for errors in _figure_errors(first, other)
    )
    return Chapter(
        "The filter with and without unique axes (Figs. 6-11)",
        (
            "The printed process noise, and a truth that moves without disturbance: the paper does "
            "not say that its truth is disturbed, and with a torque of the printed size the order "
            "of the two smaller moments could not be told in 200 s. The filter is then too "
            "cautious, not wrong: its deviations cover the printed torque, and over 20 s without "
            "features they grow to some 20 degrees. It rightly calls its axes ambiguous for as "
            "long as that torque could account for the difference of the moments.",
            "Without unique axes the filter takes them as the eigen-decomposition hands them out, "
            "anew where features re-appear. Attitude, rate, ratios and points then jump from one "
            "of the 24 solutions to another, as the paper shows. Position and velocity do not: "
            "each of the 24 tells the same motion. The paper's do, because its filter is fed an "
            "attitude that contradicts its state.",
        ),
        tables,
        figures,
    )


def _figure_errors(first: JudgedRun, other: JudgedRun) -> list[Errors]:
    names = {
        "attitude, deg": ("fig06", "Fig. 6: attitude error", ("x, deg", "y, deg", "z, deg")),
        "rate, deg/s": (
            "fig07",
            "Fig. 7: angular rate error",
            ("x, deg/s", "y, deg/s", "z, deg/s"),
        ),
        "inertia ratios p_x, p_z": ("fig08", "Fig. 8: inertia ratio error", ("p_x", "p_z")),
        "position, m": ("fig10", "Fig. 10: position error", ("x, m", "y, m", "z, m")),
        "velocity, m/s": ("fig11", "Fig. 11: velocity error", ("x, m/s", "y, m/s", "z, m/s")),
    }
    found = []
    for block, (key, title, labels) in names.items():
        where, scale = BLOCKS[block]
        found.append(
            Errors(
                *(key, title, labels, scale * first.error[:, where]),
                *(scale * first.sd[:, where], scale * other.error[:, where]),
            )
        )
    found.append(
        Errors(
            *("fig09", "Fig. 9: error of a feature's coordinates", ("x, m", "y, m", "z, m")),
            *(first.point_error[:, 0], first.point_sd[:, 0], other.point_error[:, 0]),
        )
    )
    return sorted(found, key=lambda errors: errors.key)


_PAPER_SAYS = (
    "converges, small about zero",
    "non-zero offsets that change over occlusions",
)


def last_table(
    key: str, title: str, ours: list[JudgedRun], other: list[JudgedRun] | None = None
) -> TextTable:
    """RMS errors over the last 50 s, all runs together."""
    columns = [ours] if other is None else [ours, other]
    rows = []
    for name, values in _last_values(columns).items():
        row = [name]
        for errors, paper_says in zip(values, _PAPER_SAYS, strict=False):
            row += [number(float(np.sqrt(np.nanmean(errors**2)))), number(float(np.nanmax(errors)))]
            if other is not None:
                row.append(paper_says)
        rows.append(tuple(row))
    header: tuple[str, ...] = ("error norm", "RMS", "largest")
    if other is not None:
        header = (
            *("error norm", "unique: RMS", "unique: largest", "paper shows"),
            *("free: RMS", "free: largest", "paper shows"),
        )
    return TextTable(
        key,
        title,
        header,
        tuple(rows),
        f"{len(ours)} runs, t >= {_from(ours[0]):g} s. Of the points the root mean square over "
        "them at each frame.",
    )


def _from(run: JudgedRun) -> float:
    return float(run.time_s[-1]) - paper.LAST_S


def _last_values(columns: list[list[JudgedRun]]) -> dict[str, list[FloatArray]]:
    found: dict[str, list[FloatArray]] = {}
    for runs in columns:
        last = [run.time_s >= _from(run) for run in runs]
        for name, (where, scale) in BLOCKS.items():
            errors = [scale * run.block(where)[at] for run, at in zip(runs, last, strict=True)]
            found.setdefault(name, []).append(np.concatenate(errors))
        middle = [np.abs(run.middle_ratio_error[at]) for run, at in zip(runs, last, strict=True)]
        found.setdefault("inertia ratio p_y", []).append(np.concatenate(middle))
        points = [point_rms(run)[at] for run, at in zip(runs, last, strict=True)]
        found.setdefault("points, m", []).append(np.concatenate(points))
    return found


def point_rms(run: JudgedRun) -> FloatArray:
    """(n,) root mean square of the points' errors; nan before the start."""
    square = np.sum(run.point_error**2, axis=-1)
    known = np.isfinite(square)
    count = known.sum(axis=1)
    total = np.where(known, square, 0.0).sum(axis=1)
    mean = np.divide(total, count, out=np.full(len(total), np.nan), where=count > 0)
    return np.asarray(np.sqrt(mean), np.float64)


def blackout_table(runs: list[JudgedRun]) -> TextTable:
    """How far the attitude drifts in the dark, and whether it returns."""
    where, scale = BLOCKS["attitude, deg"]
    rows = []
    for start, end in paper.blackouts_s():
        moments = (start - 0.5, end - 0.2, end + 1.0, end + 5.0)
        cells = []
        for moment in moments:
            pairs = [(run, _frame_at(run, moment)) for run in runs]
            error = np.median([scale * run.block(where)[at] for run, at in pairs])
            sd = np.median([scale * np.linalg.norm(run.sd[at, where]) for run, at in pairs])
            cells.append(f"{number(float(error))} / {number(3.0 * float(sd))}")
        rows.append((f"{start:g} to {end:g} s", *cells, "returns"))
    header = ("blackout", "before", "at its end", "1 s after", "5 s after", "paper")
    note = f"Attitude error / three stated deviations (norms, deg), medians of {len(runs)} runs."
    return TextTable("blackouts", "Through the blackouts", header, tuple(rows), note)


def _frame_at(run: JudgedRun, time_s: float) -> int:
    return min(int(np.searchsorted(run.time_s, time_s)), len(run.time_s) - 1)


def _inside_table(unique: list[JudgedRun], free: list[JudgedRun]) -> TextTable:
    rows = [
        (
            name,
            *(f"{100.0 * inside_share(runs, where):.1f} %" for runs in (unique, free)),
            "all / no",
        )
        for name, (where, _) in BLOCKS.items()
    ]
    return TextTable(
        "inside",
        "Share of the errors inside three stated deviations",
        ("quantity", "unique axes", "axes as they come", "expected"),
        tuple(rows),
        "All components of all frames with an estimate.",
    )


def inside_share(runs: list[JudgedRun], where: slice) -> float:
    """Of a block's errors with an estimate, inside three stated deviations."""
    inside = np.concatenate([_inside(run, where) for run in runs])
    return float(inside.mean())


def _inside(run: JudgedRun, where: slice) -> BoolArray:
    known = np.isfinite(run.error[:, 0])
    return np.asarray(
        np.abs(run.error[known, where]) <= 3.0 * run.sd[known, where], dtype=np.bool_
    ).ravel()


@dataclass(frozen=True)
class Consistency:
    """NEES of many runs."""

    time_s: FloatArray
    whole: list[MeanSquared]
    """Per time, of the whole state."""
    motion: list[MeanSquared]
    """Of its 14 components of motion and inertia."""

    def share_inside(self) -> float:
        """Share of the times at which the whole state's mean is inside its bounds."""
        judged = [each for each in self.whole if each.values]
        return sum(each.verdict == "inside" for each in judged) / max(len(judged), 1)

    def at(self, time_s: float) -> tuple[MeanSquared, MeanSquared]:
        """Of the whole state and of its motion, at the last time up to one."""
        k = int(np.searchsorted(self.time_s, time_s + 1e-9)) - 1
        return self.whole[k], self.motion[k]


def consistency_of(runs: list[JudgedRun]) -> Consistency:
    """Mean NEES over the runs at every time."""
    nees, motion, size = (
        np.stack([getattr(run, name) for run in runs]) for name in ("nees", "motion_nees", "size")
    )
    degrees = np.nan_to_num(size)
    return Consistency(
        runs[0].time_s,
        [mean_squared(nees[:, k], degrees[:, k]) for k in range(nees.shape[1])],
        [mean_squared(motion[:, k], np.minimum(degrees[:, k], 14.0)) for k in range(nees.shape[1])],
    )


_TABLE_TIMES_S = (15.0, 29.0, 49.0, 60.0, 79.0, 99.0, 129.0, 149.0, 175.0, 199.9)


def consistency_chapter(
    matched: list[JudgedRun], wrong: list[JudgedRun], twice: list[JudgedRun]
) -> Chapter:
    """Beyond the paper: NEES, wrong matches, and the printed double use of the pixels."""
    consistent = consistency_of(matched)
    lower, upper = (
        np.array([getattr(each, name) for each in consistent.whole]) for name in ("lower", "upper")
    )
    figure = nees_figure(
        "nees",
        "Consistency of the filter",
        f"Whole state, {len(matched)} runs. Grey: nothing is seen.",
        consistent.time_s,
        np.array([each.mean for each in consistent.whole]),
        (lower, upper),
    )
    return Chapter(
        "Beyond the paper: consistency, wrong matches",
        (
            "For a test of the covariances truth and filter must mean the same disturbances: here "
            f"both have {paper.CALM:g} of the printed ones, at which the conservation of momentum "
            "that (10) asks for holds over the first arc. Torque and force are white; every run "
            "draws its points, disturbances and noise.",
            "In print the filter takes points and the attitude made of the same points as "
            "independent, and the identified axes as exact: the last table shows what its "
            "covariances are then worth.",
        ),
        (
            _nees_table(consistent, consistency_of(twice), len(matched), len(twice)),
            last_table("matched", "Errors over the last 50 s, matched disturbances", matched),
            _match_table(wrong),
            last_table(
                "wrong_matches", "Errors over the last 50 s, 10 points, 10 % wrong matches", wrong
            ),
        ),
        (figure,),
    )


def _nees_table(
    consistent: Consistency, twice: Consistency, runs: int, runs_twice: int
) -> TextTable:
    rows = []
    for time in _TABLE_TIMES_S:
        whole, motion = consistent.at(time)
        rows.append((f"{time:g} s", str(whole), str(motion), number(float(twice.at(time)[0].mean))))
    header = ("time", "whole state", "motion and inertia", "pixels used twice")
    return TextTable(
        "nees",
        "Mean NEES per degree of freedom (95 % bounds)",
        header,
        tuple(rows),
        f"{runs} runs; {runs_twice} with the pixels used twice, as printed.",
    )


def _match_table(runs: list[JudgedRun]) -> TextTable:
    right, wrong = sum(run.right for run in runs), sum(run.wrong for run in runs)
    used = sum(run.accepted_wrong for run in runs)
    refused = sum(run.rejected_right for run in runs)
    consistent = consistency_of(runs)
    rows = (
        ("wrong matches used", f"{used} of {wrong}"),
        ("right matches refused", f"{refused} of {right}"),
        ("mean NEES of the whole state, last frame", str(consistent.whole[-1])),
        ("runs that lost the target", str(sum("lost" in run.status for run in runs))),
    )
    return TextTable(
        "matches",
        "10 points, 10 % wrong matches",
        ("what", "ours"),
        rows,
        f"{len(runs)} runs. Half of the wrong matches are another feature's pixels.",
    )
