"""How well the pose of the model is known in every frame of a run."""

import numpy as np

from pcnav.core.arrays import FloatArray
from pcnav.core.spatial import skew
from pcnav.dynamics.blocks import ATTITUDE, CENTRE, POSITION, Layout
from pcnav.dynamics.orbit import R_hill_world
from pcnav.dynamics.trajectory import Trajectory


def pose_deviations(
    trajectory: Trajectory, mean_motion_rad_s: float | None
) -> tuple[FloatArray, FloatArray]:
    """(n,) m and (n,) rad: of the model's origin, or of the mass centre where there is no model,
    and of the attitude, each along the direction that is known least.

    nan where it is not known, as of a run without covariances or, for the origin, without the mean
    motion of its orbit.
    """
    n, P, layout = len(trajectory), trajectory.covariance, trajectory.layout
    shift, turn = np.full((2, n), np.nan)
    if P is None or ATTITUDE not in layout:
        return shift, turn
    for k in np.flatnonzero(trajectory.has_estimate):
        theta = layout.slice_of(ATTITUDE)
        turn[k] = _largest(P[k, theta, theta])
        if POSITION in layout and (CENTRE not in layout or mean_motion_rad_s is not None):
            hill = R_hill_world(float(trajectory.time_s[k]), mean_motion_rad_s or 0.0)
            by_state = _origin(trajectory, layout, int(k), hill)
            shift[k] = _largest(by_state @ P[k] @ by_state.T)
    return shift, turn


def _origin(trajectory: Trajectory, layout: Layout, k: int, R_hill_world: FloatArray) -> FloatArray:
    """(3, size) derivative of ``r - R (1 + [theta]x) com`` in Hill axes."""
    by_state = np.zeros((3, layout.size))
    by_state[:, layout.slice_of(POSITION)] = np.eye(3)
    if CENTRE in layout:
        R_hill_body = R_hill_world @ trajectory[ATTITUDE][k]
        by_state[:, layout.slice_of(CENTRE)] = -R_hill_body
        by_state[:, layout.slice_of(ATTITUDE)] = R_hill_body @ skew(trajectory[CENTRE][k])
    return by_state


def _largest(covariance: FloatArray) -> float:
    return float(np.sqrt(max(np.linalg.eigvalsh(covariance)[-1], 0.0)))
