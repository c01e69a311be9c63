"""What Deng 2024 prints, and what it leaves open."""

from dataclasses import dataclass

import numpy as np

from pcnav.core.arrays import FloatArray
from pcnav.estimators.attitude_inertia.rotation_model import RotationState, parameters_from_printed
from pcnav.simulation.motion import rotate_torque_free

Ratios = tuple[float, float, float, float, float]
"""Jxx, Jyy, Jxy, Jxz, Jyz over Jzz."""
Triple = tuple[float, float, float]


@dataclass(frozen=True)
class Body:
    """What turns, and how at first."""

    ratios: Ratios
    rate_deg_s: Triple
    """Body axes."""
    quaternion_xyzw: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 1.0)

    @property
    def state(self) -> RotationState:
        """At the identity."""
        parameters = parameters_from_printed(np.array(self.ratios))
        return RotationState(np.eye(3), np.radians(self.rate_deg_s), parameters)

    @property
    def inertia(self) -> FloatArray:
        """(3, 3) over Jzz."""
        xx, yy, xy, xz, yz = self.ratios
        return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, 1.0]])


NUTATION = Body((0.85, 1.37, 0.13, 0.17, -0.11), (5.0, 2.3, 3.5))
SPIN = Body((0.85, 1.37, 0.0, 0.0, 0.0), (0.0, 2.3, 0.0))
"""Section 4."""

GUESS_RATE_DEG_S = (0.5, 0.23, 0.35)
GUESS_RATIOS = (0.7, 0.7, 0.0, 0.0, 0.0)
PRINTED_VARIANCE = 0.001
"""Of Q and of R; no unit is printed. R is of half angles (35)."""

HALF_ANGLE_SD_RAD = float(np.sqrt(PRINTED_VARIANCE))
ATTITUDE_SD_DEG = float(np.degrees(2.0 * HALF_ANGLE_SD_RAD))

INTERVAL_S, DURATION_S = 0.5, 200.0
"""Of attitudes; neither is printed."""
PRINTED_RANK_ORDER = 4
"""Derivatives (21) takes to reach rank 11."""


@dataclass(frozen=True)
class Motion:
    """A true motion at the times of the attitudes."""

    name: str
    body: Body
    times_s: FloatArray
    """(n,)"""
    truth: RotationState
    """(n,)"""


def _motion(name: str, body: Body, duration_s: float, interval_s: float) -> Motion:
    """Free rotation from the identity on."""
    times_s = np.arange(round(duration_s / interval_s) + 1, dtype=np.float64) * interval_s
    start = body.state
    R, omega = rotate_torque_free(start.R_world_body, start.omega_body, body.inertia, times_s)
    truth = RotationState(R, omega, np.tile(start.parameters, (len(times_s), 1)))
    return Motion(name, body, times_s, truth)


def nutation(duration_s: float = DURATION_S, interval_s: float = INTERVAL_S) -> Motion:
    """Of Figs. 3-5."""
    return _motion("nutation", NUTATION, duration_s, interval_s)


def spin(duration_s: float = DURATION_S, interval_s: float = INTERVAL_S) -> Motion:
    """Of Fig. 6."""
    return _motion("spin", SPIN, duration_s, interval_s)
