"""What Segal 2011 prints, in pcnav's frames, and what it leaves open."""

from dataclasses import dataclass

import numpy as np

from pcnav.config.inertia_bank import InertiaBankTable
from pcnav.core.arrays import FloatArray
from pcnav.core.stereo import StereoRig
from pcnav.dynamics.kepler import KeplerOrbit, propagate_relative
from pcnav.dynamics.orbit import EARTH_MU_M3_S2
from pcnav.simulation.motion import rotate_torque_free

R_HILL_PAPER = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, -1.0], [-1.0, 0.0, 0.0]])
"""The paper's axes are x radially outward, y along-track, z orbit normal."""

TARGET_INERTIA = np.array([[96.0, 43.0, 20.0], [43.0, 104.0, 10.0], [20.0, 10.0, 133.0]])
"""kg m^2, target axes (14); printed with 26 above the diagonal and 20 below it."""

POINTS = 10
HALF_EXTENT_M = 1.5
HYPOTHESES = 5
DEGREES_OF_FREEDOM = 3
SEMI_MAJOR_AXIS_M, ECCENTRICITY = 7170e3, 0.05
PRINTED_RATE_DEG_S = 0.0656

ORBIT_RATE = float(np.sqrt(EARTH_MU_M3_S2 / SEMI_MAJOR_AXIS_M**3))


def _true_anomaly() -> float:
    """Where the chaser's true anomaly turns at the printed rate: the print does not say where."""
    ratio = np.radians(PRINTED_RATE_DEG_S) / ORBIT_RATE * (1.0 - ECCENTRICITY**2) ** 1.5
    return float(np.arccos((np.sqrt(ratio) - 1.0) / ECCENTRICITY))


ORBIT = KeplerOrbit(ORBIT_RATE, ECCENTRICITY, _true_anomaly())

RIG = StereoRig(1.0, 1.0, (0.0, 0.0), (1, 1), 1e-5)
"""Focal length 1: image coordinates are those of (3), with the printed standard deviation."""

R_RIG_HILL = np.array([[0.0, 0.0, 1.0], [0.0, -1.0, 0.0], [1.0, 0.0, 0.0]])
"""Looks along-track; the second camera is 1 m below the first, on the radius (4), (26)."""

R_0 = R_HILL_PAPER @ np.array([10.0, 100.0, 10.0])
V_0 = R_HILL_PAPER @ np.array([0.01, -0.0225, -0.01])
"""m and m/s, Hill axes (16a), (16b)."""
OMEGA_0 = np.radians([0.1, 0.1, 0.1])
"""Inertial rate in target axes, rad/s (16d)."""

FRAME_INTERVAL_S, DURATION_S = 5.0, 600.0
"""Not printed; pcnav's choice. The target turns by 100 degrees in this time."""

BANK = InertiaBankTable(allow_unphysical=True, attitude_sd_deg=1.0)
"""The shipped settings but for the attitude: the paper starts all runs at one attitude and does not
say how well a filter knows it. Initial uncertainty and process noise are not printed either."""

ATTITUDE_SD_RAD = float(
    RIG.pixel_sigma_px * np.linalg.norm(R_0) / (HALF_EXTENT_M / np.sqrt(3.0) * np.sqrt(POINTS))
)
"""How well one frame shows a turn of the points, about: pixel noise at their distance over their
lever arms."""


@dataclass(frozen=True)
class Motion:
    """The true motion at every frame, the same in all runs."""

    times_s: FloatArray
    """(n,)"""
    r_hill: FloatArray
    """(n, 3) m."""
    v_hill: FloatArray
    """(n, 3) m/s."""
    R_hill_body: FloatArray
    """(n, 3, 3) target axes, which lie along the paper's orbital axes at the start."""
    omega_body: FloatArray
    """(n, 3) inertial, rad/s."""


def true_motion(
    inertia: FloatArray = TARGET_INERTIA,
    omega_body: FloatArray = OMEGA_0,
    duration_s: float = DURATION_S,
    interval_s: float = FRAME_INTERVAL_S,
) -> Motion:
    """The motion of a target that starts as printed (16), without disturbances."""
    times = np.arange(0.0, duration_s + 0.5 * interval_s, interval_s)
    orbit = propagate_relative(ORBIT, R_0, V_0, times)
    R_world_body, omega = rotate_torque_free(R_HILL_PAPER, omega_body, inertia, times)
    R_hill_world = np.stack([ORBIT.R_hill_world(float(t)) for t in times])
    return Motion(times, orbit[:, :3], orbit[:, 3:], R_hill_world @ R_world_body, omega)
