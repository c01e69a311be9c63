"""The runs of the study: which tracks and which chain, and their errors."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from pcnav.batch.cluster import Workers
from pcnav.batch.engine import run_all
from pcnav.batch.monte_carlo import run_seed
from pcnav.config.image_motion import ImageMotionTable, MatchSolver, Reference, Smoothing
from pcnav.core.arrays import BoolArray, FloatArray
from pcnav.core.spatial import log_rotation
from pcnav.estimators.image_motion.chain import ChainFrame, run_chain
from pcnav.estimators.image_motion.rates import rotation_history
from pcnav.evaluation.metrics import squared_normalised_errors
from pcnav.simulation.images import TrackFaults

from ..progress import Progress
from . import paper
from .scene import Truth, nutation, tracks_of

STUDY = "applsci2022"
MIN_SIGMA_PX = 1e-3
"""Noise that a chain assumes of tracks without any."""

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
class Case:
    """Runs of one kind."""

    name: str
    chain: ImageMotionTable
    faults: TrackFaults
    interval_s: float = paper.INTERVAL_S
    duration_s: float = paper.DURATION_S

    @property
    def frames(self) -> int:
        """Of a run."""
        return round(self.duration_s / self.interval_s) + 1


@dataclass(frozen=True)
class Task:
    """One run."""

    case: Case
    seed: int

    def __str__(self) -> str:
        return f"{self.case.name} (seed {self.seed})"


@dataclass(frozen=True)
class ChainErrors:
    """One run against the truth."""

    attitude: FloatArray
    """(n, 3) theta, rad; nan where there is no attitude, and in later segments."""
    rate: FloatArray
    """(n, 3) rad/s; nan likewise."""
    sd: FloatArray
    """(n,) stated, root of the trace, rad."""
    nees: FloatArray
    """(n,) per degree of freedom."""
    outcomes: dict[str, int]
    segments: int


@dataclass(frozen=True)
class CaseErrors:
    """All runs of a case."""

    case: Case
    times_s: FloatArray
    angle_deg: FloatArray
    """(runs, n)"""
    rate_deg_s: FloatArray
    """(runs, n)"""
    sd_deg: FloatArray
    """(runs, n)"""
    nees: FloatArray
    """(runs, n)"""
    outcomes: dict[str, int]
    segments: int
    """Of all runs."""

    @property
    def share(self) -> float:
        """Of the frames after the first that have an attitude of the first segment."""
        return float(np.mean(np.isfinite(self.angle_deg[:, 1:])))

    def rms_near(self, time_s: float, window_s: float = 5.0) -> float:
        """RMS attitude error, deg, within so many seconds up to a time."""
        return _rms(self.angle_deg[:, self._near(time_s, window_s)])

    def sd_near(self, time_s: float, window_s: float = 5.0) -> float:
        """RMS of the stated deviation, deg, likewise."""
        return _rms(self.sd_deg[:, self._near(time_s, window_s)])

    @property
    def rate_rms(self) -> float:
        """deg/s, after the first tenth."""
        return _rms(self.rate_deg_s[:, self.times_s > 0.1 * self.times_s[-1]])

    @property
    def mean_nees(self) -> float:
        """Over the runs and frames; frames of one run are not independent."""
        known = self.nees[np.isfinite(self.nees)]
        return float(known.mean()) if known.size else np.nan

    def curve(self) -> FloatArray:
        """(n,) RMS over the runs, deg."""
        found = [_rms(column) for column in self.angle_deg.T]
        return np.array(found)

    def _near(self, time_s: float, window_s: float) -> BoolArray:
        return np.asarray(
            (self.times_s <= time_s + 1e-9) & (self.times_s > time_s - window_s - 1e-9)
        )


def run_task(task: Task) -> ChainErrors:
    """Simulate, chain, compare."""
    truth = nutation(task.case.duration_s, task.case.interval_s, task.seed)
    tracks = tracks_of(truth, task.case.faults, task.seed)
    sigma = max(task.case.faults.pixel_sigma_px, MIN_SIGMA_PX)
    chain = task.case.chain.model_copy(update={"pixel_sigma_px": sigma})
    return errors_of(run_chain(tracks, chain), truth, chain)


def errors_of(
    frames: Sequence[ChainFrame], truth: Truth, settings: ImageMotionTable
) -> ChainErrors:
    """Errors of the attitudes of the first segment and of all rates."""
    count = len(frames)
    attitude, rate = np.full((count, 3), np.nan), np.full((count, 3), np.nan)
    sd, nees = np.full(count, np.nan), np.full(count, np.nan)
    for k, frame in enumerate(frames):
        if frame.R_world_body is None or frame.covariance is None or frame.segment != 0 or k == 0:
            continue
        attitude[k] = log_rotation(frame.R_world_body.T @ truth.R_world_body[k])
        sd[k] = np.sqrt(np.trace(frame.covariance))
        squared = squared_normalised_errors(attitude[k : k + 1], frame.covariance[None])
        nees[k] = float(squared[0]) / 3.0
    history = rotation_history(frames, settings)
    first = history.segment == 0
    at = history.frames[first]
    rate[at] = history.omega_body[first] - truth.omega_body[at]
    outcomes = Counter(frame.outcome.value for frame in frames)
    return ChainErrors(attitude, rate, sd, nees, dict(outcomes), frames[-1].segment + 1)


def run_cases(
    cases: Sequence[Case], runs: int, workers: Workers, progress: Progress
) -> list[CaseErrors]:
    """All runs of all cases over processes; every case meets the same points and noise."""
    tasks = [Task(case, run_seed(STUDY, index)) for case in cases for index in range(runs)]
    costs = iter([task.case.frames for task in tasks])
    found = run_all(run_task, tasks, workers, lambda: progress.add(next(costs)))
    return [_joined(case, found[k * runs : (k + 1) * runs]) for k, case in enumerate(cases)]


def work_of(cases: Sequence[Case], runs: int) -> int:
    """Frames in all."""
    return sum(case.frames for case in cases) * runs


def noise_cases(duration_s: float) -> list[Case]:
    """Printed and robust chains at three noises."""
    return [
        Case(f"{name}, {noise:g} px", chain, TrackFaults(noise), duration_s=duration_s)
        for noise in (0.0, 0.1, 0.5)
        for name, chain in CHAINS.items()
    ]


def fault_cases(duration_s: float) -> list[Case]:
    """Tracks that end, and wrong matches."""
    short = TrackFaults(0.1, mean_tracked_s=15.0)
    wrong = TrackFaults(0.1, wrong_match_fraction=0.2)
    return [
        Case(f"{name}, {what}", chain, faults, duration_s=duration_s)
        for what, faults in (("tracks of 15 s", short), ("20 % wrong", wrong))
        for name, chain in CHAINS.items()
    ]


def interval_cases(duration_s: float) -> list[Case]:
    """The effect of the time between frames, at 0.1 px."""
    made = []
    for interval_s in (0.5, 2.0, 5.0, 10.0):
        for name, chain in {"as printed": PRINTED, **GUARDED}.items():
            case = Case(f"{name}, {interval_s:g} s", chain, TrackFaults(0.1), interval_s)
            made.append(replace(case, duration_s=duration_s))
    return made


def _joined(case: Case, found: Sequence[ChainErrors]) -> CaseErrors:
    outcomes: Counter[str] = Counter()
    for each in found:
        outcomes.update(each.outcomes)
    return CaseErrors(
        case,
        np.arange(case.frames, dtype=np.float64) * case.interval_s,
        np.rad2deg(np.linalg.norm([each.attitude for each in found], axis=-1)),
        np.rad2deg(np.linalg.norm([each.rate for each in found], axis=-1)),
        np.rad2deg([each.sd for each in found]),
        np.array([each.nees for each in found]),
        dict(outcomes),
        sum(each.segments for each in found),
    )


def _rms(values: FloatArray) -> float:
    known = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(known**2))) if known.size else np.nan
