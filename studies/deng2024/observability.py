"""What attitudes show of a body: the rank of section 2, and the information of finite arcs."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pcnav.config.attitude_inertia import AttitudeInertiaTable
from pcnav.core.arrays import FloatArray
from pcnav.estimators.attitude_inertia.rotation_model import INERTIA
from pcnav.evaluation.information_gain import MAX_PRIOR_SHARE
from pcnav.evaluation.observability.attitude import (
    ORDER,
    attitude_exact_rank,
    attitude_rank,
    attitude_ranks,
    rank_in_words,
)
from pcnav.evaluation.observability.information import expected_uncertainty, time_to_reach
from pcnav.evaluation.observability.rank import ObservabilityRank
from pcnav.evaluation.observability.reported import ROTATION
from pcnav.evaluation.observability.subjects import attitude_subject
from pcnav.files.text_table import TextTable
from pcnav.report.panels import Curve, Panel, Scale, panels_figure

from ..folder import StudyFigure
from ..tables import cell, table, table_of
from . import paper
from .filters import RATIO_NAMES, Estimates
from .paper import Body, Triple

MIN_DRAWN = 1e-20
"""Of singular values."""
WANTED_SD = 0.01
TILTS_DEG = (0.0, 0.1, 1.0, 5.0, 20.0)
"""Of the rate away from the middle principal axis of the body of Fig. 6."""
SENSOR = AttitudeInertiaTable(
    rate_sd_deg_s=5.0,
    inertia_ratio_sd=0.3,
    attitude_sd_deg=0.5,
    angular_acceleration_psd_rad2_s3=0.0,
)
"""Of the arcs: an attitude every second, and what is known before."""
_ORDERS = (0, 1, 2, 3, 4, ORDER)


@dataclass(frozen=True)
class RankState:
    """A state at which the rank is asked for."""

    name: str
    body: Body
    full: bool = True
    """Whether by the paper the rank is 11, else below."""


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
    tumbling, spinning = (5.0, 2.3, 3.5), paper.SPIN.ratios
    _, axes = np.linalg.eigh(paper.NUTATION.inertia)
    oblique = Body(paper.NUTATION.ratios, _triple(5.0 * axes[:, 2]))
    return [
        RankState("printed, nutation", paper.NUTATION),
        RankState("random state 1", _random_body(rng)),
        RankState("random state 2", _random_body(rng)),
        RankState("printed, spin", paper.SPIN, full=False),
        # A spin up to the rounding of doubles.
        RankState("spin about a principal axis", oblique, full=False),
        RankState("ball, any rate", Body((1.0, 1.0, 0.0, 0.0, 0.0), tumbling), full=False),
        RankState("axis of symmetry, nutation", Body((0.6, 0.6, 0.0, 0.0, 0.0), tumbling)),
        RankState("printed spin, tilted by 0.1 deg", Body(spinning, (0.004, 2.3, 0.0))),
    ]


def _random_body(rng: np.random.Generator) -> Body:
    """Any attitude, a rate of some degrees a second, the inertia of a random body."""
    quaternion = rng.standard_normal(4)
    quaternion *= np.sign(quaternion[3]) / np.linalg.norm(quaternion)
    rate = 4.0 * rng.standard_normal(3)
    points = rng.standard_normal((12, 3)) * [1.0, 0.7, 1.3]
    J = np.sum(points**2) * np.eye(3) - points.T @ points
    xx, yy, xy, xz, yz = ([J[0, 0], J[1, 1], J[0, 1], J[0, 2], J[1, 2]] / J[2, 2]).tolist()
    x, y, z, w = quaternion.tolist()
    return Body((xx, yy, xy, xz, yz), _triple(rate), (x, y, z, w))


def _triple(values: FloatArray) -> Triple:
    x, y, z = values.tolist()
    return (x, y, z)


def ranked(state: RankState) -> RankCase:
    """The ranks at a state, at sixty digits and exact."""
    body = state.body
    at = (body.quaternion_xyzw, np.radians(body.rate_deg_s).tolist(), body.ratios)
    found = attitude_ranks(*at, _ORDERS)
    exact = attitude_exact_rank(*at, paper.PRINTED_RANK_ORDER)
    return RankCase(state, tuple(each.rank for each in found), exact, found[-1])


def rank_tables(cases: Sequence[RankCase]) -> tuple[TextTable, TextTable]:
    """Ranks by order with the singular values that show how clear they are, and what is unseen."""
    rows = []
    for case in cases:
        relative, rank = case.last.relative, case.last.rank
        dropped = f"{relative[rank]:.0e}" if rank < len(relative) else "-"
        stated, kept = "11" if case.state.full else "below 11", f"{relative[rank - 1]:.1e}"
        rows.append((case.state.name, stated, *case.ranks, case.exact, kept, dropped))
    orders = (f"Q_{order}" for order in _ORDERS)
    header = ("state", "paper", *orders, "Q_4 exact", "smallest kept", "largest dropped")
    words = {
        "state": lambda case: case.state.name,
        "rank and directions that are not observable": lambda case: rank_in_words(case.last),
    }
    return table("ranks", header, rows, 2), table_of("unobservable", cases, words, 2)


def rank_figure(cases: Sequence[RankCase]) -> StudyFigure:
    """Singular values, the tolerance among them."""
    curves = [
        Curve(case.state.name, np.maximum(case.last.relative, MIN_DRAWN), style="o-")
        for case in cases
    ]
    levels = {"tolerance": cases[0].last.tolerance}
    panel = Panel("singular value over the largest", curves, Scale.LOG, levels=levels)
    number, label = np.arange(1.0, 12.0), "number of the singular value"
    return StudyFigure(
        "singular_values", panels_figure(number, [panel], row_in=2.7, at_label=label)
    )


@dataclass(frozen=True)
class ArcMotion:
    """A body, and how long it is looked at."""

    name: str
    body: Body
    length_s: float


@dataclass(frozen=True)
class ArcCase:
    """A motion, and what arcs of it tell."""

    name: str
    rank: ObservabilityRank
    unknown: list[str]
    """Ratios of which the prior speaks after the arc, a quarter of the times."""
    times_s: FloatArray
    """(n,)"""
    worst_sd: FloatArray
    """(n,) of the inertia ratio that is known least."""


def arc_motions(length_s: float) -> list[ArcMotion]:
    """The printed nutation, and spins that wobble more and more."""
    motions = [ArcMotion("printed, nutation", paper.NUTATION, length_s)]
    for tilt in TILTS_DEG:
        # The printed spin is about the axis of the largest moment; the tilt is towards x and z.
        side = np.sin(np.radians(tilt)) / np.sqrt(2.0)
        rate = _triple(5.0 * np.array([side, np.cos(np.radians(tilt)), side]))
        body = Body(paper.SPIN.ratios, rate)
        motions.append(ArcMotion(f"spin tilted by {tilt:g} deg", body, length_s))
    return motions


def arc_case(motion: ArcMotion) -> ArcCase:
    """What arcs of a motion tell, up to its whole length."""
    start, body = motion.body.state, motion.body
    times_s = np.arange(0.0, motion.length_s + 0.5, 1.0)
    subject = attitude_subject(motion.name, SENSOR, start, times_s)
    whole = expected_uncertainty(subject.arc, subject.prior_covariance, ROTATION.output_jacobian)
    at_end = subject.frames - 1
    share = whole.prior_part[at_end, INERTIA] / whole.sd[at_end, INERTIA] ** 2
    unknown = np.array(RATIO_NAMES)[share > MAX_PRIOR_SHARE].tolist()
    rank = attitude_rank(body.quaternion_xyzw, start.omega_body.tolist(), body.ratios)
    worst = np.max(whole.sd[:, INERTIA], axis=1)
    return ArcCase(motion.name, rank, unknown, whole.times_s, worst)


def arc_table(cases: Sequence[ArcCase]) -> TextTable:
    """Rank, smallest singular value, and the arcs that a wanted accuracy takes."""
    longest = float(cases[0].times_s[-1])
    lengths = (0.025 * longest, 0.25 * longest, longest)
    rows = []
    for case in cases:
        at = [int(np.argmin(np.abs(case.times_s - length))) for length in lengths]
        after = time_to_reach(case.times_s, case.worst_sd, WANTED_SD)
        reached = after if np.isfinite(after) else f"not within {cell(case.times_s[-1])}"
        unknown = ", ".join(case.unknown) or "none"
        rank, smallest = f"{case.rank.rank} of {case.rank.size}", f"{case.rank.relative[-1]:.1e}"
        rows.append((case.name, unknown, rank, smallest, *case.worst_sd[at], reached))
    header = (
        "motion",
        f"not known after {cell(lengths[1])} s",
        "local rank",
        "smallest singular value",
        *(f"worst sd of a ratio, {cell(length)} s" for length in lengths),
        f"sd {WANTED_SD:g} after, s",
    )
    return table("arcs", header, rows, 2)


def arc_figure(cases: Sequence[ArcCase]) -> StudyFigure:
    """The ratio known least against the length of the arc."""
    curves = [Curve(case.name, case.worst_sd[1:], case.times_s[1:]) for case in cases]
    levels, times_s = {"wanted": WANTED_SD}, cases[0].times_s
    panel = Panel("sd of the ratio known least", curves, Scale.LOG, levels=levels)
    label = "length of the arc, s"
    return StudyFigure(
        "arc_length", panels_figure(times_s, [panel], row_in=2.7, at_label=label, log_at=True)
    )


def comparison_table(found: Estimates, prior: AttitudeInertiaTable) -> TextTable:
    """Expected standard deviations of the ratios against the spread of runs that start so."""
    times_s = found.motion.times_s
    subject = attitude_subject(found.name, prior, found.motion.body.state, times_s)
    arc = subject.arc.first(subject.frames)
    known = expected_uncertainty(arc, subject.prior_covariance, ROTATION.output_jacobian)
    rows = []
    for part in (0.25, 0.5, 1.0):
        at_s = part * float(times_s[-1])
        k, j = (int(np.argmin(np.abs(times - at_s))) for times in (times_s, known.times_s))
        spread = np.sqrt(np.mean(found.errors[k, :, INERTIA] ** 2, axis=0))
        for name, seen, sd in zip(RATIO_NAMES, spread, known.sd[j, INERTIA], strict=True):
            rows.append((f"{name}, {at_s:g} s", sd, seen, seen / sd))
    runs = f"RMS error of {found.errors.shape[1]} runs"
    return table("predicted", ("ratio and arc", "expected sd", runs, "over expected"), rows)
