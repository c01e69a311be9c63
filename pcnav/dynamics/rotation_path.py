"""Torque-free rotation along many times at once, with its derivatives.

Step by step, an arc of hundreds of frames costs hundreds of small matrix products in each of them.
Only the rate has to be followed in turn, and of it Euler's equation in principal axes is three
products. Once the rate is known at every time, the steps from one time to the next are independent
of each other: they are one batch.
"""

import math
from dataclasses import dataclass

import numpy as np

from pcnav.core.arrays import FloatArray
from pcnav.dynamics.rotation_step import Slope, rotate_each, steps_over

_RIGHT_HANDED = np.array([1.0, 1.0, -1.0])


@dataclass(frozen=True)
class RotationPath:
    """A body's rotation from the first of n times to each of them."""

    turn: FloatArray
    """(n, 3, 3) R_first_body: the attitude is ``R_world_first @ turn``."""
    omega_body: FloatArray
    """(n, 3) rad/s."""
    transition: FloatArray
    """(n, 3 + k, 3 + k) of errors of the attitude (right, body axes) and of the k quantities of the
    slope, of which those besides the rate stay what they are."""


def path_along(
    slope: Slope,
    inertia: FloatArray,
    omega_body: FloatArray,
    times_s: FloatArray,
    quantities: int = 3,
) -> RotationPath:
    """The path of a body with a rate (3,), rad/s, at the first of times (n,).

    Args:
        slope: of rates (n, 3, 1 + k), see `Slope`.
        inertia: (3, 3) of any scale, which the slope is of.
        omega_body: (3,) at the first time.
        times_s: (n,) none before the first.
        quantities: k.

    The same steps as `rotate` takes from time to time. Raises `ValueError` for a rate that is not
    finite.
    """
    steps_s = np.diff(times_s)
    rates = _rates_along(inertia, omega_body, steps_s)
    if not np.isfinite(rates).all():
        raise ValueError("a rotation without bounds")
    each = rotate_each(slope, rates[:-1], steps_s, quantities)
    transition = np.concatenate([np.eye(3 + quantities)[None], running_products(each.transition)])
    # An error of the attitude is seen in the axes after the turn.
    return RotationPath(np.swapaxes(transition[:, :3, :3], -1, -2), rates, transition)


def running_products(matrices: FloatArray) -> FloatArray:
    """(n, k, k) the k-th is the product of matrices (n, k, k) up to it, the last to the left.

    Within blocks of the square root of n, all blocks at once, and then from block to block.
    """
    count, size, _ = matrices.shape
    side = math.isqrt(max(count - 1, 0)) + 1
    padded = np.empty((side * side, size, size))
    padded[:count], padded[count:] = matrices, np.eye(size)
    blocks = padded.reshape(side, side, size, size)
    for k in range(1, side):
        blocks[:, k] = blocks[:, k] @ blocks[:, k - 1]
    for k in range(1, side):
        blocks[k] = blocks[k] @ blocks[k - 1, -1]
    return padded[:count]


def _rates_along(inertia: FloatArray, omega_body: FloatArray, steps_s: FloatArray) -> FloatArray:
    """(n + 1, 3) rates before, between and after steps (n,).

    In floats: arrays of three are slower than the arithmetic. Runge and Kutta's method gives the
    same in whatever axes.
    """
    moments, axes = np.linalg.eigh(inertia)
    if np.linalg.det(axes) < 0.0:
        axes = axes * _RIGHT_HANDED
    i, j, k = moments.tolist()
    a, b, c = (j - k) / i, (k - i) / j, (i - j) / k
    x, y, z = (omega_body @ axes).tolist()
    rates = [(x, y, z)]
    for step_s in steps_s.tolist():
        count = steps_over(x * x + y * y + z * z, step_s)
        h = step_s / count
        half, sixth = 0.5 * h, h / 6.0
        for _ in range(count):
            x1, y1, z1 = a * y * z, b * z * x, c * x * y
            u, v, w = x + half * x1, y + half * y1, z + half * z1
            x2, y2, z2 = a * v * w, b * w * u, c * u * v
            u, v, w = x + half * x2, y + half * y2, z + half * z2
            x3, y3, z3 = a * v * w, b * w * u, c * u * v
            u, v, w = x + h * x3, y + h * y3, z + h * z3
            x += sixth * (x1 + 2.0 * (x2 + x3) + a * v * w)
            y += sixth * (y1 + 2.0 * (y2 + y3) + b * w * u)
            z += sixth * (z1 + 2.0 * (z2 + z3) + c * u * v)
        rates.append((x, y, z))
    return np.asarray(np.array(rates) @ axes.T)
