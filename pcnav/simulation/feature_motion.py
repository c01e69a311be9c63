"""The true motion of a target without a model: its relative orbit and its rotation.

Without disturbances both are integrated to a relative tolerance of 1e-12. White disturbance
accelerations, where asked for, are drawn step by step between the frames.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from pcnav.config.scenario import OrbitModel
from pcnav.core.arrays import FloatArray
from pcnav.core.spatial import exp_rotation
from pcnav.dynamics.kepler import KeplerOrbit, propagate_relative, step_relative
from pcnav.dynamics.orbit import hill_transition
from pcnav.dynamics.rotation_step import rotate, torque_free
from pcnav.simulation.scenario import rotate_torque_free

_MAX_TURN_RAD = 0.02
"""Rotation in one Runge-Kutta step: its error, of order turn^5 / 120, stays below 1e-10 rad."""


@dataclass(frozen=True)
class FeatureTruth:
    """The true motion at every frame, the mass properties and the points."""

    times_s: FloatArray
    """(n,) increasing."""
    r_hill: FloatArray
    """(n, 3) mass centre from the chaser's, Hill axes, m."""
    v_hill: FloatArray
    """(n, 3) its rate of change in Hill axes, m/s."""
    R_world_body: FloatArray
    """(n, 3, 3)"""
    omega_body: FloatArray
    """(n, 3) inertial angular velocity, body axes, rad/s."""
    inertia: FloatArray
    """(3, 3) inertia matrix of any scale, body axes."""
    points: FloatArray
    """(N, 3) from the mass centre, body axes, m."""


@dataclass(frozen=True)
class InitialMotion:
    """What the motion starts from at the first time."""

    r_hill: FloatArray
    v_hill: FloatArray
    R_world_body: FloatArray
    omega_body: FloatArray


def relative_orbit(
    model: OrbitModel,
    orbit: KeplerOrbit,
    start: InitialMotion,
    times_s: FloatArray,
    acceleration_psd_m2_s3: float,
    rng: np.random.Generator,
) -> FloatArray:
    """(n, 6) true r (m) and v (m/s) in Hill axes at increasing times, from the start at [0]."""
    linear = model is OrbitModel.HILL
    if acceleration_psd_m2_s3 == 0.0 and not linear:
        return propagate_relative(orbit, start.r_hill, start.v_hill, times_s)
    states = [np.concatenate([start.r_hill, start.v_hill])]
    for before, after in pairwise(times_s.tolist()):
        state, step = states[-1], after - before
        if linear:
            moved = hill_transition(orbit.mean_motion_rad_s, step) @ state
        else:
            r, v, _ = step_relative(orbit, state[:3], state[3:], before, step)
            moved = np.concatenate([r, v])
        states.append(moved + np.concatenate(_kick(acceleration_psd_m2_s3, step, rng)))
    return np.stack(states)


def rotation(
    start: InitialMotion,
    inertia: FloatArray,
    times_s: FloatArray,
    angular_acceleration_psd_rad2_s3: float,
    rng: np.random.Generator,
) -> tuple[FloatArray, FloatArray]:
    """(n, 3, 3) true R_world_body and (n, 3) body rates, rad/s, at increasing times."""
    if angular_acceleration_psd_rad2_s3 == 0.0:
        return rotate_torque_free(start.R_world_body, start.omega_body, inertia, times_s)
    slope = torque_free(inertia, np.asarray(np.linalg.inv(inertia)))
    attitudes, rates = [start.R_world_body], [start.omega_body]
    for before, after in pairwise(times_s.tolist()):
        step = after - before
        done = rotate(slope, rates[-1], step, 0, _MAX_TURN_RAD)
        angle, change = _kick(angular_acceleration_psd_rad2_s3, step, rng)
        attitudes.append(attitudes[-1] @ done.turn @ exp_rotation(angle))
        rates.append(done.omega_body + change)
    return np.stack(attitudes), np.stack(rates)


def _kick(psd: float, step_s: float, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """What white noise of a power spectral density adds to a place and to its rate in a step."""
    first, second = rng.standard_normal((2, 3))
    rate = np.sqrt(psd * step_s) * first
    # The place is the integral of the noise's integral: half of the rate's change, and what is
    # independent of it.
    return 0.5 * step_s * rate + np.sqrt(psd * step_s**3 / 12.0) * second, rate
