"""Which states the motion of a run, or of a pipeline, makes observable, and how soon.

Along one trajectory (the true one of a pipeline; for a run, the one that leads to its last
estimate) the estimator's own model and measurements say what an arc of any length would tell:
`pcnav.evaluation.observability.information`. Beside it stands the local rank of Deng 2024, which
asks the same of the rotation alone, of an endless arc without noise.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from pcnav.core.arrays import FloatArray
from pcnav.evaluation.information_gain import (
    FROM_DATA,
    KNOWN_RULE,
    StateGain,
    in_words,
    independent_combinations,
)
from pcnav.evaluation.observability.attitude import attitude_rank, rank_in_words
from pcnav.evaluation.observability.information import (
    ExpectedUncertainty,
    expected_uncertainty,
    time_to_reach,
)
from pcnav.evaluation.observability.rank import ObservabilityRank
from pcnav.evaluation.observability.reported import ReportedState
from pcnav.evaluation.observability.subjects import Subject
from pcnav.files.text_table import TextTable, number

WANTED: Mapping[str, float] = {
    "position": 0.01,
    "velocity": 1e-3,
    "mass centre": 0.01,
    "attitude": float(np.radians(0.1)),
    "rate": float(np.radians(0.01)),
    "inertia ratios": 0.01,
}
"""Standard deviations asked for by default: m, m/s, m, rad, rad/s, 1."""
EXTENSIONS = (0.25, 0.5, 1.0, 2.0, 4.0)
"""Lengths at which the expected standard deviations are tabulated, over that of the arc."""

_DEGREES = {"rad": "deg", "rad/s": "deg/s"}


@dataclass(frozen=True)
class Reach:
    """How long one has to look for a state."""

    name: str
    unit: str
    wanted_sd: float
    after_s: float
    """From the start of the arc; infinite when the extended arc does not reach it."""


@dataclass(frozen=True)
class ObservabilityReport:
    """What the motion makes observable."""

    title: str
    estimator: str
    arc_s: float
    frames: int
    extended_s: float
    """Longest arc that was looked at."""
    rank: ObservabilityRank
    """Local rank of attitude, rate and inertia ratios from attitudes alone (Deng 2024 (20))."""
    states: tuple[StateGain, ...]
    """At the end of the arc."""
    weakest: tuple[StateGain, ...]
    """Directions in the states of a kind, the one with the largest share of the prior first."""
    lengths_s: tuple[float, ...]
    """Of the arcs for which standard deviations are predicted."""
    predicted_sd: FloatArray
    """(lengths, states)"""
    reach: tuple[Reach, ...]
    note: str

    @property
    def not_observable(self) -> tuple[str, ...]:
        """States that the arc does not tell: their prior speaks."""
        return tuple(state.name for state in self.states if not state.known)

    def tables(self) -> tuple[TextTable, ...]:
        """States, weakest directions, and standard deviations against the length of the arc."""
        return (self._facts(), self._states(), self._weakest(), self._lengths())

    def _facts(self) -> TextTable:
        known = len(self.states) - len(self.not_observable)
        gap = f"{float(self.rank.relative[min(self.rank.rank, self.rank.size - 1)]):.1e}"
        rows = (
            ("estimator", self.estimator),
            ("arc", f"{number(self.arc_s)} s, {self.frames} frames"),
            (FROM_DATA, f"{known} of {len(self.states)} states"),
            ("not known from data", ", ".join(self.not_observable) or "none"),
            ("local rank of the rotation (Deng 2024)", rank_in_words(self.rank)),
            ("smallest singular value over the largest, or the largest dropped", gap),
        )
        return TextTable("facts", self.title, ("", ""), rows, self.note, text_columns=2)

    def _states(self) -> TextTable:
        note = (
            "Left by the prior: of a constant its prior sd, in a motion what errors of the prior "
            "put into it. The share is the prior's part of the variance. "
            f"{KNOWN_RULE}"
        )
        return _gain_table("states", "States after the arc", "state", self.states, note)

    def _weakest(self) -> TextTable:
        return _gain_table("weakest", "Weakest directions", "direction", self.weakest)

    def _lengths(self) -> TextTable:
        rows = []
        for k, reach in enumerate(self.reach):
            scale, unit = _shown(reach.unit)
            sds = [number(scale * float(value)) for value in self.predicted_sd[:, k]]
            after = number(reach.after_s) if np.isfinite(reach.after_s) else self._beyond(k)
            rows.append((reach.name, unit, *sds, number(scale * reach.wanted_sd), after))
        lengths = tuple(f"sd after {number(length)} s" for length in self.lengths_s)
        header = ("state", "unit", *lengths, "wanted sd", "first reached after, s")
        note = "Predicted: the arc extended by the same motion, measured in the same way."
        return TextTable(
            "lengths", "Standard deviation against arc length", header, tuple(rows), note, 2
        )

    def _beyond(self, k: int) -> str:
        """Why a wanted value is not reached: this motion does not tell it, or it takes longer."""
        before, after = self.predicted_sd[-2:, k]
        if after > 0.95 * before:
            return "not by this motion"
        return f"more than {number(self.extended_s)}"


def observability_of(
    subject: Subject[Any], wanted: Mapping[str, float] | None = None
) -> ObservabilityReport:
    """What the trajectory of a subject makes observable.

    ``wanted`` replaces standard deviations of `WANTED`, by the name of a group of states.
    """
    wanted = {**WANTED, **(wanted or {})}
    arc, reported, last = subject.arc, subject.estimator.reported, subject.frames - 1
    found = expected_uncertainty(arc, subject.prior_covariance, reported.output_jacobian, last)
    jacobian = reported.output_jacobian(arc.states[0])
    prior = jacobian @ subject.prior_covariance @ jacobian.T
    past_s = arc.times_s - arc.times_s[0]
    arc_s, extended_s = float(past_s[last]), float(past_s[-1])
    lengths = tuple(share * arc_s for share in EXTENSIONS if share * arc_s <= 1.001 * extended_s)
    at = [int(np.argmin(np.abs(past_s - length))) for length in lengths]
    goals = [wanted[group.name] for group in reported.groups for _ in group.terms]
    sought = enumerate(zip(reported.names, reported.units, goals, strict=True))
    return ObservabilityReport(
        title=f"Observability: {subject.title}",
        estimator=subject.estimator.estimator,
        arc_s=arc_s,
        frames=len(subject.timing.recorded_s),
        extended_s=extended_s,
        rank=_rank(subject.omega_body, subject.estimator.inertia),
        states=_states(reported, prior, found),
        weakest=_weakest(reported, prior, found),
        lengths_s=lengths,
        predicted_sd=found.sd[at],
        reach=tuple(
            Reach(name, unit, goal, time_to_reach(found.times_s, found.sd[:, k], goal))
            for k, (name, unit, goal) in sought
        ),
        note=subject.estimator.note,
    )


def _rank(omega_body: FloatArray, inertia: FloatArray) -> ObservabilityRank:
    """The rank does not depend on the attitude: any serves."""
    entries = ((0, 0), (1, 1), (0, 1), (0, 2), (1, 2))
    ratios = [float(inertia[i, j] / inertia[2, 2]) for i, j in entries]
    return attitude_rank((0.0, 0.0, 0.0, 1.0), omega_body.tolist(), ratios)


def _states(
    reported: ReportedState[Any], prior: FloatArray, found: ExpectedUncertainty
) -> tuple[StateGain, ...]:
    constant = [group.constant for group in reported.groups for _ in group.terms]
    each = zip(reported.names, reported.units, np.eye(len(prior)), constant, strict=True)
    return tuple(_known(*state, prior, found) for state in each)


def _weakest(
    reported: ReportedState[Any], prior: FloatArray, found: ExpectedUncertainty
) -> tuple[StateGain, ...]:
    """The principal axis of each group along which it is known least, and every other along which
    the prior still speaks."""
    weakest = []
    for group in reported.groups:
        # Against the identity: principal axes of the covariance, of few states each.
        axes = independent_combinations(
            np.eye(len(group.terms)), found.covariance[group.rows, group.rows]
        )
        for rank, row in enumerate(axes):
            whole = np.zeros(len(prior))
            whole[group.rows] = row
            name = in_words(row, group.terms)
            one = _known(name, group.unit, whole, group.constant, prior, found)
            if rank == 0 or not one.known:
                weakest.append(one)
    return tuple(sorted(weakest, key=lambda each: -each.prior_share))


def _known(
    name: str,
    unit: str,
    weights: FloatArray,
    constant: bool,
    prior: FloatArray,
    found: ExpectedUncertainty,
) -> StateGain:
    variance = max(float(weights @ found.covariance @ weights), np.finfo(float).tiny)
    part = max(float(weights @ found.covariance_from_prior @ weights), 0.0)
    before = float(weights @ prior @ weights) if constant else part
    share = float(np.clip(part / variance, 0.0, 1.0))
    return StateGain(name, unit, float(np.sqrt(before)), float(np.sqrt(variance)), share)


def _gain_table(
    key: str, title: str, first: str, states: tuple[StateGain, ...], note: str = ""
) -> TextTable:
    rows = []
    for state in states:
        scale, unit = _shown(state.unit)
        sds = (number(scale * state.prior_sd), number(scale * state.posterior_sd))
        share = f"{100.0 * state.prior_share:.0f} %"
        rows.append((state.name, state.verdict, unit, *sds, share))
    columns = ("verdict", "unit", "left by the prior", "sd after the arc", "prior's share")
    return TextTable(key, title, (first, *columns), tuple(rows), note, text_columns=3)


def _shown(unit: str) -> tuple[float, str]:
    """Factor and unit of the tables: angles in degrees."""
    if unit in _DEGREES:
        return float(np.degrees(1.0)), _DEGREES[unit]
    return 1.0, unit
