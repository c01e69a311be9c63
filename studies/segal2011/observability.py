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
from pcnav.core.spatial import exp_rotation, log_rotation
from pcnav.dynamics.inertia_parameters import parameters_from_ratios, ratios_from_parameters
from pcnav.dynamics.rigid_body import inertia_from_ratios, ratios_from_inertia
from pcnav.dynamics.rotation_step import rotate, torque_free

_STEP = 1e-5
_PARAMETERS = 5
OBSERVABLE_SD = 0.05
"""Over the mean moment of inertia, in the least known direction: below it, the arc shows all five
inertia parameters to a twentieth."""


@dataclass(frozen=True)
class ArcInformation:
    """What an arc tells of the inertia, the rest of the motion unknown."""

    information: FloatArray
    """(5, 5) of the parameters N = 3 I / tr(I) (yy, zz, xy, xz, yz)."""

    def standard_deviations(self) -> FloatArray:
        """(5,) along the principal directions, best known first; infinite for unobservable."""
        values = np.maximum(np.linalg.eigvalsh(self.information), 0.0)[::-1]
        with np.errstate(divide="ignore"):
            return np.asarray(1.0 / np.sqrt(values))

    @property
    def observable(self) -> bool:
        """Whether all five parameters are known better than `OBSERVABLE_SD`."""
        return bool(self.standard_deviations()[-1] < OBSERVABLE_SD)

    def separation(self, inertia: FloatArray, other: FloatArray) -> float:
        """How many standard deviations apart two inertia matrices are in this arc.

        To first order; the log likelihoods of the two then differ by half of its square.
        """
        apart = _parameters(other) - _parameters(inertia)
        return float(np.sqrt(np.maximum(apart @ self.information @ apart, 0.0)))


def _parameters(inertia: FloatArray) -> FloatArray:
    return parameters_from_ratios(ratios_from_inertia(inertia))


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
        times_s: (n,) of the frames, evenly spaced.
        attitude_sd_rad: of the turn since the first frame, about each axis, of every frame.
        axes_sd_rad: how well the body axes are known within the points before the arc.

    Derivatives are numerical. Unknowns that are eliminated: attitude at the first frame, rate, and
    the axes of the body.
    """
    jacobian = _derivatives(inertia, omega_body, times_s) / attitude_sd_rad
    size = jacobian.shape[-1]
    flat = jacobian.reshape(-1, size)
    full = flat.T @ flat
    axes = slice(6, 9)
    full[axes, axes] += np.eye(3) / axes_sd_rad**2
    rest, wanted = slice(0, size - _PARAMETERS), slice(size - _PARAMETERS, size)
    # Scaled to a unit diagonal: rates and angles differ by orders of magnitude.
    scale = 1.0 / np.sqrt(np.diagonal(full)[rest])
    nuisance = full[rest, rest] * scale * scale[:, None]
    cross = full[rest, wanted] * scale[:, None]
    left = full[wanted, wanted] - cross.T @ np.linalg.pinv(nuisance, hermitian=True) @ cross
    return ArcInformation(0.5 * (left + left.T))


def _derivatives(inertia: FloatArray, omega_body: FloatArray, times_s: FloatArray) -> FloatArray:
    """(n, 3, 14) of the turn since the first frame, world axes.

    By an offset of it, by the rate (world axes), the body axes and the inertia parameters.
    """
    parameters = _parameters(inertia)
    unknowns = np.repeat(np.eye(11), 2, axis=0)
    unknowns[1::2] *= -1.0
    # A rate's natural unit is a radian over the arc.
    rate_unit = 1.0 / max(float(times_s[-1] - times_s[0]), 1.0)
    bodies = []
    for unknown in _STEP * unknowns:
        ratios = ratios_from_parameters(parameters + unknown[6:])
        turn = exp_rotation(unknown[3:6])
        bodies.append(turn @ inertia_from_ratios(ratios) @ turn.T)
    tensors = np.stack(bodies)
    rates = omega_body + _STEP * rate_unit * unknowns[:, :3]
    # Body axes at the first frame serve as world axes.
    slope = torque_free(tensors, np.asarray(np.linalg.inv(tensors)))
    R = np.broadcast_to(np.eye(3), tensors.shape)
    jacobian = np.zeros((len(times_s), 3, 14))
    jacobian[..., :3] = np.eye(3)
    for k in range(1, len(times_s)):
        step = rotate(slope, rates, float(times_s[k] - times_s[k - 1]))
        R, rates = R @ step.turn, step.omega_body
        apart = log_rotation(R[0::2] @ np.swapaxes(R[1::2], -1, -2)) / (2.0 * _STEP)
        jacobian[k, :, 3:] = apart.T
    return jacobian
