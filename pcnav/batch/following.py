"""One estimator over the frames of one scene; what it said, frame by frame, beside the bound."""

import time
from dataclasses import dataclass, replace

import numpy as np

from pcnav.core.arrays import FloatArray
from pcnav.dynamics.state import COM_MODEL, INERTIA_RATIOS, OMEGA_BODY, STATE_SIZE, THETA_BODY
from pcnav.estimators.peers.interface import Answer, Estimator
from pcnav.evaluation.bound import SceneBound, pose_jacobian
from pcnav.runs.results import Track
from pcnav.simulation.depth import Scene
from pcnav.simulation.motion import TrueMotion

BOUNDED = ("position", "attitude", "rate", "com", "inertia_ratios")
"""What the columns of `Followed.bound` are of."""


@dataclass(frozen=True)
class Followed:
    """What an estimator said of a scene."""

    track: Track
    """With its covariances; nan throughout for an estimator that gives poses alone."""
    frame_s: FloatArray
    """(n,) processor time on each frame."""
    bound: FloatArray
    """(n, 5) roots of the traces of the posterior Cramer-Rao bound's blocks, as in `BOUNDED`, SI:
    the least RMS error of the pose's position, the attitude, the rate, the mass centre and the
    inertia ratios. nan where it does not hold."""


def follow(scene: Scene, estimator: Estimator, bound: SceneBound | None = None) -> Followed:
    """Put an estimator to all frames of a scene; one frame at a time is in memory.

    What is kept of a frame is some 4 kB, most of it the covariance. Time is spent on the bound and
    on the frames themselves, too, but none of it counts.
    """
    n = len(scene.motion.truth.time_s)
    track, status = _empty_track(scene.motion.truth.time_s), []
    seconds, bounds = np.full(n, np.nan), np.full((n, len(BOUNDED)), np.nan)
    for k, frame in enumerate(scene):
        started = time.process_time()
        answer = estimator.step(frame)
        seconds[k] = time.process_time() - started
        _note(track, k, answer)
        status.append(answer.status)
        if bound is not None:
            bounds[k] = _least_errors(bound.step(frame), scene.motion, k)
    return Followed(replace(track, status=tuple(status)), seconds, bounds)


def _least_errors(P: FloatArray, motion: TrueMotion, k: int) -> FloatArray:
    """(5,) row of `Followed.bound` of a (20, 20) bound."""
    H = pose_jacobian(motion.state(k), motion.T_cam_world[k], motion.R_hill_world[k])[:3]
    variance = np.diag(P)
    blocks = (THETA_BODY, OMEGA_BODY, COM_MODEL, INERTIA_RATIOS)
    traces = [np.trace(H @ P @ H.T), *(variance[block].sum() for block in blocks)]
    return np.asarray(np.sqrt(traces))


def _empty_track(times_s: FloatArray) -> Track:
    """All nan, to be filled in place."""
    n = len(times_s)

    def unknown(*shape: int) -> FloatArray:
        return np.full((n, *shape), np.nan)

    return Track(
        time_s=times_s,
        r_hill=unknown(3),
        v_hill=unknown(3),
        com_model=unknown(3),
        R_world_body=unknown(3, 3),
        omega_body=unknown(3),
        inertia_ratios=unknown(5),
        sd=unknown(STATE_SIZE),
        T_cam_model=unknown(4, 4),
        status=(),
        nis=unknown(),
        nis_dof=np.zeros(n, dtype=np.intp),
        window_nis=unknown(),
        inlier_ratio=unknown(),
        n_rectangles=np.zeros(n, dtype=np.intp),
        covariance=unknown(STATE_SIZE, STATE_SIZE),
    )


def _note(track: Track, k: int, answer: Answer) -> None:
    """Fill row k of a track."""
    if answer.T_cam_model is not None:
        track.T_cam_model[k] = answer.T_cam_model
    estimate = answer.estimate
    if estimate is None:
        return
    track.nis[k], track.nis_dof[k] = estimate.nis, estimate.nis_dof
    track.window_nis[k], track.inlier_ratio[k] = estimate.window_nis, estimate.inlier_ratio
    track.n_rectangles[k] = estimate.n_rectangles
    state, covariance = estimate.state, estimate.covariance
    if state is None or covariance is None or track.covariance is None:
        return
    track.r_hill[k], track.v_hill[k] = state.r_hill, state.v_hill
    track.com_model[k], track.R_world_body[k] = state.com_model, state.R_world_body
    track.omega_body[k], track.inertia_ratios[k] = state.omega_body, state.inertia_ratios
    track.covariance[k], track.sd[k] = covariance, np.sqrt(np.diag(covariance))
