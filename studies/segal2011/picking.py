"""How often the true inertia is picked from a bank that holds it, and whether it can be."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pcnav.batch.monte_carlo import Case
from pcnav.core.arrays import BoolArray, IntArray
from pcnav.files.text_table import TextTable

from ..tables import table_of
from . import paper
from .observability import OBSERVABLE_SD, ArcInformation, arc_information
from .runs import Bank, Found

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


def picks_of(name: str, case: Case[Bank], found: Found, among: IntArray, truth: int) -> Picks:
    """Whether the truth, one of some hypotheses, is the most probable at the end."""
    motion = case.settings.motion
    information, exact = (
        arc_information(
            *(paper.TARGET_INERTIA, motion.omega_body[0], motion.times_s),
            *(paper.ATTITUDE_SD_RAD, float(axes_sd_rad)),
        )
        for axes_sd_rad in (np.radians(case.settings.table.attitude_sd_deg), _EXACT_AXES_RAD)
    )
    others = found.inertia[[k for k in among if k != truth]]
    apart = np.array(
        [
            min(information.separation(paper.TARGET_INERTIA, other) for other in run)
            for run in np.swapaxes(others, 0, 1)
        ]
    )
    return Picks(
        name=name,
        information=information,
        rank=6 + int(np.sum(exact.standard_deviations() < _MEANINGLESS_SD)),
        observable=apart >= SEPARATED,
        right=found.picked(among)[-1] == truth,
        right_printed=found.picked(among, printed=True)[-1] == truth,
    )


def picking_table(picks: Sequence[Picks]) -> TextTable:
    """One row per motion."""

    def share(right: BoolArray) -> object:
        return 100.0 * float(np.mean(right)) if len(right) else "none such"

    def least_known(each: Picks) -> object:
        sd = float(each.information.standard_deviations()[-1])
        return "unobservable" if sd > _MEANINGLESS_SD else sd

    return table_of(
        "picking",
        "The true inertia among the hypotheses: how often it is picked",
        picks,
        {
            "motion": lambda each: each.name,
            "runs": lambda each: len(each.right),
            "rank of 11": lambda each: each.rank,
            "best known inertia parameter, sd": lambda each: each.information.standard_deviations()[
                0
            ],
            "least known, sd": least_known,
            "all ratios observable": lambda each: each.information.observable,
            "runs with the truth observable": lambda each: each.observable.sum(),
            "picked there, %": lambda each: share(each.right[each.observable]),
            "picked elsewhere, %": lambda each: share(each.right[~each.observable]),
            "picked, %": lambda each: share(each.right),
            "picked by (12), %": lambda each: share(each.right_printed),
        },
        "Inertia over its mean moment. The rank is that of Deng et al. 2024, taken along the arc: "
        "directions of the inertia with a standard deviation above ten mean moments do not count. "
        f"All ratios are called observable when the least known is below {OBSERVABLE_SD:g}.",
    )
