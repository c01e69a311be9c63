"""Blackouts: frames without returns in the middle of a track, and what becomes of it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from pcnav.core.arrays import FloatArray
from pcnav.core.statistics import MeanSquared, mean_squared, percentile
from pcnav.files.text_table import TextTable, number
from pcnav.report.panels import panels_figure
from pcnav.simulation.depth import Scene

from ..blocks import BLOCKS, ShownBlock
from ..folder import StudyFigure
from ..following import JudgedRun, follow, status_sequence
from ..panels import error_panel
from ..tables import Claim, always, at_most, table_of
from .tumbles import FRAME_RATE_HZ, boxsat, tumble

NAME = "blackouts"
CASES = {f"{duration_s} s": (duration_s,) for duration_s in (5, 20, 60)}
_RELOCK_BAR = 3
_GROWTH_BAR = 1.1
"""A deviation that grows no more than this over a blackout was not forgotten."""
_CENTRE, _RATIOS = BLOCKS["mass centre"], BLOCKS["inertia ratios"]
_MASS = np.r_[_CENTRE.rows, _RATIOS.rows]


@dataclass(frozen=True)
class Phases:
    """How many frames are tracked before the blackout, and given after it."""

    before: int = 40
    after: int = 20

    @property
    def seen(self) -> int:
        """Frames with returns."""
        return self.before + self.after

    def blind(self, duration_s: int) -> range:
        """The frames of the blackout."""
        return range(self.before, self.before + round(duration_s * FRAME_RATE_HZ))


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
        return self.phases.blind(self.duration_s)[-1]

    @property
    def relocked(self) -> int | None:
        """Frames with returns until one is called locked or ambiguous and is right."""
        right = self.run.is_right(boxsat().target)
        found = np.flatnonzero((self.run.claims & right)[self.last_blind + 1 :])
        return int(found[0]) + 1 if found.size else None

    def then(self, values: FloatArray) -> FloatArray:
        """What values (n, ...) have become at the re-lock; nan without."""
        if self.relocked is None:
            return np.full_like(values[0], np.nan)
        return np.asarray(values[self.last_blind + self.relocked])

    @property
    def growth(self) -> FloatArray:
        """(8,) deviation of mass centre and ratios at the re-lock over that before; nan without."""
        sd = self.run.state_sd[:, _MASS]
        return np.asarray(self.then(sd) / sd[self.last_seen])

    @property
    def end(self) -> FloatArray:
        """(2, 2) position error and 3 sd (mm), attitude error and 3 sd (deg) at the end of
        coasting."""
        k, run = self.last_blind, self.run
        variance = np.square(run.pose_sd[k])
        position = run.position_m[k], 3.0 * np.sqrt(variance[:3].sum())
        attitude = run.attitude_rad[k], 3.0 * np.sqrt(variance[3:].sum())
        return np.array([1e3 * np.array(position), np.rad2deg(attitude)])


Blackouts = Mapping[str, Sequence[Blackout]]
"""By duration."""


def run_blackout(duration_s: int, seed: int, phases: Phases | None = None) -> Blackout:
    """One blackout in a track of boxsat: truth and noise are the seed's."""
    phases, target = phases or Phases(), boxsat().target
    blind = phases.blind(duration_s)
    truth = tumble(seed, phases.seen + len(blind))
    run = follow(Scene.of(truth, target.mesh), target, blind=blind)
    return Blackout(duration_s, seed, phases, run)


def tables(found: Blackouts) -> list[TextTable]:
    """By duration, and every blackout."""
    return [_summary_table(found), _run_table([b for own in found.values() for b in own])]


def figures(found: Blackouts) -> list[StudyFigure]:
    """The first run of every duration."""
    return [_figure(own[0]) for own in found.values()]


def claims(own: Sequence[Blackout]) -> list[Claim]:
    """The bars of a duration."""
    name = f"{own[0].duration_s} s"
    nees = _last_nees(own)
    soon = [b.relocked is not None and b.relocked <= _RELOCK_BAR for b in own]
    growths = [float(b.growth.max()) for b in own]
    mass = f"{name}: deviation of mass centre and ratios, after over before"
    return [
        Claim(
            NAME,
            f"{name}: pose NEES over dof at the end of coasting",
            f"<= {number(float(nees.upper))}",
            nees.mean,
            bool(nees.values == len(own) and nees.mean <= nees.upper),
        ),
        always(NAME, f"{name}: right again within {_RELOCK_BAR} frames", soon),
        at_most(NAME, mass, growths, _GROWTH_BAR),
    ]


def _last_nees(own: Sequence[Blackout]) -> MeanSquared:
    return mean_squared(np.array([b.run.pose_nees[b.last_blind] for b in own]), 6)


def _summary_table(found: Blackouts) -> TextTable:
    def ends(own: Sequence[Blackout], of: int) -> list[float]:
        return [percentile(column, 50) for column in np.array([b.end[of] for b in own]).T]

    def frames(own: Sequence[Blackout]) -> list[int]:
        return [b.relocked for b in own if b.relocked is not None]

    return table_of(
        "blackouts",
        found.values(),
        {
            "blackout": lambda own: f"{own[0].duration_s} s",
            "runs": len,
            "pose NEES over dof (95 % bounds)": _last_nees,
            "position, mm": lambda own: ends(own, 0),
            "attitude, deg": lambda own: ends(own, 1),
            "right again": lambda own: len(frames(own)),
            "frames": lambda own: max(frames(own), default=None),
            "sd after over before": lambda own: percentile([b.growth.max() for b in own], 100),
        },
    )


def _run_table(blackouts: Sequence[Blackout]) -> TextTable:
    def mass(block: ShownBlock, of: Blackout) -> list[float]:
        norms = np.linalg.norm(block.shown(of.run.state_sd), axis=1)
        return [norms[of.last_seen], of.then(norms)]

    return table_of(
        "blackout_runs",
        blackouts,
        {
            "blackout": lambda b: f"{b.duration_s} s",
            "seed": lambda b: b.seed,
            "NEES over dof": lambda b: b.run.pose_nees[b.last_blind] / 6.0,
            "position, mm": lambda b: b.end[0],
            "attitude, deg": lambda b: b.end[1],
            "frames": lambda b: b.relocked,
            "mass centre, mm": partial(mass, _CENTRE),
            "ratios": partial(mass, _RATIOS),
            "statuses": lambda b: status_sequence(b.run.said.status),
        },
        text_columns=2,
    )


def _figure(blackout: Blackout) -> StudyFigure:
    run = blackout.run
    scale = np.repeat([1e3, np.rad2deg(1.0)], 3)
    errors, sds = (run.pose_error * scale).T, (run.pose_sd * scale).T
    labels = [f"{axis}, {unit}" for unit in ("mm", "deg") for axis in "xyz"]
    panels = [error_panel(*line) for line in zip(labels, errors, sds, strict=True)]
    return StudyFigure(
        f"blackout_{blackout.duration_s:02d}s",
        panels_figure(
            run.time_s,
            panels,
            row_in=0.95,
            dark=[(run.time_s[blackout.last_seen + 1], run.time_s[blackout.last_blind])],
        ),
    )
