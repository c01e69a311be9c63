"""How often the true inertia is picked from a bank that holds it, and whether it can be."""

from dataclasses import dataclass

import numpy as np

from pcnav.core.arrays import BoolArray, IntArray
from pcnav.files.text_table import TextTable, number

from ..folder import Chapter
from . import paper
from .campaign import CaseResult
from .observability import OBSERVABLE_SD, ArcInformation, arc_information
from .paper import Motion

SEPARATED = 5.0
"""Standard deviations between the truth and every other hypothesis from which a run counts as one
in which the truth is observable: two hypotheses are then confused in 0.6 % of runs."""
_EXACT_AXES_RAD = 1e-9
_MEANINGLESS_SD = 10.0


@dataclass(frozen=True)
class Picks:
    """What happened in the runs of one motion."""

    name: str
    information: ArcInformation
    rank: int
    """Of attitude, rate and inertia ratios, out of 11, with the attitude itself measured."""
    observable: BoolArray
    """(runs,)"""
    right: BoolArray
    """(runs,) by innovation covariance."""
    right_printed: BoolArray
    """(runs,) by (12)."""


def picks_of(name: str, result: CaseResult, among: IntArray, truth: int) -> Picks:
    """Whether the truth, one of some hypotheses, is the most probable at the end."""
    information = _information(result.motion, np.radians(result.table.attitude_sd_deg))
    exact = _information(result.motion, _EXACT_AXES_RAD)
    others = [k for k in among if k != truth]
    apart = np.array(
        [
            min(information.separation(paper.TARGET_INERTIA, run[k]) for k in others)
            for run in result.inertia
        ]
    )
    return Picks(
        name=name,
        information=information,
        rank=6 + int(np.sum(exact.standard_deviations() < _MEANINGLESS_SD)),
        observable=apart >= SEPARATED,
        right=result.picked(among)[-1] == truth,
        right_printed=result.picked(among, printed=True)[-1] == truth,
    )


def _information(motion: Motion, axes_sd_rad: float) -> ArcInformation:
    return arc_information(
        paper.TARGET_INERTIA,
        motion.omega_body[0],
        motion.times_s,
        paper.ATTITUDE_SD_RAD,
        float(axes_sd_rad),
    )


def picking_chapter(picks: list[Picks]) -> Chapter:
    """One row per motion."""
    rows = tuple(
        (
            each.name,
            str(len(each.right)),
            str(each.rank),
            number(float(each.information.standard_deviations()[0])),
            _sd(float(each.information.standard_deviations()[-1])),
            "yes" if each.information.observable else "no",
            str(int(each.observable.sum())),
            _share(each.right[each.observable]),
            _share(each.right[~each.observable]),
            _share(each.right),
            _share(each.right_printed),
        )
        for each in picks
    )
    header = (
        "motion",
        "runs",
        "rank of 11",
        "best known inertia parameter, sd",
        "least known, sd",
        "all ratios observable",
        "runs with the truth observable",
        "picked there, %",
        "picked elsewhere, %",
        "picked, %",
        "picked by (12), %",
    )
    table = TextTable(
        "picking",
        "The true inertia among the hypotheses: how often it is picked",
        header,
        rows,
        "Inertia over its mean moment. The rank is that of Deng et al. 2024, taken along the arc: "
        "directions of the inertia with a standard deviation above ten mean moments do not count. "
        f"All ratios are called observable when the least known is below {OBSERVABLE_SD:g}.",
    )
    return Chapter(
        "Is the true inertia found?",
        (
            "The truth takes the place of the last of the five draws. Whether an arc can tell it "
            "from the others depends on the motion and on how far the others are: the information "
            "that the arc has on the inertia, with attitude, rate and body axes eliminated, gives "
            f"the distance between two hypotheses. From {SEPARATED:g} standard deviations to the "
            "nearest, a run counts as one in which the truth is observable.",
            "The study lets the filters know the attitude of the body axes to "
            f"{paper.BANK.attitude_sd_deg:g} degree, because the paper starts all runs at one "
            "attitude. The second and third rows show what the picks owe to that and to the length "
            "of the arc, neither of which is printed.",
            "That all five ratios be observable is more than a bank needs: it only has to tell a "
            "few matrices apart, along directions that the motion shows. In a pure spin three "
            "directions are not shown at all. Among hypotheses that differ in those alone the "
            "frames cannot decide, and what is left is how surprising a steady spin is: bodies of "
            "nearly equal moments spin steadily about any axis, the true one does so only about "
            "its principal axes. So the likelihood leans a little to the former.",
        ),
        (table,),
    )


def _share(right: BoolArray) -> str:
    return number(100.0 * float(np.mean(right))) if len(right) else "none such"


def _sd(value: float) -> str:
    return "unobservable" if value > _MEANINGLESS_SD else number(value)
