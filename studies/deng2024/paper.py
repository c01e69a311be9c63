"""What Deng 2024 prints, and what it leaves open."""

from dataclasses import dataclass

import numpy as np

from pcnav.core.arrays import FloatArray
from pcnav.estimators.attitude_inertia.rotation_model import RotationState, parameters_from_printed
from pcnav.simulation.scenario import rotate_torque_free

NUTATION_RATIOS = (0.85, 1.37, 0.13, 0.17, -0.11)
NUTATION_RATE_DEG_S = (5.0, 2.3, 3.5)
SPIN_RATIOS = (0.85, 1.37, 0.0, 0.0, 0.0)
SPIN_RATE_DEG_S = (0.0, 2.3, 0.0)
"""Section 4: Jxx, Jyy, Jxy, Jxz, Jyz over Jzz and the rate at the start, body axes."""

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
    ratios: tuple[float, ...]
    """Jxx, Jyy, Jxy, Jxz, Jyz over Jzz."""
    times_s: FloatArray
    R_world_body: FloatArray
    """(n, 3, 3)"""
    omega_body: FloatArray
    """(n, 3) rad/s."""

    def truth(self, k: int) -> RotationState:
        """The state at one time."""
        parameters = parameters_from_printed(np.array(self.ratios))
        return RotationState(self.R_world_body[k], self.omega_body[k], parameters)


def motion_of(
    name: str,
    ratios: tuple[float, ...],
    rate_deg_s: tuple[float, ...],
    duration_s: float = DURATION_S,
    interval_s: float = INTERVAL_S,
) -> Motion:
    """Free rotation from the identity on."""
    times_s = np.arange(round(duration_s / interval_s) + 1, dtype=np.float64) * interval_s
    xx, yy, xy, xz, yz = ratios
    inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, 1.0]])
    R, omega = rotate_torque_free(np.eye(3), np.radians(rate_deg_s), inertia, times_s)
    return Motion(name, ratios, times_s, R, omega)


def nutation(duration_s: float = DURATION_S, interval_s: float = INTERVAL_S) -> Motion:
    """Of Figs. 3-5."""
    return motion_of("nutation", NUTATION_RATIOS, NUTATION_RATE_DEG_S, duration_s, interval_s)


def spin(duration_s: float = DURATION_S, interval_s: float = INTERVAL_S) -> Motion:
    """Of Fig. 6."""
    return motion_of("spin", SPIN_RATIOS, SPIN_RATE_DEG_S, duration_s, interval_s)
