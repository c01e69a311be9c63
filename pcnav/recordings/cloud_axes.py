"""Which way the axes of a cloud's sensor point."""

from enum import StrEnum

import numpy as np

from pcnav.core.arrays import FloatArray

_R_CAM_LIDAR = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])


class CloudAxes(StrEnum):
    """Those of the sensor."""

    CAMERA = "camera"
    """x right, y down, z forward."""
    LIDAR = "lidar"
    """x forward, y left, z up."""

    @property
    def R_cam_cloud(self) -> FloatArray:
        """(3, 3) from these axes to those of a camera that looks forward."""
        return np.eye(3) if self is CloudAxes.CAMERA else _R_CAM_LIDAR

    @staticmethod
    def guessed(points: FloatArray) -> "CloudAxes":
        """Of points (n, 3): those in which most of them lie rather ahead than to the side. Points
        all about the sensor are a LiDAR's."""
        mean = np.mean(points / np.linalg.norm(points, axis=1, keepdims=True), axis=0)
        return CloudAxes.CAMERA if mean[2] > max(mean[0], 0.3) else CloudAxes.LIDAR
