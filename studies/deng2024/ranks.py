"""The rank of section 2, at sixty digits and without rounding, for motions of several kinds."""

from dataclasses import dataclass

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from pcnav.evaluation.observability.attitude import (
    ORDER,
    attitude_exact_rank,
    attitude_ranks,
    rank_in_words,
)
from pcnav.evaluation.observability.rank import ObservabilityRank
from pcnav.files.text_table import TextTable
from pcnav.report.figures import CATEGORIES, INK, add_legend, style_axes, svg_bytes

from ..folder import Chapter, StudyFigure
from . import paper

_ORDERS = (0, 1, 2, 3, 4, ORDER)
_AT_REST = (0.0, 0.0, 0.0, 1.0)
_MIN_DRAWN = 1e-20


@dataclass(frozen=True)
class RankCase:
    """A state at which the rank is asked for, and the ranks of Q_0 ... Q_10."""

    name: str
    stated: str
    """By the paper."""
    ranks: tuple[int, ...]
    """At `_ORDERS`."""
    exact: int
    """Of Q_4, on fractions."""
    last: ObservabilityRank
    """Of Q_10."""


def rank_cases() -> list[RankCase]:
    """The printed states, two random ones, and motions that the paper does not treat."""
    rng = np.random.default_rng(2024)
    return [
        _case("printed, nutation", "11", paper.NUTATION_RATIOS, paper.NUTATION_RATE_DEG_S),
        _random_case("random state 1", rng),
        _random_case("random state 2", rng),
        _case("printed, spin", "below 11", paper.SPIN_RATIOS, paper.SPIN_RATE_DEG_S),
        _oblique_spin(),
        _case("ball, any rate", "below 11", (1.0, 1.0, 0.0, 0.0, 0.0), (5.0, 2.3, 3.5)),
        _case("axis of symmetry, nutation", "11", (0.6, 0.6, 0.0, 0.0, 0.0), (5.0, 2.3, 3.5)),
        _case("printed spin, tilted by 0.1 deg", "11", paper.SPIN_RATIOS, (0.004, 2.3, 0.0)),
    ]


def _case(
    name: str,
    stated: str,
    ratios: tuple[float, ...],
    rate_deg_s: tuple[float, ...],
    quaternion: tuple[float, ...] = _AT_REST,
) -> RankCase:
    omega = np.radians(rate_deg_s).tolist()
    found = attitude_ranks(quaternion, omega, ratios, _ORDERS)
    return RankCase(
        name=name,
        stated=stated,
        ranks=tuple(each.rank for each in found),
        exact=attitude_exact_rank(quaternion, omega, ratios, paper.PRINTED_RANK_ORDER),
        last=found[-1],
    )


def _random_case(name: str, rng: np.random.Generator) -> RankCase:
    """Any attitude, a rate of some degrees a second, the inertia of a random body."""
    quaternion = rng.standard_normal(4)
    quaternion *= np.sign(quaternion[3]) / np.linalg.norm(quaternion)
    rate = 4.0 * rng.standard_normal(3)
    points = rng.standard_normal((12, 3)) * [1.0, 0.7, 1.3]
    J = np.sum(points**2) * np.eye(3) - points.T @ points
    ratios = [J[0, 0], J[1, 1], J[0, 1], J[0, 2], J[1, 2]] / J[2, 2]
    return _case(name, "11", tuple(ratios.tolist()), tuple(rate.tolist()), tuple(quaternion))


def _oblique_spin() -> RankCase:
    """About a principal axis of the printed body: a spin up to the rounding of doubles."""
    xx, yy, xy, xz, yz = paper.NUTATION_RATIOS
    axes = np.linalg.eigh(np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, 1.0]]))[1]
    rate = 5.0 * axes[:, 2]
    return _case(
        "spin about a principal axis", "below 11", paper.NUTATION_RATIOS, tuple(rate.tolist())
    )


def rank_chapter(cases: list[RankCase]) -> Chapter:
    """Ranks by order, and the singular values that show how clear they are."""
    rows = []
    for case in cases:
        relative = case.last.relative
        rank = case.last.rank
        dropped = f"{relative[rank]:.0e}" if rank < len(relative) else "-"
        by_order = tuple(str(value) for value in case.ranks)
        kept = f"{relative[rank - 1]:.1e}"
        rows.append((case.name, case.stated, *by_order, str(case.exact), kept, dropped))
    orders = tuple(f"Q_{order}" for order in _ORDERS)
    header = ("state", "paper", *orders, "Q_4 exact", "smallest kept", "largest dropped")
    table = TextTable(
        "ranks",
        "Rank of the observability matrix (20) after derivatives of order 0 to k",
        header,
        tuple(rows),
        "Kept and dropped are singular values of Q_10 over the largest, at sixty digits; below "
        f"{cases[0].last.tolerance:.0e} they count as zero. The exact rank is taken on fractions, "
        "without tolerance: a spin about an axis that doubles cannot hold exactly is none there.",
        text_columns=2,
    )
    words = TextTable(
        "unobservable",
        "What no derivative sees",
        ("state", "rank and directions that are not observable"),
        tuple((case.name, rank_in_words(case.last)) for case in cases),
        text_columns=2,
    )
    text = (
        "Lie derivatives of the quaternion along the motion, of any order, come from Taylor "
        "arithmetic on numbers of sixty digits: nothing is differenced. The paper takes those up "
        "to order 4 to reach rank 11 in nutation; order 3 is enough. In a spin about a principal "
        "axis the rank is 8: of the five ratios only two combinations show, the products of "
        "inertia with the spin axis, for they alone would make the axis wander. A ball behaves "
        "as if it spun.",
    )
    return Chapter("Rank (section 2)", text, (table, words), (_figure(cases),))


def _figure(cases: list[RankCase]) -> StudyFigure:
    figure = Figure(figsize=(5.8, 3.4), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    style_axes(axes)
    for colour, case in zip((*CATEGORIES, INK), cases, strict=False):
        values = np.maximum(case.last.relative, _MIN_DRAWN)
        axes.semilogy(np.arange(1, 12), values, "o-", color=colour, markersize=3, label=case.name)
    axes.axhline(cases[0].last.tolerance, color="#ea580c", linewidth=1.0, linestyle="--")
    axes.set_xlabel("number of the singular value")
    axes.set_ylabel("singular value over the largest")
    add_legend(figure, axes, max_columns=2)
    return StudyFigure(
        "singular_values",
        "Singular values of Q_10",
        f"Values below {_MIN_DRAWN:.0e} are drawn there; the dashed line is the tolerance.",
        svg_bytes(figure),
    )
