"""Cold starts: how soon, how often right and at what cost a lock is made of nothing."""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from pcnav.core.statistics import mean, percentile, share
from pcnav.files.text_table import TextTable
from pcnav.report.panels import Curve, Panel, Scale, panels_figure
from pcnav.runs.status import WRONG_TURN_RAD, Status
from pcnav.simulation.depth import Scene
from pcnav.simulation.random_truth import Satellite, Spread, random_truth, satellite

from ..folder import StudyFigure
from ..following import follow
from ..panels import bars_figure
from ..tables import Claim, always, below, never, table_of

NAME = "cold starts"
SATELLITES = ("boxsat", "cubesat6u", "twinwing")
CASES = {name: (name,) for name in SATELLITES}
FRAMES = 5
FRAME_RATE_HZ = 5.0
_SPREAD = Spread(range_m=(10.0, 30.0), rate_deg_s=(0.0, 20.0), speed_m_s=0.02)
"""Of `boxsat`; lengths go with the diameter for the others."""
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


Starts = Mapping[str, Sequence[Start]]
"""By satellite."""


def run_start(name: str, seed: int) -> Start:
    """One cold start of a shipped satellite: truth and noise are the seed's."""
    of = satellite(name)
    spread = _SPREAD.scaled(of.target.diameter_m / satellite("boxsat").target.diameter_m)
    return start_of(name, of, spread, seed)


def start_of(name: str, of: Satellite, spread: Spread, seed: int) -> Start:
    """One cold start of a target whose truth is drawn so."""
    truth = random_truth(of, spread, seed, frames=FRAMES, frame_rate_hz=FRAME_RATE_HZ)
    run = follow(Scene.of(truth, of.target.mesh), of.target, until_lock=True)
    outcome, attitude, position = Outcome.NOT_YET, np.nan, np.nan
    if run.lock is not None:
        attitude, position = float(run.attitude_rad[-1]), float(run.position_m[-1])
        right = run.is_right(of.target)[-1]
        outcome = Outcome.RIGHT if right else Outcome.WRONG
    return Start(
        satellite=name,
        seed=seed,
        outcome=outcome,
        status=run.said.status[-1],
        frames=len(run),
        seconds=float(run.seconds.sum()),
        attitude_rad=attitude,
        position_fraction=position / of.target.diameter_m,
        range_m=float(np.linalg.norm(truth.orbit.r_hill_m)),
        rate_deg_s=float(np.linalg.norm(truth.body.omega_body_deg_s)),
    )


def tables(
    found: Starts, key: str = "cold_start", named: Callable[[str], Satellite] = satellite
) -> list[TextTable]:
    """All starts, and those that were not right; ``key`` begins the names of their files."""
    everything = [start for starts in found.values() for start in starts]
    return [_share_table(found, f"{key}s", named), _failure_table(everything, f"{key}_failures")]


def count(starts: Sequence[Start], outcome: Outcome) -> int:
    """How many ended so."""
    return sum(start.outcome is outcome for start in starts)


def _locks(starts: Sequence[Start]) -> list[Start]:
    return [start for start in starts if start.outcome is not Outcome.NOT_YET]


def claims(starts: Sequence[Start]) -> list[Claim]:
    """The bars of a satellite."""
    name = starts[0].satellite
    right, locks = count(starts, Outcome.RIGHT), _locks(starts)
    symmetric = satellite(name).target.is_symmetric
    word = Status.AMBIGUOUS if symmetric else Status.LOCKED
    return [
        Claim(
            NAME,
            f"{name}: right within {FRAMES} frames",
            f">= {_RIGHT_BAR:.0%}",
            share(right, len(starts)),
            right >= _RIGHT_BAR * len(starts),
        ),
        never(NAME, f"{name}: locked on a wrong attitude", count(starts, Outcome.WRONG)),
        always(NAME, f"{name}: locks reported as {word}", [s.status == word for s in locks]),
        below(NAME, f"{name}: slowest start, s", [s.seconds for s in starts], _SECONDS_BAR),
    ]


def _share_table(found: Starts, key: str, named: Callable[[str], Satellite]) -> TextTable:
    return table_of(
        key,
        found.values(),
        {
            "satellite": lambda starts: starts[0].satellite,
            "symmetry": lambda starts: named(starts[0].satellite).target.symmetry_name,
            "locks reported": lambda starts: ", ".join(
                f"{times} {word}"
                for word, times in Counter(s.status for s in _locks(starts)).most_common()
            ),
            "starts": len,
            "right": lambda starts: share(count(starts, Outcome.RIGHT), len(starts)),
            "wrong": lambda starts: share(count(starts, Outcome.WRONG), len(starts)),
            "not yet": lambda starts: share(count(starts, Outcome.NOT_YET), len(starts)),
            "frames": lambda starts: mean([s.frames for s in _locks(starts)]),
            "seconds": lambda starts: [
                percentile([s.seconds for s in starts], percent) for percent in (50, 95, 100)
            ],
        },
        text_columns=3,
    )


def _failure_table(starts: Sequence[Start], key: str) -> TextTable:
    return table_of(
        key,
        [start for start in starts if start.outcome is not Outcome.RIGHT],
        {
            "satellite": lambda s: s.satellite,
            "outcome": lambda s: s.outcome,
            "status": lambda s: s.status,
            "seed": lambda s: s.seed,
            "frames": lambda s: s.frames,
            "attitude, deg": lambda s: np.rad2deg(s.attitude_rad),
            "position, % of diameter": lambda s: 100.0 * s.position_fraction,
            "range, m": lambda s: s.range_m,
            "rate, deg/s": lambda s: s.rate_deg_s,
        },
        text_columns=3,
    )


def start_figures(found: Starts) -> list[StudyFigure]:
    """How many frames a lock takes, and how far off it is."""
    shares, curves = {}, []
    for name, starts in found.items():
        locks = _locks(starts)
        ended = [s.frames - 1 if s.outcome is not Outcome.NOT_YET else FRAMES for s in starts]
        shares[name] = 100.0 * np.bincount(ended, minlength=FRAMES + 1) / len(starts)
        reached = 100.0 * np.arange(1, len(locks) + 1) / len(starts)
        degrees = np.sort(np.rad2deg([s.attitude_rad for s in locks]))
        curves.append(Curve(name, reached, degrees, width=1.2, steps=True))
    names = [*(str(k + 1) for k in range(FRAMES)), "not yet"]
    labels = ("frames to lock", "starts, %")
    return [
        StudyFigure("start_frames", bars_figure(shares, names, labels)),
        StudyFigure(
            "start_errors",
            panels_figure(
                np.empty(0),
                [Panel("starts below, %", curves, Scale.FROM_ZERO, limits=(0.0, 105.0))],
                row_in=2.3,
                at_label="attitude error at lock, deg",
                log_at=True,
                marked=[float(np.rad2deg(WRONG_TURN_RAD))],
            ),
        ),
    ]
