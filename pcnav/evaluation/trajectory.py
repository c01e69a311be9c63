"""Absolute and relative trajectory errors (ATE, RPE) of an estimated trajectory.

As Sturm et al. 2012 define them ("A Benchmark for the Evaluation of RGB-D SLAM Systems", section
IV) and as evo computes them. A pose is ``T_ref_body``: of any body in any frame, the same two in
both trajectories. Poses are already matched in time, row by row, and finite.
"""

import numpy as np

from pcnav.core.arrays import FloatArray
from pcnav.core.spatial import invert_transform, rotation_angle


def absolute_errors(T_true: FloatArray, T_estimated: FloatArray) -> FloatArray:
    """(n,) distances between the positions of true and estimated poses (n, 4, 4), m: the ATE.

    Nothing is aligned: poses in one frame need no alignment.
    """
    return np.asarray(np.linalg.norm(T_estimated[:, :3, 3] - T_true[:, :3, 3], axis=1))


def relative_errors(T_true: FloatArray, T_estimated: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(n - 1,) errors of the motion from each pose to the next, m and rad in [0, pi]: the RPE.

    ``E = (T_true_i^-1 T_true_j)^-1 (T_i^-1 T_j)`` (Sturm 2012 (5)); it does not change when a
    trajectory is moved as a whole.
    """
    E = invert_transform(_motion(T_true)) @ _motion(T_estimated)
    return np.asarray(np.linalg.norm(E[:, :3, 3], axis=1)), rotation_angle(E[:, :3, :3])


def root_mean_square(errors: FloatArray) -> float:
    """Of errors (n,); nan without any."""
    return float(np.sqrt(np.mean(errors**2))) if len(errors) else np.nan


def _motion(T: FloatArray) -> FloatArray:
    return np.asarray(invert_transform(T[:-1]) @ T[1:])
