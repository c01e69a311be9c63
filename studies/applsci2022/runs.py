"""The runs of the study: which tracks and which chain, their errors, and tables of them."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from pcnav.batch.monte_carlo import Case, Run
from pcnav.config.image_motion import ImageMotionTable, MatchSolver, Reference, Smoothing
from pcnav.core.arrays import FloatArray, IntArray, joined
from pcnav.core.spatial import log_rotation
from pcnav.core.statistics import mean, root_mean_square
from pcnav.estimators.image_motion.chain import ChainFrame, run_chain
from pcnav.estimators.image_motion.rates import rotation_history
from pcnav.estimators.image_motion.relative import Outcome
from pcnav.evaluation.consistency import squared_normalised_errors
from pcnav.files.text_table import TextTable
from pcnav.report.panels import Curve, Panel, Scale, panels_figure
from pcnav.simulation.images import TrackFaults

from ..folder import StudyFigure
from ..tables import table, table_of
from . import paper
from .scene import Truth, nutation, tracks_of

STUDY = "applsci2022"

PRINTED = ImageMotionTable(
    solver=MatchSolver.EIGHT_POINT, reference=Reference.ADJACENT, smoothing=Smoothing.NONE
)
ADJACENT = ImageMotionTable(reference=Reference.ADJACENT)
"""A frame whose turn is too small waits for the next: the step grows until it is certain."""
EVERY_FRAME = ADJACENT.model_copy(
    update={"min_significance": 0.0, "ambiguous_chi_square": 0.0, "max_sd_deg": 180.0}
)
"""Without key frames and without waiting."""
KEY_FRAMES = ImageMotionTable(reference=Reference.KEY_FRAME)
GUARDED = {"robust, last certain": ADJACENT, "robust, key frames": KEY_FRAMES}
CHAINS = {"as printed": PRINTED, "robust, every frame": EVERY_FRAME, **GUARDED}


@dataclass(frozen=True)
class Chained:
    """Tracks and what is made of them."""

    chain: ImageMotionTable
    faults: TrackFaults
    interval_s: float
    duration_s: float
    points: int = paper.POINTS

    @property
    def times_s(self) -> FloatArray:
        """Of the frames of a run."""
        return paper.frame_times(self.duration_s, self.interval_s)

    def case(self, name: str) -> Case["Chained"]:
        """By name; its work is the frames."""
        return Case(name, self, len(self.times_s))

    def frames(self, seed: int) -> tuple[Truth, Sequence[ChainFrame]]:
        """Simulate and chain."""
        truth = nutation(self.duration_s, self.interval_s, seed, self.points)
        return truth, run_chain(tracks_of(truth, self.faults, seed), self.chain)


NOISES = {f"{noise:g} px": TrackFaults(noise) for noise in (0.0, 0.1, 0.5)}
FAULTS = {
    "tracks of 15 s": TrackFaults(0.1, mean_tracked_s=15.0),
    "20 % wrong": TrackFaults(0.1, wrong_match_fraction=0.2),
}


def chain_cases(faults: Mapping[str, TrackFaults], duration_s: float) -> list[Case[Chained]]:
    """Printed and robust chains on tracks of several kinds."""
    return [
        Chained(chain, tracks, paper.INTERVAL_S, duration_s).case(f"{name}, {what}")
        for what, tracks in faults.items()
        for name, chain in CHAINS.items()
    ]


def interval_cases(duration_s: float) -> list[Case[Chained]]:
    """The effect of the time between frames, at 0.1 px."""
    return [
        Chained(chain, NOISES["0.1 px"], each_s, duration_s).case(f"{name}, {each_s:g} s")
        for each_s in (0.5, 2.0, 5.0, 10.0)
        for name, chain in {"as printed": PRINTED, **GUARDED}.items()
    ]


def run_case(run: Run[Chained]) -> "ChainErrors":
    """Simulate, chain, compare: attitudes of the first segment, and their rates."""
    case = run.case.settings
    truth, frames = case.frames(run.seed)
    angle, sd, nees, rate = np.full((4, 1, len(frames)), np.nan)
    known = {
        k: (log_rotation(frame.R_world_body.T @ truth.R_world_body[k]), frame.covariance)
        for k, frame in enumerate(frames)
        if k > 0 and frame.segment == 0 and frame.R_world_body is not None
    }
    if known:
        at: IntArray = np.array(list(known))
        theta, P = (np.array(each) for each in zip(*known.values(), strict=True))
        angle[0, at] = np.rad2deg(np.linalg.norm(theta, axis=1))
        sd[0, at] = np.rad2deg(np.sqrt(np.trace(P, axis1=1, axis2=2)))
        nees[0, at] = squared_normalised_errors(theta, P) / 3.0
    history = rotation_history(frames, case.chain)
    first = history.segment == 0
    at = history.frames[first]
    off = history.omega_body[first] - truth.omega_body[at]
    rate[0, at] = np.rad2deg(np.linalg.norm(off, axis=1))
    outcomes = Counter(frame.outcome for frame in frames)
    return ChainErrors(run.case, angle, rate, sd, nees, outcomes)


@dataclass(frozen=True)
class ChainErrors:
    """Runs of a case against the truth at n frames; nan where the first segment is not."""

    case: Case[Chained]
    angle_deg: FloatArray
    """(runs, n)"""
    rate_deg_s: FloatArray
    """(runs, n)"""
    sd_deg: FloatArray
    """(runs, n) stated of the attitude, root of the trace."""
    nees: FloatArray
    """(runs, n) of the attitude per degree of freedom."""
    outcomes: Counter[Outcome]
    """Frames by what became of them."""

    @staticmethod
    def of(runs: Sequence["ChainErrors"]) -> "ChainErrors":
        """All runs of a case."""
        outcomes = sum((run.outcomes for run in runs), Counter[Outcome]())
        return replace(joined(runs), outcomes=outcomes)

    @property
    def times_s(self) -> FloatArray:
        """(n,)"""
        return self.case.settings.times_s

    @property
    def share(self) -> float:
        """Of the frames after the first that have an attitude of the first segment."""
        return float(np.mean(np.isfinite(self.angle_deg[:, 1:])))

    @property
    def rate_rms(self) -> float:
        """deg/s, after the first tenth."""
        return root_mean_square(self.rate_deg_s[:, self.times_s > 0.1 * self.times_s[-1]])

    def error_to(self, part: float, window_s: float = 5.0) -> float:
        """RMS attitude error, deg, in so many seconds up to a part of the run."""
        return self._rms_to(self.angle_deg, part, window_s)

    @property
    def error_at_end(self) -> float:
        """RMS attitude error, deg, in the last 10 s."""
        return self._rms_to(self.angle_deg, 1.0, 10.0)

    @property
    def sd_at_end(self) -> float:
        """RMS of the stated deviation, deg, likewise."""
        return self._rms_to(self.sd_deg, 1.0, 10.0)

    def curve(self) -> Curve:
        """RMS over the runs, deg, by the name of the chain."""
        values = np.array([root_mean_square(column) for column in self.angle_deg.T])
        name = self.case.name.rsplit(",", 1)[0]
        return Curve(name, values[1:], self.times_s[1:], ".-")

    def _rms_to(self, values: FloatArray, part: float, window_s: float) -> float:
        end_s = part * float(self.times_s[-1])
        near = (self.times_s <= end_s + 1e-9) & (self.times_s > end_s - window_s - 1e-9)
        return root_mean_square(values[:, near])


def errors_table(key: str, found: Sequence[ChainErrors]) -> TextTable:
    """Attitude and rate of every case."""
    end = found[0].times_s[-1]
    return table_of(
        key,
        found,
        {
            "chain": lambda each: each.case.name,
            "interval, s": lambda each: f"{each.case.settings.interval_s:g}",
            "frames with an attitude": lambda each: f"{each.share:.0%}",
            f"error to {end / 6:g} s, deg": lambda each: each.error_to(1.0 / 6.0),
            f"to {end / 2:g} s, deg": lambda each: each.error_to(0.5),
            f"to {end:g} s, deg": lambda each: each.error_at_end,
            "stated, deg": lambda each: each.sd_at_end,
            "NEES per dof": lambda each: mean(each.nees),
            "rate, deg/s": lambda each: each.rate_rms,
        },
    )


def outcomes_table(key: str, found: Sequence[ChainErrors]) -> TextTable:
    """Frames by what became of them, all runs together; only outcomes that occur have a column."""
    occurring = [what for what in Outcome if any(each.outcomes[what] for each in found)]
    rows = ((each.case.name, *(each.outcomes[what] for what in occurring)) for each in found)
    header = ("chain", *(what.value.replace("_", " ") for what in occurring))
    return table(f"{key}_outcomes", header, rows)


def growth_figure(key: str, found: Sequence[ChainErrors], whats: Sequence[str]) -> StudyFigure:
    """Errors over time of all chains, one panel for each of the tracks by the end of their name."""
    panels = []
    for what in whats:
        curves = [each.curve() for each in found if each.case.name.endswith(f", {what}")]
        panels.append(Panel("deg", curves, Scale.LOG, what))
    return StudyFigure(key, panels_figure(found[0].times_s, panels, row_in=1.9))
