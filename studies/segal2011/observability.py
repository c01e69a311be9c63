"""Whether a motion shows the inertia: Deng's question, answered by the information of the arc.

Deng, Wang, Ge et al. 2024 ask for the rank of Lie derivatives of an attitude measurement by
attitude, rate and inertia ratios. The rank says what an endless, noiseless arc would show at
an instant. Here the same derivatives are taken along the arc that was seen and weighed by its
noise, so that the answer is a standard deviation: a ratio that Deng's rank calls observable may
still be hidden in the noise of a short arc, and one that it calls unobservable has none.

Feature points show how the target turned since the first frame, not which way the axes of a
hypothesis lie in it. That is known before to some degrees only; it is one of the unknowns.
"""

from dataclasses import dataclass

import numpy as np

from pcnav.core.arrays import FloatArray
from pcnav.dynamics.inertia_parameters import parameters_of
from pcnav.estimators.attitude_inertia.rotation_model import (
    INERTIA,
    SIZE,
    THETA,
    RotationState,
    TorqueFreeModel,
)

OBSERVABLE_SD = 0.05
"""Over the mean moment of inertia, in the least known direction: below it, the arc shows all five
inertia parameters to a twentieth."""


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
