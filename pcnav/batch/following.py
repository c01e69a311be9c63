"""One estimator over the frames of one scene; what it said, frame by frame, beside the bound."""

import time
from dataclasses import dataclass

import numpy as np

from pcnav.core.arrays import FloatArray
from pcnav.dynamics.state import COM_MODEL, INERTIA_RATIOS, OMEGA_BODY, THETA_BODY
from pcnav.estimators.interface import Estimator
from pcnav.evaluation.bound import SceneBound, pose_jacobian
from pcnav.runs.collector import collected
from pcnav.runs.estimate import Estimate
from pcnav.runs.run import Run
from pcnav.simulation.depth import Scene
from pcnav.simulation.motion import TrueMotion

BOUNDED = ("position", "attitude", "rate", "com", "inertia_ratios")
"""What the columns of `Followed.bound` are of."""


@dataclass(frozen=True)
class Followed:
    """What an estimator said of a scene."""

    run: Run
    """With its covariances."""
    frame_s: FloatArray
    """(n,) processor time on each frame."""
    bound: FloatArray
    """(n, 5) roots of the traces of the posterior Cramer-Rao bound's blocks, as in `BOUNDED`, SI:
    the least RMS error of the pose's position, the attitude, the rate, the mass centre and the
    inertia ratios. nan where it does not hold."""


def follow(
    scene: Scene, name: str, estimator: Estimator, bound: SceneBound | None = None
) -> Followed:
    """Put an estimator of a name to all frames of a scene; one frame at a time is in memory.

    What is kept of a frame is some 4 kB, most of it the covariance. Time is spent on the bound and
    on the frames themselves, too, but none of it counts.
    """
    n, estimates = len(scene.motion.truth.time_s), list[Estimate]()
    seconds, bounds = np.full(n, np.nan), np.full((n, len(BOUNDED)), np.nan)
    for k, frame in enumerate(scene):
        started = time.process_time()
        estimates.append(estimator.step(frame))
        seconds[k] = time.process_time() - started
        if bound is not None:
            bounds[k] = _least_errors(bound.step(frame), scene.motion, k)
    return Followed(collected(name, estimator.output, estimates), seconds, bounds)


def _least_errors(P: FloatArray, motion: TrueMotion, k: int) -> FloatArray:
    """(5,) row of `Followed.bound` of a (20, 20) bound."""
    H = pose_jacobian(motion.state(k), motion.T_cam_world[k], motion.R_hill_world[k])[:3]
    variance = np.diag(P)
    blocks = (THETA_BODY, OMEGA_BODY, COM_MODEL, INERTIA_RATIOS)
    traces = [np.trace(H @ P @ H.T), *(variance[block].sum() for block in blocks)]
    return np.asarray(np.sqrt(traces))
