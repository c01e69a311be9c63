"""Motions that are not those of a free body: swayed, led along a path, carried by hand.

Each is a smooth function of time with exact derivatives, so the true velocity and rate are those
of the true pose.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from pcnav.config.motion import MotionKind, MotionTable
from pcnav.core.arrays import FloatArray
from pcnav.core.spatial import exp_rotation, left_jacobian

_SINES = 24
"""Of one axis of a motion by hand: enough for an acceleration that is nearly Gaussian."""


@dataclass(frozen=True)
class Displacement:
    """How far something is from where it would be, and how fast that changes."""

    shift_m: FloatArray
    """(n, 3)"""
    shift_rate_m_s: FloatArray
    """(n, 3)"""
    angle_rad: FloatArray
    """(n, 3) rotation vector."""
    angle_rate_rad_s: FloatArray
    """(n, 3) derivative of the rotation vector."""

    @property
    def R(self) -> FloatArray:
        """(n, 3, 3) rotation."""
        return exp_rotation(self.angle_rad)

    @property
    def omega(self) -> FloatArray:
        """(n, 3) angular rate in the turned axes, rad/s: the right Jacobian of SO(3) times the
        derivative of the rotation vector."""
        # The right Jacobian is the left one of the opposite rotation vector.
        J = left_jacobian(-self.angle_rad)
        return np.asarray(np.einsum("nij,nj->ni", J, self.angle_rate_rad_s))


def displacement(table: MotionTable, times_s: FloatArray, rng: np.random.Generator) -> Displacement:
    """(n,) displacements of a sway, path or hand at times from 0 on; zero at time 0.

    The draws do not depend on the times: more frames show the same motion.
    """
    unit, rate = _MOVED[table.kind](table, times_s, rng)
    return Displacement(unit[:, :3], rate[:, :3], unit[:, 3:], rate[:, 3:])


_Moved = tuple[FloatArray, FloatArray]
"""(n, 6) shift and rotation vector, m and rad, and their derivatives."""


def _extent(table: MotionTable) -> FloatArray:
    return np.repeat([table.extent_m, np.deg2rad(table.extent_deg)], 3)


def _swayed(table: MotionTable, times_s: FloatArray, rng: np.random.Generator) -> _Moved:
    """One direction of each, drawn; the attitude sways at 0.7 of the period of the shift."""
    axes = rng.standard_normal((2, 3))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    turn = 2.0 * np.pi / table.period_s * np.repeat([1.0, 1.0 / 0.7], 3)
    amplitude = _extent(table) * axes.ravel()
    phase = turn * times_s[:, None]
    return amplitude * np.sin(phase), amplitude * turn * np.cos(phase)


def _led(table: MotionTable, times_s: FloatArray, rng: np.random.Generator) -> _Moved:
    """Between uniformly drawn poses, at rest in each: 10 u^3 - 15 u^4 + 6 u^5 (Flash and Hogan
    1985)."""
    legs = int(np.floor(times_s[-1] / table.leg_s)) + 1
    stops = np.vstack([np.zeros(6), _extent(table) * rng.uniform(-1.0, 1.0, (legs, 6))])
    leg = np.minimum(np.floor(times_s / table.leg_s).astype(int), legs - 1)
    u = (times_s / table.leg_s - leg)[:, None]
    way = stops[leg + 1] - stops[leg]
    share = u**3 * (10.0 - 15.0 * u + 6.0 * u**2)
    slope = 30.0 * u**2 * (1.0 - u) ** 2 / table.leg_s
    return stops[leg] + way * share, way * slope


def _by_hand(table: MotionTable, times_s: FloatArray, rng: np.random.Generator) -> _Moved:
    """Sines of frequencies spread over the band, whose accelerations have equal power."""
    low, high = table.band_hz
    # One frequency in each of equal parts of the band: no draw leaves a part of it empty.
    parts = (np.arange(_SINES)[:, None] + rng.uniform(size=(_SINES, 6))) / _SINES
    turn = 2.0 * np.pi * (low + (high - low) * parts)
    phase = rng.uniform(0.0, 2.0 * np.pi, (_SINES, 6))
    level = np.repeat([table.acceleration_m_s2, np.deg2rad(table.angular_acceleration_deg_s2)], 3)
    amplitude = level * np.sqrt(2.0 / _SINES) / turn**2
    angle = turn * times_s[:, None, None] + phase
    value = np.sum(amplitude * (np.sin(angle) - np.sin(phase)), axis=1)
    return value, np.sum(amplitude * turn * np.cos(angle), axis=1)


_MOVED: Mapping[MotionKind, Callable[[MotionTable, FloatArray, np.random.Generator], _Moved]] = {
    MotionKind.SWAY: _swayed,
    MotionKind.PATH: _led,
    MotionKind.HAND: _by_hand,
}
