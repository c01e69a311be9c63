"""Rotation of a target seen from a turning chaser.

Segal, Carmi and Gurfil 2011 propagate the angular velocity of the target relative to the chaser,
in the chaser's axes (19). pcnav propagates the target's inertial angular velocity in its own body
axes: Euler's equation, without the chaser in it. The two are one motion in two descriptions;
`relative_rate` and `inertial_rate` change between them.
"""

import numpy as np

from pcnav.core.arrays import FloatArray


def relative_rate(
    R_chaser_body: FloatArray, omega_body: FloatArray, omega_chaser: FloatArray
) -> FloatArray:
    """(..., 3) rate of the target relative to the chaser, chaser axes: ``D w_T - w_C`` (16e).

    Of the target's inertial rate in body axes and the chaser's inertial rate in its own axes,
    rad/s; ``D`` turns body into chaser components.
    """
    return np.asarray((R_chaser_body @ omega_body[..., None])[..., 0] - omega_chaser)


def inertial_rate(
    R_chaser_body: FloatArray, relative: FloatArray, omega_chaser: FloatArray
) -> FloatArray:
    """(..., 3) inertial rate of the target in body axes: the inverse of `relative_rate`."""
    R_body_chaser = np.swapaxes(R_chaser_body, -1, -2)
    return np.asarray((R_body_chaser @ (relative + omega_chaser)[..., None])[..., 0])


def relative_rate_derivative(
    R_chaser_body: FloatArray,
    relative: FloatArray,
    inertia_body: FloatArray,
    omega_chaser: FloatArray,
    omega_chaser_rate: FloatArray,
) -> FloatArray:
    """(3,) derivative of `relative_rate`, seen in chaser axes, rad/s^2, no torque on the target.

    Segal 2011 (19). Its brackets are damaged in print; derived afresh from
    ``w + w_C = D w_T`` and ``D' = [w]x D``::

        w' = D I_T^-1 (-w_T x I_T w_T) - w_C x w - w_C'

    The printed ``I_C^-1 (N_C - w_C x I_C w_C)`` is ``w_C'``: what a chaser that is kept aligned
    with the Hill axes needs is known without its inertia.
    """
    omega_body = inertial_rate(R_chaser_body, relative, omega_chaser)
    torque = -np.cross(omega_body, inertia_body @ omega_body)
    turned = R_chaser_body @ np.linalg.solve(inertia_body, torque)
    return np.asarray(turned - np.cross(omega_chaser, relative) - omega_chaser_rate)
