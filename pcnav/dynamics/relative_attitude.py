"""Rotation of a target seen from a turning chaser, and torque-free steps of many bodies at once.

Segal, Carmi and Gurfil 2011 propagate the angular velocity of the target relative to the chaser,
in the chaser's axes (19). pcnav propagates the target's inertial angular velocity in its own body
axes: Euler's equation, without the chaser in it. The two are one motion in two descriptions;
`relative_rate` and `inertial_rate` change between them.
"""

from dataclasses import dataclass

import numpy as np

from pcnav.arrays import FloatArray
from pcnav.spatial import exp_rotation, left_jacobian, skew

_LARGEST_TURN_RAD = 0.1
"""Rotation in one Runge-Kutta step: its error, of order turn^5 / 120, stays below 1e-7 rad."""


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


@dataclass(frozen=True)
class TorqueFreeStep:
    """Rotation of bodies over a step."""

    turn: FloatArray
    """(..., 3, 3) R_body0_body1: the attitude after the step is ``R_world_body @ turn``."""
    omega_body: FloatArray
    """(..., 3) inertial rate after the step, rad/s."""
    transition: FloatArray
    """(..., 6, 6) of the errors of attitude (body axes, right) and rate."""


def step_torque_free(
    inertia: FloatArray, inverse: FloatArray, omega_body: FloatArray, step_s: float
) -> TorqueFreeStep:
    """Turn bodies of inertia (..., 3, 3), of any scale, with rates (..., 3) by a time step.

    Runge-Kutta of order 4 for the rate and its derivative by the start, the Magnus series of
    order 4 for the attitude, in as many steps as keep the turn small. The inverse inertia is handed
    in because callers step the same bodies many times.
    """
    fastest = float(np.sqrt(np.max(np.sum(omega_body**2, axis=-1), initial=0.0)))
    steps = max(1, int(np.ceil(fastest * abs(step_s) / _LARGEST_TURN_RAD)))
    done = _step(inertia, inverse, omega_body, step_s / steps)
    for _ in range(steps - 1):
        more = _step(inertia, inverse, done.omega_body, step_s / steps)
        done = TorqueFreeStep(
            done.turn @ more.turn, more.omega_body, more.transition @ done.transition
        )
    return done


def _step(inertia: FloatArray, inverse: FloatArray, omega: FloatArray, h: float) -> TorqueFreeStep:
    # Column 0 is the rate, the others its derivatives by the rate at the start.
    y = np.concatenate([omega[..., None], np.broadcast_to(np.eye(3), (*omega.shape, 3))], axis=-1)
    k1 = _slope(inertia, inverse, y)
    k2 = _slope(inertia, inverse, y + 0.5 * h * k1)
    k3 = _slope(inertia, inverse, y + 0.5 * h * k2)
    k4 = _slope(inertia, inverse, y + h * k3)
    after = y + h / 6.0 * (k1 + 2.0 * (k2 + k3) + k4)
    # Cubic Hermite interpolation gives the mid-point to order 4.
    middle = 0.5 * (y + after) + h / 8.0 * (k1 - k4)
    mean = h / 6.0 * (y + 4.0 * middle + after)
    w0, w1 = omega, after[..., 0]
    phi = mean[..., 0] + h**2 / 12.0 * np.cross(w0, w1)
    by_omega = mean[..., 1:] + h**2 / 12.0 * (skew(w0) @ after[..., 1:] - skew(w1) @ y[..., 1:])
    turn = exp_rotation(phi)
    transition = np.zeros((*omega.shape[:-1], 6, 6))
    transition[..., :3, :3] = np.swapaxes(turn, -1, -2)
    transition[..., :3, 3:] = left_jacobian(-phi) @ by_omega
    transition[..., 3:, 3:] = after[..., 1:]
    return TorqueFreeStep(turn, w1, transition)


def _slope(inertia: FloatArray, inverse: FloatArray, y: FloatArray) -> FloatArray:
    """Of Euler's equation and of its variational equation, ``I D' = ([I w]x - [w]x I) D``."""
    momentum = inertia @ y
    omega = skew(y[..., 0])
    torque = -omega @ momentum
    torque[..., 1:] += skew(momentum[..., 0]) @ y[..., 1:]
    return np.asarray(inverse @ torque)
