"""The rank of section 2, at sixty digits and without rounding, for motions of several kinds."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pcnav.evaluation.observability.attitude import (
    ORDER,
    attitude_exact_rank,
    attitude_ranks,
    rank_in_words,
)
from pcnav.evaluation.observability.rank import ObservabilityRank
from pcnav.files.text_table import TextTable

from ..folder import StudyFigure
from ..panels import Curve, Panel, Scale, panels_figure
from ..tables import table
from . import paper

_ORDERS = (0, 1, 2, 3, 4, ORDER)
_MIN_DRAWN = 1e-20


@dataclass(frozen=True)
class RankState:
    """A state at which the rank is asked for."""

    name: str
    stated: str
    """By the paper."""
    ratios: Sequence[float]
    """Jxx, Jyy, Jxy, Jxz, Jyz over Jzz."""
    rate_deg_s: Sequence[float]
    quaternion_xyzw: Sequence[float] = (0.0, 0.0, 0.0, 1.0)


@dataclass(frozen=True)
class RankCase:
    """A state with the ranks of Q_0 ... Q_10."""

    state: RankState
    ranks: tuple[int, ...]
    """At `_ORDERS`."""
    exact: int
    """Of Q_4, on fractions."""
    last: ObservabilityRank
    """Of Q_10."""


def rank_states() -> list[RankState]:
    """The printed states, two random ones, and motions that the paper does not treat."""
    rng = np.random.default_rng(2024)
    nutation, spin = paper.NUTATION_RATIOS, paper.SPIN_RATIOS
    _, axes = np.linalg.eigh(paper.inertia_of_printed(nutation))
    oblique: list[float] = (5.0 * axes[:, 2]).tolist()
    return [
        RankState("printed, nutation", "11", nutation, paper.NUTATION_RATE_DEG_S),
        _random_state("random state 1", rng),
        _random_state("random state 2", rng),
        RankState("printed, spin", "below 11", spin, paper.SPIN_RATE_DEG_S),
        # A spin up to the rounding of doubles.
        RankState("spin about a principal axis", "below 11", nutation, oblique),
        RankState("ball, any rate", "below 11", (1.0, 1.0, 0.0, 0.0, 0.0), (5.0, 2.3, 3.5)),
        RankState("axis of symmetry, nutation", "11", (0.6, 0.6, 0.0, 0.0, 0.0), (5.0, 2.3, 3.5)),
        RankState("printed spin, tilted by 0.1 deg", "11", spin, (0.004, 2.3, 0.0)),
    ]


def _random_state(name: str, rng: np.random.Generator) -> RankState:
    """Any attitude, a rate of some degrees a second, the inertia of a random body."""
    quaternion = rng.standard_normal(4)
    quaternion *= np.sign(quaternion[3]) / np.linalg.norm(quaternion)
    rate = 4.0 * rng.standard_normal(3)
    points = rng.standard_normal((12, 3)) * [1.0, 0.7, 1.3]
    J = np.sum(points**2) * np.eye(3) - points.T @ points
    ratios = [J[0, 0], J[1, 1], J[0, 1], J[0, 2], J[1, 2]] / J[2, 2]
    return RankState(name, "11", ratios.tolist(), rate.tolist(), quaternion.tolist())


def ranked(state: RankState) -> RankCase:
    """The ranks at a state, at sixty digits and exact."""
    at = (state.quaternion_xyzw, np.radians(state.rate_deg_s).tolist(), state.ratios)
    found = attitude_ranks(*at, _ORDERS)
    exact = attitude_exact_rank(*at, paper.PRINTED_RANK_ORDER)
    return RankCase(state, tuple(each.rank for each in found), exact, found[-1])


def rank_tables(cases: Sequence[RankCase]) -> tuple[TextTable, TextTable]:
    """Ranks by order with the singular values that show how clear they are, and what is unseen."""
    rows = []
    for case in cases:
        relative, rank = case.last.relative, case.last.rank
        dropped = f"{relative[rank]:.0e}" if rank < len(relative) else "-"
        kept = f"{relative[rank - 1]:.1e}"
        rows.append((case.state.name, case.state.stated, *case.ranks, case.exact, kept, dropped))
    orders = (f"Q_{order}" for order in _ORDERS)
    ranks = table(
        "ranks",
        "Rank of the observability matrix (20) after derivatives of order 0 to k",
        ("state", "paper", *orders, "Q_4 exact", "smallest kept", "largest dropped"),
        rows,
        "Kept and dropped are singular values of Q_10 over the largest, at sixty digits; below "
        f"{cases[0].last.tolerance:.0e} they count as zero. The exact rank is taken on fractions, "
        "without tolerance: a spin about an axis that doubles cannot hold exactly is none there.",
        text_columns=2,
    )
    words = table(
        "unobservable",
        "What no derivative sees",
        ("state", "rank and directions that are not observable"),
        [(case.state.name, rank_in_words(case.last)) for case in cases],
        text_columns=2,
    )
    return ranks, words


def rank_figure(cases: Sequence[RankCase]) -> StudyFigure:
    """Singular values, the tolerance among them."""
    curves = [
        Curve(case.state.name, np.maximum(case.last.relative, _MIN_DRAWN), style="o-")
        for case in cases
    ]
    levels = {"tolerance": cases[0].last.tolerance}
    panel = Panel("singular value over the largest", curves, Scale.LOG, levels=levels)
    return panels_figure(
        "singular_values",
        "Singular values of Q_10",
        f"Values below {_MIN_DRAWN:.0e} are drawn there; the dashed line is the tolerance.",
        np.arange(1.0, 12.0),
        [panel],
        row_in=2.7,
        at_label="number of the singular value",
    )
