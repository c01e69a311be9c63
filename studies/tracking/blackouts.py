"""Blackouts: frames without returns in the middle of a track, and what becomes of it."""

from dataclasses import dataclass
from functools import partial

import numpy as np

from pcnav.batch.cluster import Workers
from pcnav.batch.engine import run_all
from pcnav.batch.monte_carlo import Case, Run, runs_of
from pcnav.core.arrays import FloatArray
from pcnav.dynamics.state import COM_MODEL, INERTIA_RATIOS
from pcnav.files.text_table import TextTable, number
from pcnav.simulation.random_truth import Spread, random_truth, satellite
from pcnav.simulation.scene import Scene

from ..folder import Chapter, StudyFigure
from ..progress import Progress
from .bars import NONE, Bar, at, joined, mean_squared
from .figures import coasting_figure
from .following import JudgedRun, follow, status_sequence
from .starts import RIGHT_FRACTION, RIGHT_RAD

NAME = "blackouts"
DURATIONS_S = (5, 20, 60)
_FRAME_RATE_HZ = 2.0
_SPREAD = Spread(range_m=(15.0, 30.0), rate_deg_s=(1.0, 5.0), speed_m_s=0.02)
_RELOCK_BAR = 3
_GROWTH_BAR = 1.1
"""A deviation that grows no more than this over a blackout was not forgotten."""
_MASS = np.r_[COM_MODEL, INERTIA_RATIOS]


@dataclass(frozen=True)
class Phases:
    """How many frames are tracked before the blackout, and given after it."""

    before: int = 40
    after: int = 20

    def frames(self, duration_s: int) -> int:
        """Of a whole run."""
        return self.before + self.blind(duration_s) + self.after

    def blind(self, duration_s: int) -> int:
        """Of the blackout."""
        return round(duration_s * _FRAME_RATE_HZ)


@dataclass(frozen=True)
class Blackout:
    """One run with a blackout."""

    duration_s: int
    seed: int
    phases: Phases
    run: JudgedRun

    @property
    def last_seen(self) -> int:
        """Index of the last frame before the blackout."""
        return self.phases.before - 1

    @property
    def last_blind(self) -> int:
        """Index of the last frame of it."""
        return self.last_seen + self.phases.blind(self.duration_s)

    @property
    def relocked(self) -> int | None:
        """Frames with returns until one is called locked or ambiguous and is right."""
        run, first = self.run, self.last_blind + 1
        diameter_m = satellite("boxsat").target.diameter_m
        right = (run.attitude_rad < RIGHT_RAD) & (run.position_m < RIGHT_FRACTION * diameter_m)
        found = np.flatnonzero((run.claims & right)[first:])
        return int(found[0]) + 1 if found.size else None

    @property
    def growth(self) -> FloatArray:
        """(8,) deviation of mass centre and ratios at the re-lock over that before; nan without."""
        if self.relocked is None:
            return np.full(len(_MASS), np.nan)
        variance = np.diagonal(self.run.covariance, axis1=1, axis2=2)[:, _MASS]
        return np.asarray(
            np.sqrt(variance[self.last_blind + self.relocked] / variance[self.last_seen])
        )


@dataclass(frozen=True)
class BlackoutResult:
    """All blackouts and what they come to."""

    chapter: Chapter
    bars: tuple[Bar, ...]
    blackouts: tuple[Blackout, ...]


def run_blackout(duration_s: int, seed: int, phases: Phases | None = None) -> Blackout:
    """One blackout in a track of boxsat: truth and noise are the seed's."""
    phases = phases or Phases()
    of = satellite("boxsat")
    frames = phases.frames(duration_s)
    truth = random_truth(of, _SPREAD, seed, frames=frames, frame_rate_hz=_FRAME_RATE_HZ)
    blind = range(phases.before, phases.before + phases.blind(duration_s))
    run = follow(Scene.of(truth, of.target.mesh), of.target, blind=blind)
    return Blackout(duration_s, seed, phases, run)


def _run(run: Run[int], phases: Phases) -> Blackout:
    return run_blackout(run.case.settings, run.seed, phases)


def planned_blackouts(count: int) -> list[Run[int]]:
    """So many runs of every duration."""
    return runs_of(NAME, [Case(f"{duration} s", duration) for duration in DURATIONS_S], count)


def blackout_chapter(
    runs: list[Run[int]], phases: Phases, workers: Workers, progress: Progress
) -> BlackoutResult:
    """Run the blackouts and lay them out."""
    seen = phases.before + phases.after
    blackouts = run_all(partial(_run, phases=phases), runs, workers, lambda: progress.add(seen))
    of = {d: [b for b in blackouts if b.duration_s == d] for d in DURATIONS_S}
    chapter = Chapter(
        "Blackouts",
        _text(phases),
        (_summary_table(of), _run_table(blackouts)),
        tuple(_figure(own[0]) for own in of.values()),
    )
    bars = tuple(bar for duration, own in of.items() for bar in _bars(duration, own))
    return BlackoutResult(chapter, bars, tuple(blackouts))


