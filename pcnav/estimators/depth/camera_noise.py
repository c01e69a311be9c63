"""The noise of the camera's recorded pose, in a frame that shows where the target is.

A frame tells the target's pose in the camera. Carried into the world it has the error of the
camera's own pose as well, which all that the frame shows has in common.
"""

from dataclasses import dataclass

import numpy as np

from pcnav.core.arrays import FloatArray
from pcnav.core.spatial import skew


@dataclass(frozen=True)
class CameraNoise:
    """Standard deviations of `T_cam_world`, white from frame to frame."""

    position_sd_m: float = 0.0
    """Of each component of the camera's position."""
    attitude_sd_rad: float = 0.0
    """Of its attitude about each of its axes."""

    @property
    def is_there(self) -> bool:
        """Whether there is any."""
        return self.position_sd_m > 0.0 or self.attitude_sd_rad > 0.0

    def by_unit(self, T_cam_model: FloatArray) -> FloatArray:
        """(6, 6) what errors of unit variance make of a target's pose (4, 4) in the camera: shift
        of its origin (m, camera axes), rotation (rad, model axes); (6, 0) where there are none.

        A camera that is turned by t and shifted by d sees a point p at ``p - t x p - d``.
        """
        if not self.is_there:
            return np.empty((6, 0))
        made = np.zeros((6, 6))
        made[:3, :3] = -self.position_sd_m * np.eye(3)
        made[:3, 3:] = self.attitude_sd_rad * skew(T_cam_model[:3, 3])
        made[3:, 3:] = -self.attitude_sd_rad * T_cam_model[:3, :3].T
        return made

    def of_pose(self, T_cam_model: FloatArray) -> FloatArray:
        """(6, 6) covariance of the error that it makes of a target's pose (4, 4) in the camera."""
        made = self.by_unit(T_cam_model)
        return np.asarray(made @ made.T)


EXACT = CameraNoise()
"""Poses as they are."""
