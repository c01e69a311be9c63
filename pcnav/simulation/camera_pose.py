"""Recorded poses of a camera, which are not quite those it had."""

import numpy as np

from pcnav.config.sensors import CameraTable
from pcnav.core.arrays import FloatArray
from pcnav.core.spatial import exp_rotation, make_transform

_CAMERA_STREAM = 4


def recorded_poses(T_cam_world: FloatArray, camera: CameraTable, seed: int) -> FloatArray:
    """(n, 4, 4) what a recording states of camera poses T_cam_world (n, 4, 4).

    Off by white noise in the camera's position, in each component, and in its attitude, about each
    of its axes. The same seed draws the same, and more noise is the same draws made larger.
    """
    if camera.position_sd_m == 0.0 and camera.attitude_sd_deg == 0.0:
        return T_cam_world
    rng = np.random.default_rng([seed, _CAMERA_STREAM])
    shift, turn = np.moveaxis(rng.standard_normal((len(T_cam_world), 2, 3)), 1, 0)
    off = exp_rotation(np.deg2rad(camera.attitude_sd_deg) * turn)
    return np.asarray(make_transform(off, camera.position_sd_m * shift) @ T_cam_world)