def _bars(duration_s: int, blackouts: list[Blackout]) -> tuple[Bar, ...]:
    nees = mean_squared(_last_nees(blackouts), 6)
    relocked = [blackout.relocked for blackout in blackouts]
    soon = sum(frames is not None and frames <= _RELOCK_BAR for frames in relocked)
    growths = np.array([blackout.growth.max() for blackout in blackouts])
    kept = bool(np.all(growths <= _GROWTH_BAR))
    return (
        Bar(
            NAME,
            f"{duration_s} s: pose NEES over dof at the end of coasting",
            f"<= {number(nees.upper)}",
            number(nees.mean),
            nees.values == len(blackouts) and nees.mean <= nees.upper,
        ),
        Bar(
            NAME,
            f"{duration_s} s: right again within {_RELOCK_BAR} frames",
            "all",
            f"{soon} of {len(blackouts)}",
            soon == len(blackouts),
        ),
        Bar(
            NAME,
            f"{duration_s} s: deviation of mass centre and ratios, after over before",
            f"<= {_GROWTH_BAR:g}",
            number(at(100, growths)),
            kept,
        ),
    )


def _last_nees(blackouts: list[Blackout]) -> FloatArray:
    return np.array([blackout.run.pose_nees[blackout.last_blind] for blackout in blackouts])


def _summary_table(of: dict[int, list[Blackout]]) -> TextTable:
    rows = []
    for duration_s, blackouts in of.items():
        ends = np.array([_end(blackout) for blackout in blackouts])
        relocked = [b.relocked for b in blackouts if b.relocked is not None]
        growth = np.array([blackout.growth.max() for blackout in blackouts])
        rows.append(
            (
                f"{duration_s} s",
                str(len(blackouts)),
                str(mean_squared(_last_nees(blackouts), 6)),
                *(joined(*(at(50, ends[:, k]) for k in pair)) for pair in ((0, 1), (2, 3))),
                f"{len(relocked)}",
                str(max(relocked)) if relocked else NONE,
                number(at(100, growth)),
            )
        )
    header = (
        "blackout",
        "runs",
        "pose NEES over dof (95 % bounds)",
        "position, mm",
        "attitude, deg",
        "right again",
        "frames",
        "sd after over before",
    )
    return TextTable(
        "blackouts",
        "Coasting through blackouts",
        header,
        tuple(rows),
        "NEES and errors in the last frame without returns. Position and attitude: error / 3 "
        "stated deviations, medians over the runs of the norms. Right again: runs that come to be "
        "called locked or ambiguous within 5 degrees and 5 % of the diameter, and the frames with "
        "returns that the slowest of them took. The last column, the largest of all runs, "
        "compares the deviations of mass centre and inertia ratios at that frame with those just "
        "before the blackout: a restart from zero would bring the prior's back.",
    )


def _end(blackout: Blackout) -> tuple[float, float, float, float]:
    """Position error and 3 sd (mm), attitude error and 3 sd (deg) at the end of coasting."""
    run, k = blackout.run, blackout.last_blind
    variance = np.diag(run.pose_covariance[k])
    return (
        1e3 * float(run.position_m[k]),
        3e3 * float(np.sqrt(variance[:3].sum())),
        float(np.rad2deg(run.attitude_rad[k])),
        float(np.rad2deg(3.0 * np.sqrt(variance[3:].sum()))),
    )


def _run_table(blackouts: list[Blackout]) -> TextTable:
    rows = []
    for blackout in blackouts:
        run, end = blackout.run, _end(blackout)
        sd = np.sqrt(np.diagonal(run.covariance, axis1=1, axis2=2))
        mass = []
        for block, scale in ((COM_MODEL, 1e3), (INERTIA_RATIOS, 1.0)):
            norms = scale * np.linalg.norm(sd[:, block], axis=1)
            after = np.nan
            if blackout.relocked is not None:
                after = float(norms[blackout.last_blind + blackout.relocked])
            mass.append(joined(float(norms[blackout.last_seen]), after))
        rows.append(
            (
                f"{blackout.duration_s} s",
                str(blackout.seed),
                number(float(run.pose_nees[blackout.last_blind]) / 6.0),
                joined(*end[:2]),
                joined(*end[2:]),
                NONE if blackout.relocked is None else str(blackout.relocked),
                *mass,
                status_sequence(run.status),
            )
        )
    header = (
        "blackout",
        "seed",
        "NEES over dof",
        "position, mm",
        "attitude, deg",
        "frames",
        "mass centre, mm",
        "ratios",
        "statuses",
    )
    return TextTable(
        "blackout_runs",
        "Every blackout",
        header,
        tuple(rows),
        "Position and attitude: error / 3 sd at the end of coasting. Frames: with returns until "
        "right again. Mass centre and ratios: stated deviation (norm) before / then. One run "
        "alone: studies.tracking.blackouts.run_blackout(duration_s, seed).",
        text_columns=2,
    )


def _figure(blackout: Blackout) -> StudyFigure:
    run = blackout.run
    dark = run.time_s[blackout.last_seen + 1], run.time_s[blackout.last_blind]
    return coasting_figure(
        f"blackout_{blackout.duration_s:02d}s",
        f"Pose error through a blackout of {blackout.duration_s} s",
        "Model origin (camera axes) and attitude (body axes), first run. Grey: no returns.",
        run.time_s,
        run.pose_error,
        np.sqrt(np.diagonal(run.pose_covariance, axis1=1, axis2=2)),
        (float(dark[0]), float(dark[1])),
    )


def _text(phases: Phases) -> tuple[str, ...]:
    return (
        f"Boxsat at 15 to 30 m, tumbling at 1 to 5 deg/s, {_FRAME_RATE_HZ:g} Hz: {phases.before} "
        f"frames, then none with a return for the length of the blackout, then {phases.after} "
        "with returns. While nothing returns the tracker can only predict; its covariance must "
        "then cover the truth, and the first frames after it must be understood from the "
        "prediction, with mass centre and inertia ratios kept.",
    )
