"""How often the true inertia is picked from a bank that holds it, and whether it can be.

Deng, Wang, Ge et al. 2024 ask for the rank of Lie derivatives of an attitude measurement by
attitude, rate and inertia ratios. The rank says what an endless, noiseless arc would show at
an instant. Here the same derivatives are taken along the arc that was seen and weighed by its
noise, so that the answer is a standard deviation: a ratio that Deng's rank calls observable may
still be hidden in the noise of a short arc, and one that it calls unobservable has none.

Feature points show how the target turned since the first frame, not which way the axes of a
hypothesis lie in it. That is known before to some degrees only; it is one of the unknowns.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pcnav.batch.monte_carlo import Case
from pcnav.core.arrays import BoolArray, FloatArray, IntArray
from pcnav.dynamics.inertia_parameters import parameters_of
from pcnav.estimators.attitude_inertia.rotation_model import (
    INERTIA,
    SIZE,
    THETA,
    RotationState,
    TorqueFreeModel,
)
from pcnav.files.text_table import TextTable

from ..tables import table_of
from . import paper
from .runs import Bank, Found

OBSERVABLE_SD = 0.05
"""Over the mean moment of inertia, in the least known direction: below it, the arc shows all five
inertia parameters to a twentieth."""
SEPARATED = 5.0
"""Standard deviations between the truth and every other hypothesis from which a run counts as one
in which the truth is observable: two hypotheses are then confused in 0.6 % of runs."""
_EXACT_AXES_RAD = 1e-9
_MEANINGLESS_SD = 10.0


@dataclass(frozen=True)
class ArcInformation:
    """What an arc tells of the inertia, the rest of the motion unknown."""

    root: FloatArray
    """(5, 5) R of the information R^T R on the parameters N = 3 I / tr(I) (yy, zz, xy, xz, yz)."""

    def standard_deviations(self) -> FloatArray:
        """(5,) along the principal directions, best known first; boundless for unobservable."""
        with np.errstate(divide="ignore"):
            return np.asarray(1.0 / np.linalg.svd(self.root, compute_uv=False))

    @property
    def observable(self) -> bool:
        """Whether all five parameters are known better than `OBSERVABLE_SD`."""
        return bool(self.standard_deviations()[-1] < OBSERVABLE_SD)

    def separation(self, inertia: FloatArray, other: FloatArray) -> float:
        """How many standard deviations apart two inertia matrices are in this arc.

        To first order; the log likelihoods of the two then differ by half of its square.
        """
        apart = parameters_of(other) - parameters_of(inertia)
        return float(np.linalg.norm(self.root @ apart))


def arc_information(
    inertia: FloatArray,
    omega_body: FloatArray,
    times_s: FloatArray,
    attitude_sd_rad: float,
    axes_sd_rad: float,
) -> ArcInformation:
    """Information of an arc of attitudes on the inertia (3, 3) of a body with a rate at its start.

    Args:
        inertia: of any scale, body axes.
        omega_body: (3,) rad/s.
        times_s: (n,) of the frames.
        attitude_sd_rad: of the turn since the first frame, about each axis, of every frame.
        axes_sd_rad: how well the body axes are known within the points before the arc.

    Unknowns that are eliminated: attitude at the first frame, rate, and the axes of the body.
    """
    model = TorqueFreeModel(0.0)
    state = RotationState(np.eye(3), omega_body, parameters_of(inertia))
    transition = np.eye(SIZE)
    rows = [np.hstack([np.eye(3) / axes_sd_rad, np.zeros((3, SIZE))])]
    for step_s in np.diff(times_s, prepend=times_s[0]).tolist():
        if step_s > 0.0:
            state, step, _ = model.propagate(state, 0.0, step_s)
            transition = step @ transition
        # The points turn as the body does, and lie in it by a turn that does not change.
        rows.append(np.hstack([np.eye(3), transition[THETA]]) / attitude_sd_rad)
    jacobian = np.concatenate(rows)
    # The inertia stands last: what the others leave of it is the last block of the root.
    wanted = slice(3 + INERTIA.start, 3 + INERTIA.stop)
    # To a unit length: rates and angles differ by orders of magnitude.
    jacobian[:, : wanted.start] /= np.linalg.norm(jacobian[:, : wanted.start], axis=0)
    _, root = np.linalg.qr(jacobian)
    return ArcInformation(root[wanted, wanted])


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
    )
