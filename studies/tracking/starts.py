"""Cold starts: how soon, how often right and at what cost a lock is made of nothing."""

from collections import Counter
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from pcnav.batch.cluster import Workers
from pcnav.batch.engine import run_all
from pcnav.batch.monte_carlo import Case, Run, runs_of
from pcnav.files.text_table import TextTable, number
from pcnav.runs.status import Status
from pcnav.simulation.random_truth import Spread, random_truth, satellite
from pcnav.simulation.scene import Scene
from pcnav.target.symmetry import group_name

from ..folder import Chapter
from ..progress import Progress
from .bars import NONE, Bar, at, joined, numbers, share
from .figures import StartCurve, start_figures
from .following import follow

NAME = "cold starts"
SATELLITES = ("boxsat", "cubesat6u", "twinwing")
FRAMES = 5
_FRAME_RATE_HZ = 5.0
_SPREAD = Spread(range_m=(10.0, 30.0), rate_deg_s=(0.0, 20.0), speed_m_s=0.02)
"""Of `boxsat`; lengths go with the diameter for the others."""
RIGHT_RAD = float(np.deg2rad(5.0))
RIGHT_FRACTION = 0.05
"""A lock within this angle and this share of the diameter is right."""
_RIGHT_BAR, _SECONDS_BAR = 0.99, 0.5


class Outcome(StrEnum):
    """How a start ended."""

    RIGHT = "right"
    WRONG = "wrong"
    NOT_YET = "not yet"


@dataclass(frozen=True)
class Start:
    """One cold start."""

    satellite: str
    seed: int
    outcome: Outcome
    status: str
    """Of the last frame."""
    frames: int
    """Taken in until the lock, or in all."""
    seconds: float
    """Processor time of the tracker over these frames."""
    attitude_rad: float
    """At lock, to the nearest of the target's equivalent attitudes; nan without a lock."""
    position_fraction: float
    """Error of the model origin at lock over the diameter; nan without a lock."""
    range_m: float
    rate_deg_s: float
    """Of the truth at the first frame."""


@dataclass(frozen=True)
class StartResult:
    """All cold starts and what they come to."""

    chapter: Chapter
    bars: tuple[Bar, ...]
    starts: tuple[Start, ...]


def run_start(name: str, seed: int) -> Start:
    """One cold start of a shipped satellite: truth and noise are the seed's."""
    of = satellite(name)
    spread = _SPREAD.scaled(of.target.diameter_m / satellite("boxsat").target.diameter_m)
    truth = random_truth(of, spread, seed, frames=FRAMES, frame_rate_hz=_FRAME_RATE_HZ)
    run = follow(Scene.of(truth, of.target.mesh), of.target, until_lock=True)
    attitude, position = float(run.attitude_rad[-1]), float(run.position_m[-1])
    fraction = position / of.target.diameter_m
    if run.lock is None:
        outcome, attitude, fraction = Outcome.NOT_YET, np.nan, np.nan
    elif attitude < RIGHT_RAD and fraction < RIGHT_FRACTION:
        outcome = Outcome.RIGHT
    else:
        outcome = Outcome.WRONG
    return Start(
        satellite=name,
        seed=seed,
        outcome=outcome,
        status=run.status[-1],
        frames=len(run),
        seconds=float(run.seconds.sum()),
        attitude_rad=attitude,
        position_fraction=fraction,
        range_m=float(np.linalg.norm(truth.orbit.r_hill_m)),
        rate_deg_s=float(np.linalg.norm(truth.body.omega_body_deg_s)),
    )


def planned_starts(count: int) -> list[Run[str]]:
    """So many starts of every satellite."""
    return runs_of(NAME, [Case(name, name) for name in SATELLITES], count)


def start_chapter(runs: list[Run[str]], workers: Workers, progress: Progress) -> StartResult:
    """Run the starts and lay them out."""
    starts = run_all(_run, runs, workers, lambda: progress.add(FRAMES))
    of = {name: [start for start in starts if start.satellite == name] for name in SATELLITES}
    curves = [
        StartCurve(
            name,
            np.array([s.frames for s in own if s.outcome is not Outcome.NOT_YET]),
            np.array([s.attitude_rad for s in own if s.outcome is not Outcome.NOT_YET]),
            len(own),
        )
        for name, own in of.items()
    ]
    chapter = Chapter(
        "Cold starts",
        _TEXT,
        (_share_table(of), _failure_table(starts)),
        start_figures(curves, FRAMES, RIGHT_RAD),
    )
    bars = tuple(bar for name, own in of.items() for bar in _bars(name, own))
    return StartResult(chapter, bars, tuple(starts))


