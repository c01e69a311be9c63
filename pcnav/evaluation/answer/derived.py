"""Quantities that follow from a state, with their derivatives by its error."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import Enum, auto

import numpy as np

from pcnav.core.arrays import FloatArray
from pcnav.core.spatial import exp_rotation
from pcnav.dynamics.blocks import ATTITUDE, RATE, RATIOS, Layout
from pcnav.dynamics.rigid_body import inertia_from_ratios

_STEP = 1e-6
"""Of central differences, in metres, radians, and the like: all of the states are of order one."""

Values = Mapping[str, FloatArray]
"""Of one frame, by name of a block."""


class Kind(Enum):
    """How two values of a quantity differ."""

    VECTOR = auto()
    DIRECTION = auto()
    """By a turn."""
    AXIS = auto()
    """As a direction, whose sign means nothing."""


@dataclass(frozen=True)
class Derived:
    """A quantity at a state."""

    value: FloatArray
    """(m,)"""
    jacobian: FloatArray
    """(m, n) by the error of the state; of a direction (3, n) of the turn, rad."""


def derived(
    of: Callable[[Values], FloatArray], kind: Kind, values: Values, layout: Layout
) -> Derived:
    """A quantity (m,) of a state with the blocks of a layout, by central differences."""
    value = of(values)
    jacobian = np.empty((len(value), layout.size))
    for k in range(layout.size):
        error = np.zeros(layout.size)
        error[k] = _STEP
        ends = [of(moved(values, layout, sign * error)) for sign in (1.0, -1.0)]
        if kind is Kind.AXIS:
            ends = [end if end @ value > 0.0 else -end for end in ends]
        change = (ends[0] - ends[1]) / (2.0 * _STEP)
        jacobian[:, k] = change if kind is Kind.VECTOR else np.cross(value, change)
    return Derived(value, jacobian)


def moved(values: Values, layout: Layout, error: FloatArray) -> dict[str, FloatArray]:
    """The values after an error (n,) of the state: additive, the attitude by ``R exp(theta)``."""
    found = dict(values)
    for block in layout.blocks:
        change, value = error[layout.slice_of(block)], values[block.name]
        turned = block is ATTITUDE
        found[block.name] = value @ exp_rotation(change) if turned else value + change
    return found


def momentum_direction(values: Values) -> FloatArray:
    """(3,) of the angular momentum, world axes."""
    inertia = inertia_from_ratios(values[RATIOS.name])
    momentum = values[ATTITUDE.name] @ inertia @ values[RATE.name]
    return np.asarray(momentum / np.linalg.norm(momentum))


def principal_moments(values: Values) -> FloatArray:
    """(2,) second and third principal moment over the largest."""
    moments = np.linalg.eigvalsh(inertia_from_ratios(values[RATIOS.name]))
    return np.asarray(moments[1::-1] / moments[2])


def principal_axis(k: int) -> Callable[[Values], FloatArray]:
    """(3,) of the k-th largest moment, from 0, body axes; its largest component is positive."""

    def of(values: Values) -> FloatArray:
        _, axes = np.linalg.eigh(inertia_from_ratios(values[RATIOS.name]))
        axis = axes[:, 2 - k]
        return np.asarray(axis * np.sign(axis[np.argmax(np.abs(axis))]))

    return of
