"""Which states the motion of a run, or of a pipeline, makes observable, and how soon.

Along one trajectory (the true one of a pipeline; for a run, the one that leads to its last
estimate) the estimator's own model and measurements say what an arc of any length would tell:
`pcnav.evaluation.observability.information`. Beside it stands the local rank of Deng 2024, which
asks the same of the rotation alone, of an endless arc without noise.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np

from pcnav.core.arrays import FloatArray
from pcnav.evaluation.knowledge import (
    FROM_DATA,
    KNOWN_RULE,
    StateKnowledge,
    in_words,
    independent_combinations,
)
from pcnav.evaluation.observability.attitude import attitude_rank, rank_in_words
from pcnav.evaluation.observability.information import (
    ExpectedKnowledge,
    ReferenceArc,
    expected_knowledge,
    time_to_reach,
)
from pcnav.evaluation.observability.rank import ObservabilityRank
from pcnav.evaluation.observability.told import Told
from pcnav.files.text_table import TextTable, number
from pcnav.filtering.error_state import ManifoldState

S = TypeVar("S", bound=ManifoldState)

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
class Subject(Generic[S]):
    """A trajectory to be judged, extended beyond the arc that was or will be seen."""

    title: str
    estimator: str
    told: Told[S]
    arc: ReferenceArc[S]
    """With the extension."""
    frames: int
    """How many of its frames belong to the arc itself."""
    frames_seen: int
    """How many frames the arc had before it was thinned."""
    prior_covariance: FloatArray
    """(n, n) before the first frame."""
    omega_body: FloatArray
    """(3,) at the end of the arc, rad/s."""
    inertia: FloatArray
    """(3, 3) of any scale, body axes."""
    note: str
    """What the measurements are taken to be."""


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
    states: tuple[StateKnowledge, ...]
    """At the end of the arc."""
    weakest: tuple[StateKnowledge, ...]
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
        told = len(self.states) - len(self.not_observable)
        gap = f"{float(self.rank.relative[min(self.rank.rank, self.rank.size - 1)]):.1e}"
        rows = (
            ("estimator", self.estimator),
            ("arc", f"{number(self.arc_s)} s, {self.frames} frames"),
            (FROM_DATA, f"{told} of {len(self.states)} states"),
            ("not known from data", ", ".join(self.not_observable) or "none"),
            ("local rank of the rotation (Deng 2024)", rank_in_words(self.rank)),
            ("smallest singular value over the largest, or the largest dropped", gap),
        )
        return TextTable("facts", self.title, ("", ""), rows, self.note, text_columns=2)

    def _states(self) -> TextTable:
        rows = tuple(_knowledge_row(state) for state in self.states)
        note = (
            "Left by the prior: of a constant its prior sd, in a motion what errors of the prior "
            "put into it. The share is the prior's part of the variance. "
            f"{KNOWN_RULE}"
        )
        header = (
            "state",
            "verdict",
            "unit",
            "left by the prior",
            "sd after the arc",
            "prior's share",
        )
        return TextTable("states", "States after the arc", header, rows, note, text_columns=3)

    def _weakest(self) -> TextTable:
        rows = tuple(_knowledge_row(state) for state in self.weakest)
        header = (
            "direction",
            "verdict",
            "unit",
            "left by the prior",
            "sd after the arc",
            "prior's share",
        )
        return TextTable("weakest", "Weakest directions", header, rows, text_columns=3)

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


def judge(subject: Subject[S], wanted: Mapping[str, float] | None = None) -> ObservabilityReport:
    """What the trajectory of a subject makes observable.

    ``wanted`` replaces standard deviations of `WANTED`, by the name of a group of states.
    """
    wanted = {**WANTED, **(wanted or {})}
    told, arc = subject.told, subject.arc
    whole = expected_knowledge(arc, subject.prior_covariance, told.edge, subject.frames - 1)
    edge = told.edge(arc.states[0])
    prior = edge @ subject.prior_covariance @ edge.T
    arc_s = float(arc.times_s[subject.frames - 1] - arc.times_s[0])
    extended_s = float(arc.times_s[-1] - arc.times_s[0])
    lengths = tuple(share * arc_s for share in EXTENSIONS if share * arc_s <= 1.001 * extended_s)
    at = [int(np.argmin(np.abs(arc.times_s - arc.times_s[0] - length))) for length in lengths]
    goals = [wanted[group.name] for group in told.groups for _ in group.terms]
    return ObservabilityReport(
        title=f"Observability: {subject.title}",
        estimator=subject.estimator,
        arc_s=arc_s,
        frames=subject.frames_seen,
        extended_s=extended_s,
        rank=_rank(subject.omega_body, subject.inertia),
        states=_states(told, prior, whole),
        weakest=_weakest(told, prior, whole),
        lengths_s=lengths,
        predicted_sd=whole.sd[at],
        reach=tuple(
            Reach(name, unit, goal, time_to_reach(whole.times_s, whole.sd[:, k], goal))
            for k, (name, unit, goal) in enumerate(zip(told.names, told.units, goals, strict=True))
        ),
        note=subject.note,
    )


def _rank(omega_body: FloatArray, inertia: FloatArray) -> ObservabilityRank:
    """The rank does not depend on the attitude: any serves."""
    entries = ((0, 0), (1, 1), (0, 1), (0, 2), (1, 2))
    ratios = [float(inertia[i, j] / inertia[2, 2]) for i, j in entries]
    return attitude_rank((0.0, 0.0, 0.0, 1.0), omega_body.tolist(), ratios)


def _states(
    told: Told[S], prior: FloatArray, known: ExpectedKnowledge
) -> tuple[StateKnowledge, ...]:
    found = []
    for group, block in zip(told.groups, told.slices(), strict=True):
        for k, term in zip(range(block.start, block.stop), group.terms, strict=True):
            weights = np.zeros(len(prior))
            weights[k] = 1.0
            found.append(_one(term, group.unit, weights, group.constant, prior, known))
    return tuple(found)


def _weakest(
    told: Told[S], prior: FloatArray, known: ExpectedKnowledge
) -> tuple[StateKnowledge, ...]:
    """The principal axis of each group along which it is known least, and every other along which
    the prior still speaks."""
    found = []
    for group, block in zip(told.groups, told.slices(), strict=True):
        # Against the identity: principal axes of the covariance, told by few states each.
        axes = independent_combinations(np.eye(len(group.terms)), known.covariance[block, block])
        for rank, row in enumerate(axes):
            whole = np.zeros(len(prior))
            whole[block] = row
            name = in_words(row, group.terms)
            one = _one(name, group.unit, whole, group.constant, prior, known)
            if rank == 0 or not one.known:
                found.append(one)
    return tuple(sorted(found, key=lambda each: -each.prior_share))


def _one(
    name: str,
    unit: str,
    weights: FloatArray,
    constant: bool,
    prior: FloatArray,
    known: ExpectedKnowledge,
) -> StateKnowledge:
    variance = max(float(weights @ known.covariance @ weights), np.finfo(float).tiny)
    part = max(float(weights @ known.covariance_from_prior @ weights), 0.0)
    before = float(weights @ prior @ weights) if constant else part
    share = float(np.clip(part / variance, 0.0, 1.0))
    return StateKnowledge(name, unit, float(np.sqrt(before)), float(np.sqrt(variance)), share)


def _knowledge_row(state: StateKnowledge) -> tuple[str, ...]:
    scale, unit = _shown(state.unit)
    sds = (number(scale * state.prior_sd), number(scale * state.posterior_sd))
    return (state.name, state.verdict, unit, *sds, f"{100.0 * state.prior_share:.0f} %")


def _shown(unit: str) -> tuple[float, str]:
    """Factor and unit of the tables: angles in degrees."""
    if unit in _DEGREES:
        return float(np.degrees(1.0)), _DEGREES[unit]
    return 1.0, unit