def _run(run: Run[str]) -> Start:
    return run_start(run.case.settings, run.seed)


def _count(starts: list[Start], outcome: Outcome) -> int:
    return sum(start.outcome is outcome for start in starts)


def _bars(name: str, starts: list[Start]) -> tuple[Bar, ...]:
    right, wrong = _count(starts, Outcome.RIGHT), _count(starts, Outcome.WRONG)
    slowest = max(start.seconds for start in starts)
    symmetric = len(satellite(name).target.symmetry_transforms) > 1
    word = Status.AMBIGUOUS if symmetric else Status.LOCKED
    locks = [start for start in starts if start.outcome is not Outcome.NOT_YET]
    told = sum(start.status == word for start in locks)
    return (
        Bar(
            NAME,
            f"{name}: right within {FRAMES} frames",
            f">= {_RIGHT_BAR:.0%}",
            share(right, len(starts)),
            right >= _RIGHT_BAR * len(starts),
        ),
        Bar(NAME, f"{name}: locked on a wrong attitude", "0", str(wrong), wrong == 0),
        Bar(
            NAME,
            f"{name}: locks reported as {word}",
            "all",
            f"{told} of {len(locks)}",
            told == len(locks),
        ),
        Bar(
            NAME,
            f"{name}: slowest start, s",
            f"< {_SECONDS_BAR:g}",
            number(slowest),
            slowest < _SECONDS_BAR,
        ),
    )


def _share_table(of: dict[str, list[Start]]) -> TextTable:
    rows = []
    for name, starts in of.items():
        locks = [start for start in starts if start.outcome is not Outcome.NOT_YET]
        seconds = np.array([start.seconds for start in starts])
        words = Counter(start.status for start in locks)
        rows.append(
            (
                name,
                group_name(satellite(name).target.symmetry_transforms),
                ", ".join(f"{count} {word}" for word, count in words.most_common()) or NONE,
                str(len(starts)),
                *(share(_count(starts, outcome), len(starts)) for outcome in Outcome),
                number(float(np.mean([start.frames for start in locks]))) if locks else NONE,
                joined(at(50, seconds), at(95, seconds), float(seconds.max())),
            )
        )
    header = (
        "satellite",
        "symmetry",
        "locks reported",
        "starts",
        *Outcome,
        "frames",
        "seconds",
    )
    return TextTable(
        "cold_starts",
        f"Locks within {FRAMES} frames at {_FRAME_RATE_HZ:g} Hz",
        header,
        tuple(rows),
        "Shares with Wilson's 95 % interval in per cent. Right: attitude within 5 degrees of one "
        "of the equivalent attitudes of the symmetry group, and model origin within 5 % of the "
        "diameter, at the first frame called locked or ambiguous. Frames: mean until then. "
        "Seconds: median / 95 % / largest processor time of the tracker, on one thread.",
        text_columns=3,
    )


def _failure_table(starts: list[Start]) -> TextTable:
    failed = [start for start in starts if start.outcome is not Outcome.RIGHT]
    rows = [
        (
            start.satellite,
            start.outcome,
            start.status,
            str(start.seed),
            str(start.frames),
            *numbers(
                [
                    float(np.rad2deg(start.attitude_rad)),
                    100.0 * start.position_fraction,
                    start.range_m,
                    start.rate_deg_s,
                ]
            ),
        )
        for start in failed
    ]
    header = (
        "satellite",
        "outcome",
        "status",
        "seed",
        "frames",
        "attitude, deg",
        "position, % of diameter",
        "range, m",
        "rate, deg/s",
    )
    return TextTable(
        "cold_start_failures",
        "Starts that were not right",
        header,
        tuple(rows) or ((*("none",), *[NONE] * (len(header) - 1)),),
        "One of them alone: studies.tracking.starts.run_start(satellite, seed).",
        text_columns=3,
    )


_TEXT = (
    "Random starts without any prior but the target: attitude uniform on SO(3), rate up to 20 "
    "deg/s in a uniform direction, boxsat at 10 to 30 m and the others at the same range over "
    "diameter, mass centre and inertia ratios drawn from the prior in the target's TOML, camera "
    "and noise of the satellite's shipped pipeline. The target is anywhere in the image where it "
    "fits, and near its middle where it does not: at 10 m half of boxsat lies outside.",
)
