"""Rotation over a time, and how what it ends in depends on what it began with.

One method serves every model of a turning body, single or many at once: Runge-Kutta of order 4
for the rate and its derivatives, the Magnus series of order 4 for the attitude. A model adds its
own slope: Euler's equation, and that equation's derivatives, in the parameters that it errs in.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from pcnav.core.arrays import FloatArray
from pcnav.core.spatial import exp_rotation, left_jacobian, skew
from pcnav.dynamics.inertia_parameters import INERTIA_UNITS

_MAX_TURN_RAD = 0.1
"""Rotation in one step: its error, of order turn^5 / 120, stays below 1e-7 rad."""

Slope = Callable[[FloatArray], FloatArray]
"""Time derivative of rates (..., 3, 1 + k), rad/s.

The first column is the rate in body axes, the others are its derivatives D by k quantities of the
start, of which the first three are the rate there: ``D' = A D + [0 B]`` with the Jacobians A and B
of Euler's equation.
"""

_UNIT_ROWS = np.moveaxis(INERTIA_UNITS, (0, 1, 2), (2, 1, 0)).reshape(3, 15)
"""(3, 15) derivative of N by its parameters, to be multiplied by a vector from the left."""


@dataclass(frozen=True)
class Rotation:
    """What bodies do over a time."""

    turn: FloatArray
    """(..., 3, 3) R_body0_body1: the attitude after it is ``R_world_body @ turn``."""
    by_start: FloatArray
    """(..., 3, k) derivative of the attitude after it (right error, body axes there, rad) by the
    quantities of the start."""
    rates: FloatArray
    """(..., 3, 1 + k) rate after it, and its derivatives by the quantities of the start."""

    @property
    def omega_body(self) -> FloatArray:
        """(..., 3) rate after it, rad/s."""
        return np.asarray(self.rates[..., 0])

    @property
    def transition(self) -> FloatArray:
        """(..., 3 + k, 3 + k) of errors of the attitude (right, body axes) and of the quantities.

        Those besides the rate stay what they are.
        """
        identity = _identity(3 + self.by_start.shape[-1])
        transition = _copies(identity, self.turn.shape[:-2])
        transition[..., :3, :3] = np.swapaxes(self.turn, -1, -2)
        transition[..., :3, 3:] = self.by_start
        transition[..., 3:6, 3:] = self.rates[..., 1:]
        return transition

    def then(self, slope: Slope, step_s: "float | FloatArray") -> "Rotation":
        """This, and one step more, of one length or of lengths (..., 1, 1): the turn in it should
        be small."""
        more = _step(slope, self.rates, step_s)
        carried = np.swapaxes(more.turn, -1, -2) @ self.by_start
        return Rotation(self.turn @ more.turn, carried + more.by_start, more.rates)


def at_rest(omega_body: FloatArray, quantities: int = 3) -> Rotation:
    """No time at all, of bodies with rates (..., 3): what steps are added to."""
    turn = _copies(_identity(3), omega_body.shape[:-1])
    by_start = np.zeros((*omega_body.shape, quantities))
    return Rotation(turn, by_start, _rates_at_start(omega_body, quantities))


def rotate(
    slope: Slope,
    omega_body: FloatArray,
    duration_s: float,
    quantities: int = 3,
    max_turn_rad: float = _MAX_TURN_RAD,
) -> Rotation:
    """Rotation of bodies with rates (..., 3), rad/s, in as many steps as keep the turns small."""
    one = omega_body.ndim == 1
    squared = omega_body @ omega_body if one else np.max(np.sum(omega_body**2, axis=-1))
    steps = steps_over(float(squared), duration_s, max_turn_rad)
    done = _step(slope, _rates_at_start(omega_body, quantities), duration_s / steps)
    for _ in range(steps - 1):
        done = done.then(slope, duration_s / steps)
    return done


def rotate_each(
    slope: Slope, omega_body: FloatArray, durations_s: FloatArray, quantities: int = 3
) -> Rotation:
    """The same of n bodies with rates (n, 3), each over a time of its own (n,).

    The slope is that of all of them: of one inertia.
    """
    turns = np.sqrt(np.sum(omega_body**2, axis=-1)) * np.abs(durations_s)
    counts = np.maximum(np.ceil(turns / _MAX_TURN_RAD), 1.0).astype(np.intp)
    h = (durations_s / counts)[:, None, None]
    done = at_rest(omega_body, quantities)
    for k in range(int(counts.max(initial=0))):
        on = np.flatnonzero(counts > k)
        if len(on) == len(counts):
            done = done.then(slope, h)
            continue
        before = Rotation(done.turn[on], done.by_start[on], done.rates[on])
        more = before.then(slope, h[on])
        done.turn[on], done.by_start[on], done.rates[on] = more.turn, more.by_start, more.rates
    return done


def steps_over(squared_rate: float, duration_s: float, max_turn_rad: float = _MAX_TURN_RAD) -> int:
    """Steps that keep the turn in each small, at a rate of this square, rad^2/s^2."""
    return max(1, math.ceil(math.sqrt(squared_rate) * abs(duration_s) / max_turn_rad))


def torque_free(inertia: FloatArray, inverse: FloatArray) -> Slope:
    """Of inertia matrices (..., 3, 3), of any scale, by the rate alone.

    Euler's equation ``I w' = -w x (I w)`` and its variation ``I D' = ([I w]x - [w]x I) D``. The
    inverse is handed in because callers turn the same bodies many times.
    """

    def slope(rates: FloatArray) -> FloatArray:
        return np.asarray(inverse @ _torque(inertia, rates)[1])

    return slope


def torque_free_by_inertia(inertia: FloatArray, inverse: FloatArray) -> Slope:
    """Of ``N = 3 I / tr(I)`` (..., 3, 3), by the rate and the five parameters of N.

    From ``N a = -w x (N w)``: ``N da = ([N w]x - [w]x N) dw - dN a - w x (dN w)``.
    """

    def slope(rates: FloatArray) -> FloatArray:
        cross, torque = _torque(inertia, rates)
        change = inverse @ torque
        by_inertia = _by_parameters(change[..., 0]) + cross @ _by_parameters(rates[..., 0])
        change[..., 4:] -= inverse @ by_inertia
        return np.asarray(change)

    return slope


def _rates_at_start(omega_body: FloatArray, quantities: int) -> FloatArray:
    rates = _copies(_unmoved(quantities), omega_body.shape[:-1])
    rates[..., 0] = omega_body
    return rates


@lru_cache(maxsize=16)
def _unmoved(quantities: int) -> FloatArray:
    return np.eye(3, 1 + quantities, 1)


@lru_cache(maxsize=16)
def _identity(size: int) -> FloatArray:
    return np.eye(size)


def _copies(matrix: FloatArray, batch: tuple[int, ...]) -> FloatArray:
    """A matrix for each of a batch, to be written to."""
    if not batch:
        return matrix.copy()
    return np.broadcast_to(matrix, (*batch, *matrix.shape)).copy()


def _torque(inertia: FloatArray, rates: FloatArray) -> tuple[FloatArray, FloatArray]:
    """``[w]x`` and ``-w x (I w)`` with its derivatives through w."""
    momentum = inertia @ rates
    cross = skew(rates[..., 0])
    torque = -cross @ momentum
    torque[..., 1:] += skew(momentum[..., 0]) @ rates[..., 1:]
    return cross, torque


def _by_parameters(vector: FloatArray) -> FloatArray:
    """(..., 3, 5) derivative of ``N v`` by the parameters of N."""
    return np.asarray((vector @ _UNIT_ROWS).reshape(*vector.shape, 5))


def _step(slope: Slope, start: FloatArray, h: float | FloatArray) -> Rotation:
    """One step from rates (..., 3, 1 + k).

    One combination of slopes moves the rate and its derivatives. The attitude turns by
    ``exp(phi)`` with ``phi = h/6 (w0 + 4 w1/2 + w1) + h^2/12 w0 x w1`` (Magnus, in body axes), and
    an error of phi enters through the right Jacobian.
    """
    s1 = slope(start)
    s2 = slope(start + (0.5 * h) * s1)
    s3 = slope(start + (0.5 * h) * s2)
    s4 = slope(start + h * s3)
    after = start + (h / 6.0) * (s1 + 2.0 * (s2 + s3) + s4)
    # Cubic Hermite interpolation gives the mid-point to order 4.
    middle = 0.5 * (start + after) + (h / 8.0) * (s1 - s4)
    cross = skew(start[..., 0]) @ after
    cross[..., 1:] -= skew(after[..., 0]) @ start[..., 1:]
    # In the first column the vector itself, in the others its derivatives.
    phi = (h / 6.0) * (start + 4.0 * middle + after) + (h**2 / 12.0) * cross
    by_start = left_jacobian(-phi[..., 0]) @ phi[..., 1:]
    return Rotation(exp_rotation(phi[..., 0]), by_start, after)
