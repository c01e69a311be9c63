"""How long one has to look: information of finite arcs beside the local rank."""

from dataclasses import dataclass

import numpy as np

from pcnav.config.attitude_inertia import AttitudeInertiaTable
from pcnav.core.arrays import FloatArray
from pcnav.estimators.attitude_inertia.rotation_model import (
    INERTIA,
    RotationState,
    parameters_from_printed,
)
from pcnav.evaluation.knowledge import MAX_PRIOR_SHARE
from pcnav.evaluation.observability.attitude import attitude_rank
from pcnav.evaluation.observability.information import expected_knowledge, time_to_reach
from pcnav.evaluation.observability.rank import ObservabilityRank
from pcnav.evaluation.observability.subjects import attitude_subject
from pcnav.evaluation.observability.told import ROTATION
from pcnav.files.text_table import TextTable, number

from ..folder import Chapter
from . import paper
from .consistency import CaseResult
from .curves import decay_figure

WANTED_SD = 0.01
TILTS_DEG = (0.0, 0.1, 1.0, 5.0, 20.0)
"""Of the rate away from the middle principal axis of the body of Fig. 6."""
ARC_S, _INTERVAL_S = 1000.0, 1.0
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


def arc_cases(arc_s: float = ARC_S) -> list[ArcCase]:
    """The printed nutation, and spins that wobble more and more."""
    rate = paper.NUTATION_RATE_DEG_S
    cases = [_case("printed, nutation", paper.NUTATION_RATIOS, rate, arc_s)]
    for tilt in TILTS_DEG:
        turned = np.radians(tilt)
        # The printed spin is about the axis of the largest moment; the tilt is towards x and z.
        side = np.sin(turned) / np.sqrt(2.0)
        tilted = (5.0 * side, float(5.0 * np.cos(turned)), 5.0 * side)
        cases.append(_case(f"spin tilted by {tilt:g} deg", paper.SPIN_RATIOS, tilted, arc_s))
    return cases


def _case(
    name: str, ratios: tuple[float, ...], rate_deg_s: tuple[float, ...], arc_s: float
) -> ArcCase:
    start = RotationState(
        np.eye(3), np.radians(rate_deg_s), parameters_from_printed(np.array(ratios))
    )
    times_s = np.arange(0.0, arc_s + 0.5 * _INTERVAL_S, _INTERVAL_S)
    subject = attitude_subject(name, _TABLE, start, times_s)
    whole = expected_knowledge(subject.arc, subject.prior_covariance, ROTATION.edge)
    at_end = subject.frames - 1
    share = whole.prior_part[at_end, INERTIA] / whole.sd[at_end, INERTIA] ** 2
    unknown = [
        ratio
        for ratio, part in zip(ROTATION.names[INERTIA], share, strict=True)
        if part > MAX_PRIOR_SHARE
    ]
    rank = attitude_rank((0.0, 0.0, 0.0, 1.0), start.omega_body.tolist(), ratios)
    worst = np.max(whole.sd[:, INERTIA], axis=1)
    return ArcCase(name, rank, tuple(unknown), whole.times_s, worst)


def arc_chapter(cases: list[ArcCase], compared: CaseResult) -> Chapter:
    """Rank, smallest singular value, and the arcs that a wanted accuracy takes."""
    rows = []
    longest = float(cases[0].times_s[-1])
    lengths = (0.025 * longest, 0.25 * longest, longest)
    for case in cases:
        at = [int(np.argmin(np.abs(case.times_s - length))) for length in lengths]
        after = time_to_reach(case.times_s, case.worst_sd, WANTED_SD)
        rows.append(
            (
                case.name,
                ", ".join(case.unknown) or "none",
                f"{case.rank.rank} of {case.rank.size}",
                f"{case.rank.relative[-1]:.1e}",
                *(number(float(case.worst_sd[k])) for k in at),
                number(after) if np.isfinite(after) else f"not within {number(case.times_s[-1])}",
            )
        )
    header = (
        "motion",
        f"not known after {number(lengths[1])} s",
        "local rank",
        "smallest singular value",
        *(f"worst sd of a ratio, {number(length)} s" for length in lengths),
        f"sd {WANTED_SD:g} after, s",
    )
    table = TextTable(
        "arcs",
        "Local rank and what arcs tell",
        header,
        tuple(rows),
        f"Attitudes of {_TABLE.attitude_sd_deg:g} deg every {_INTERVAL_S:g} s; prior sd of the "
        f"ratios {_TABLE.inertia_ratio_sd:g}. The bodies turn at 5 deg/s (nutation: 6.5 deg/s).",
        text_columns=2,
    )
    text = (
        "Rank 11 says that an endless look without noise would tell all ratios. How long one has "
        "to look with a real sensor is told by the information of the arc. A spin that wobbles by "
        "a tenth of a degree has rank 11 and is of as little use as the spin itself.",
    )
    figure = decay_figure(
        "arc_length",
        "Worst standard deviation of an inertia ratio",
        "Expected of a filter that is right about the motion.",
        {case.name: (case.times_s, case.worst_sd) for case in cases},
        WANTED_SD,
        "sd of the ratio known least",
    )
    return Chapter("Arcs of finite length", text, (table, _comparison(compared)), (figure,))


def _comparison(result: CaseResult) -> TextTable:
    """Expected standard deviations of the ratios against the spread of the runs."""
    motion, case = result.case.motion, result.case
    table = _TABLE.model_copy(
        update={
            "attitude_sd_deg": case.attitude_sd_deg,
            "rate_sd_deg_s": case.rate_sd_deg_s,
            "inertia_ratio_sd": case.ratio_sd,
        }
    )
    subject = attitude_subject(case.name, table, motion.truth(0), motion.times_s)
    known = expected_knowledge(
        subject.arc.first(subject.frames), subject.prior_covariance, ROTATION.edge
    )
    rows = []
    for time_s in (0.25, 0.5, 1.0):
        at_s = time_s * float(motion.times_s[-1])
        k = int(np.argmin(np.abs(motion.times_s - at_s)))
        j = int(np.argmin(np.abs(known.times_s - at_s)))
        spread = np.sqrt(np.mean(result.errors[k, :, INERTIA] ** 2, axis=0))
        for name, seen, expected in zip(
            ROTATION.names[INERTIA], spread, known.sd[j, INERTIA], strict=True
        ):
            values = (number(float(expected)), number(float(seen)))
            rows.append((f"{name}, {at_s:g} s", *values, number(float(seen / expected))))
    return TextTable(
        "predicted",
        "Expected standard deviations against the errors of the runs",
        ("ratio and arc", "expected sd", f"RMS error of {case.runs} runs", "over expected"),
        tuple(rows),
        f"Case: {case.name}.",
    )
