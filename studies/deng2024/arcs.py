"""How long one has to look: information of finite arcs beside the local rank."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pcnav.config.attitude_inertia import AttitudeInertiaTable
from pcnav.core.arrays import FloatArray
from pcnav.estimators.attitude_inertia.rotation_model import INERTIA
from pcnav.evaluation.knowledge import MAX_PRIOR_SHARE
from pcnav.evaluation.observability.attitude import attitude_rank
from pcnav.evaluation.observability.information import expected_knowledge, time_to_reach
from pcnav.evaluation.observability.rank import ObservabilityRank
from pcnav.evaluation.observability.subjects import attitude_subject
from pcnav.evaluation.observability.told import ROTATION
from pcnav.files.text_table import TextTable

from ..folder import StudyFigure
from ..panels import Curve, Panel, Scale, panels_figure
from ..tables import cell, table
from . import paper
from .consistency import CaseResult
from .estimates import RATIO_NAMES

WANTED_SD = 0.01
TILTS_DEG = (0.0, 0.1, 1.0, 5.0, 20.0)
"""Of the rate away from the middle principal axis of the body of Fig. 6."""
_INTERVAL_S = 1.0
_TABLE = AttitudeInertiaTable(
    rate_sd_deg_s=5.0,
    inertia_ratio_sd=0.3,
    attitude_sd_deg=0.5,
    angular_acceleration_psd_rad2_s3=0.0,
)


@dataclass(frozen=True)
class ArcCase:
    """A motion, and what arcs of it tell."""

    name: str
    rank: ObservabilityRank
    unknown: tuple[str, ...]
    """Ratios of which the prior speaks after the arc, a quarter of the times."""
    times_s: FloatArray
    """(n,)"""
    worst_sd: FloatArray
    """(n,) of the inertia ratio that is known least."""


@dataclass(frozen=True)
class ArcMotion:
    """How a body begins to turn, and how long it is looked at."""

    name: str
    ratios: Sequence[float]
    rate_deg_s: Sequence[float]
    length_s: float


def arc_motions(length_s: float) -> list[ArcMotion]:
    """The printed nutation, and spins that wobble more and more."""
    nutation = (paper.NUTATION_RATIOS, paper.NUTATION_RATE_DEG_S)
    motions = [ArcMotion("printed, nutation", *nutation, length_s)]
    for tilt in TILTS_DEG:
        turned = np.radians(tilt)
        # The printed spin is about the axis of the largest moment; the tilt is towards x and z.
        side = np.sin(turned) / np.sqrt(2.0)
        rate = (5.0 * side, float(5.0 * np.cos(turned)), 5.0 * side)
        name = f"spin tilted by {tilt:g} deg"
        motions.append(ArcMotion(name, paper.SPIN_RATIOS, rate, length_s))
    return motions


def arc_case(motion: ArcMotion) -> ArcCase:
    """What arcs of a motion tell, up to its whole length."""
    name, ratios = motion.name, motion.ratios
    start = paper.state_of(ratios, motion.rate_deg_s)
    times_s = np.arange(0.0, motion.length_s + 0.5 * _INTERVAL_S, _INTERVAL_S)
    subject = attitude_subject(name, _TABLE, start, times_s)
    whole = expected_knowledge(subject.arc, subject.prior_covariance, ROTATION.edge)
    at_end = subject.frames - 1
    share = whole.prior_part[at_end, INERTIA] / whole.sd[at_end, INERTIA] ** 2
    unknown = np.array(RATIO_NAMES)[share > MAX_PRIOR_SHARE].tolist()
    rank = attitude_rank((0.0, 0.0, 0.0, 1.0), start.omega_body.tolist(), ratios)
    worst = np.max(whole.sd[:, INERTIA], axis=1)
    return ArcCase(name, rank, tuple(unknown), whole.times_s, worst)


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
    return table(
        "arcs",
        "Local rank and what arcs tell",
        header,
        rows,
        f"Attitudes of {_TABLE.attitude_sd_deg:g} deg every {_INTERVAL_S:g} s; prior sd of the "
        f"ratios {_TABLE.inertia_ratio_sd:g}. The bodies turn at 5 deg/s (nutation: 6.5 deg/s).",
        text_columns=2,
    )


def arc_figure(cases: Sequence[ArcCase]) -> StudyFigure:
    """The ratio known least against the length of the arc."""
    curves = [Curve(case.name, case.worst_sd[1:], case.times_s[1:]) for case in cases]
    levels = {"wanted": WANTED_SD}
    panel = Panel("sd of the ratio known least", curves, Scale.LOG, levels=levels)
    return panels_figure(
        "arc_length",
        "Worst standard deviation of an inertia ratio",
        "Expected of a filter that is right about the motion.",
        cases[0].times_s,
        [panel],
        row_in=2.7,
        at_label="length of the arc, s",
        log_at=True,
    )


def comparison_table(result: CaseResult) -> TextTable:
    """Expected standard deviations of the ratios against the spread of the runs."""
    motion, case = result.case.motion, result.case
    prior = _TABLE.model_copy(
        update={"rate_sd_deg_s": case.rate_sd_deg_s, "inertia_ratio_sd": case.ratio_sd}
    )
    subject = attitude_subject(case.name, prior, motion.start, motion.times_s)
    arc = subject.arc.first(subject.frames)
    known = expected_knowledge(arc, subject.prior_covariance, ROTATION.edge)
    rows = []
    for part in (0.25, 0.5, 1.0):
        at_s = part * float(motion.times_s[-1])
        k, j = (int(np.argmin(np.abs(times - at_s))) for times in (motion.times_s, known.times_s))
        spread = np.sqrt(np.mean(result.found.errors[k, :, INERTIA] ** 2, axis=0))
        for name, seen, sd in zip(RATIO_NAMES, spread, known.sd[j, INERTIA], strict=True):
            rows.append((f"{name}, {at_s:g} s", sd, seen, seen / sd))
    return table(
        "predicted",
        "Expected standard deviations against the errors of the runs",
        ("ratio and arc", "expected sd", f"RMS error of {case.runs} runs", "over expected"),
        rows,
        f"Case: {case.name}.",
    )
