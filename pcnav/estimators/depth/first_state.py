"""The state that a motion through poses gives, and the prior about it."""

import numpy as np

from pcnav.core.arrays import FloatArray
from pcnav.dynamics.orbit import R_hill_world
from pcnav.dynamics.state import (
    COM_MODEL,
    INERTIA_RATIOS,
    OMEGA_BODY,
    R_HILL,
    STATE_SIZE,
    THETA_BODY,
    V_HILL,
    NavigationState,
)
from pcnav.estimators.depth.motion_hypotheses import (
    MAX_TURN_CHANGE,
    MotionHypothesis,
    PoseObservation,
)

_POSITION_SD_M = 1.0
_VELOCITY_SD_M_S = 1.0
_ATTITUDE_SD_RAD = 0.5
_RATE_SD_RAD_S = 0.5
"""Spread about the first observations: far more than they err, so that it decides nothing."""


def first_state(
    motion: MotionHypothesis,
    com_model: FloatArray,
    inertia_ratios: FloatArray,
    mean_motion_rad_s: float,
) -> NavigationState:
    """State at the first observation: pose from it, rates from the differences of all, if any."""
    first, last = motion.observations[0], motion.observations[-1]
    times = np.diff([observation.time_s for observation in motion.observations])
    rates = motion.turns / times[:, None]
    r_first, r_last = (
        _r_hill(observation, com_model, mean_motion_rad_s) for observation in (first, last)
    )
    return NavigationState(
        r_hill=r_first,
        v_hill=(r_last - r_first) / (last.time_s - first.time_s) if len(rates) else np.zeros(3),
        com_model=com_model,
        R_world_body=first.R_world_body,
        omega_body=rates.mean(axis=0) if len(rates) else np.zeros(3),
        inertia_ratios=inertia_ratios,
    )


def _r_hill(
    observation: PoseObservation, com_model: FloatArray, mean_motion_rad_s: float
) -> FloatArray:
    T_cam_world = observation.T_cam_world
    p_cam = observation.T_cam_model[:3, :3] @ com_model + observation.T_cam_model[:3, 3]
    p_world = T_cam_world[:3, :3].T @ (p_cam - T_cam_world[:3, 3])
    return np.asarray(R_hill_world(observation.time_s, mean_motion_rad_s) @ p_world)


def start_covariance(
    omega_body: FloatArray, com_covariance_m2: FloatArray, parameter_covariance: FloatArray
) -> FloatArray:
    """(20, 20) prior about `first_state`: the mass properties' own, the rest left to the data.

    Args:
        omega_body: (3,) rate, rad/s, that is started from; a faster one wanders by more.
        com_covariance_m2: (3, 3) of the mass centre.
        parameter_covariance: (5, 5) of the inertia's parameters, in which
            `NavigationState.retract` moves it.
    """
    sd = np.zeros(STATE_SIZE)
    sd[R_HILL], sd[V_HILL] = _POSITION_SD_M, _VELOCITY_SD_M_S
    rate_sd = max(_RATE_SD_RAD_S, MAX_TURN_CHANGE * float(np.linalg.norm(omega_body)))
    sd[THETA_BODY], sd[OMEGA_BODY] = _ATTITUDE_SD_RAD, rate_sd
    covariance = np.diag(sd**2)
    covariance[COM_MODEL, COM_MODEL] = com_covariance_m2
    covariance[INERTIA_RATIOS, INERTIA_RATIOS] = parameter_covariance
    return covariance
