"""Which matches are right: random samples of the five-point solver, from PoseLib."""

import numpy as np

from pcnav.core._extras import poselib
from pcnav.core.arrays import BoolArray, FloatArray
from pcnav.estimators.image_motion.essential import essential_of

_MIN_SAMPLES = 50
_MAX_SAMPLES = 1000
_SEED = 20221209
_SCALE = 1000.0
"""The library works in pixels: normalised coordinates are shown to it through this focal length."""


def consensus(
    first: FloatArray, second: FloatArray, threshold: float
) -> tuple[FloatArray, BoolArray]:
    """An essential matrix (3, 3) by five-point samples, and the matches (n,) that agree with it.

    ``threshold`` is the largest Sampson error of an agreeing match, normalised coordinates. The
    same matches give the same answer. Without a motion no match agrees. Raises `InputError` where
    the library is not installed.
    """
    camera = {"model": "SIMPLE_PINHOLE", "width": 0, "height": 0, "params": [_SCALE, 0.0, 0.0]}
    sampling = {
        "max_epipolar_error": _SCALE * threshold,
        "min_iterations": _MIN_SAMPLES,
        "max_iterations": _MAX_SAMPLES,
        "seed": _SEED,
    }
    pose, found = poselib("the robust solver").estimate_relative_pose(
        _SCALE * first, _SCALE * second, camera, camera, sampling
    )
    E = essential_of(np.asarray(pose.R, np.float64), np.asarray(pose.t, np.float64))
    agreeing = np.asarray(found["inliers"], dtype=np.bool_)
    if agreeing.shape != (len(first),) or not np.all(np.isfinite(E)) or not np.any(E):
        return np.eye(3), np.zeros(len(first), dtype=np.bool_)
    return E, agreeing
