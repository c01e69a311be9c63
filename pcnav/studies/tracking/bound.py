"""The posterior Cramer-Rao bound: the covariance no tracker can beat on a given motion.

Tichavsky, Muravchik and Nehorai 1998, with the information of each frame taken at the true state.
The error of a pose is (6,): translation of the model origin (m, camera axes), then rotation (rad,
model axes), ``p = p_hat + d``, ``R = R_hat exp(theta)``.
"""

from collections.abc import Callable

import numpy as np

from pcnav.arrays import FloatArray
from pcnav.estimation.error_state import MotionModel
from pcnav.simulation.scenario import TrueMotion
from pcnav.spatial import skew
from pcnav.state import COM_MODEL, R_HILL, STATE_SIZE, THETA_BODY, NavigationState

PoseInformation = Callable[[int, FloatArray], FloatArray]
"""From a frame's index and the (6, 6) covariance with which its pose could be predicted to the
(6, 6) information (inverse covariance) that the frame carries about the error of its pose."""


def pose_jacobian(
    state: NavigationState, T_cam_world: FloatArray, R_hill_world: FloatArray
) -> FloatArray:
    """(6, 20) derivative of the error of the pose by the error of the state.

    The model origin is at ``R_cam_hill r - R_cam_body c``, c the mass centre; a turn theta of the
    body moves it by ``R_cam_body [c]x theta``.
    """
    R_cam_world = T_cam_world[:3, :3]
    R_cam_body = R_cam_world @ state.R_world_body
    jacobian = np.zeros((6, STATE_SIZE))
    jacobian[:3, R_HILL] = R_cam_world @ R_hill_world.T
    jacobian[:3, COM_MODEL] = -R_cam_body
    jacobian[:3, THETA_BODY] = R_cam_body @ skew(state.com_model)
    jacobian[3:, THETA_BODY] = np.eye(3)
    return jacobian


def posterior_bound(
    model: MotionModel[NavigationState],
    motion: TrueMotion,
    information: PoseInformation,
    prior_covariance: FloatArray,
) -> FloatArray:
    """(n, 20, 20) bound on the covariance of the state's error after each frame of a true motion.

    Args:
        model: whose transition, taken at the true states, carries the bound on, and whose process
            noise loosens it.
        motion: the truth.
        information: of each frame about its pose.
        prior_covariance: (20, 20) before the first frame, in the model's error coordinates.
    """
    P, bounds = prior_covariance, []
    for k, state in enumerate(motion.states):
        if k > 0:
            before = float(motion.times_s[k - 1])
            step_s = float(motion.times_s[k]) - before
            _, transition, noise = model.propagate(motion.states[k - 1], before, step_s)
            P = predicted(P, transition, noise)
        H = pose_jacobian(state, motion.T_cam_world[k], motion.R_hill_world[k])
        P = informed(P, H, information(k, H @ P @ H.T))
        bounds.append(P)
    return np.stack(bounds)


def predicted(covariance: FloatArray, transition: FloatArray, noise: FloatArray) -> FloatArray:
    """(n, n) bound one step later."""
    P = transition @ covariance @ transition.T + noise
    return np.asarray(0.5 * (P + P.T))


def informed(covariance: FloatArray, H: FloatArray, information: FloatArray) -> FloatArray:
    """(n, n) ``(P^-1 + H^T I H)^-1`` for an information I (m, m) that may be singular.

    I is written as ``L L^T``, that is as m measurements ``L^T H`` with unit noise; their update in
    Joseph's form needs no inverse of P and stays positive.
    """
    values, axes = np.linalg.eigh(0.5 * (information + information.T))
    whitened = (axes * np.sqrt(np.maximum(values, 0.0))).T @ H
    S = whitened @ covariance @ whitened.T + np.eye(len(whitened))
    gain = np.linalg.solve(S, whitened @ covariance).T
    kept = np.eye(len(covariance)) - gain @ whitened
    P = kept @ covariance @ kept.T + gain @ gain.T
    return np.asarray(0.5 * (P + P.T))
