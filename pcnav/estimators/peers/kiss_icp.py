"""The target's motion without any model of it: KISS-ICP on the returns of each frame.

KISS-ICP (Vizzo et al. 2023) registers each cloud to a map of the earlier ones and says how the
sensor moved in that map. Seen from the sensor it is the target that moved, by the inverse. It knows
neither mesh nor mass centre, so it is the baseline that a model has to beat.

Its defaults are for cars. Here every length follows the size of what is seen, and the clouds are
shifted to the centroid of the first: the motion to be found is then a turn about the target's
middle, not about a camera many sizes away.
"""

import numpy as np
from kiss_icp.config import KISSConfig
from kiss_icp.config.config import (
    AdaptiveThresholdConfig,
    DataConfig,
    MappingConfig,
    RegistrationConfig,
)
from kiss_icp.kiss_icp import KissICP

from pcnav.core.arrays import FloatArray
from pcnav.core.spatial import invert_transform, make_transform
from pcnav.estimators.interface import Given
from pcnav.estimators.peers.baseline import Baseline
from pcnav.perception.returns import returns_of
from pcnav.recordings.sequence import Frame

_MIN_POINTS = 50
"""A cloud smaller than this tells no pose."""
_REACH = 2.0
"""Points further than so many sizes from the first centroid are left out."""
_VOXEL = 1.0 / 60.0
_POINTS_PER_VOXEL = 5
"""Thinner than the default of 20: a map as dense as the image holds a slow target back, because
every noisy point then finds a neighbour near where it was before."""
_FIRST_THRESHOLD = 1.0 / 30.0
_MIN_MOTION = 1.0 / 1000.0
_CONVERGENCE = 1e-6
"""Lengths of KISS-ICP's settings as shares of the size."""
_EXTENT_PERCENTILES = (2.0, 98.0)


class Odometry:
    """Follows whatever a depth camera sees, frame by frame.

    Memory grows with the surface seen, not with the number of frames. The same frames give the
    same motion bit for bit; environment variables named ``kiss_icp_*`` change nothing.
    """

    def __init__(self, size_m: float | None = None) -> None:
        """``size_m``: diameter of the target; None takes the extent of the first cloud.

        Raises ``ValueError`` when the size is not a positive number.
        """
        if size_m is not None and not 0.0 < size_m < np.inf:
            raise ValueError(f"expected a size above 0 m, got {size_m}")
        self._size_m = size_m
        self._origin = np.zeros(3)
        self._kiss: KissICP | None = None

    def register(self, frame: Frame) -> FloatArray | None:
        """(4, 4) T_now_first, the motion since the first frame with returns.

        It takes a point of the target, in camera axes then, to where it is in the camera now; None
        where fewer than 50 points came back. The target may drift by its own size from there.
        """
        points = returns_of(frame)
        if self._kiss is None and len(points) >= _MIN_POINTS:
            self._size_m = self._size_m or _extent(points)
            self._origin = points.mean(axis=0)
            self._kiss = KissICP(_settings(self._size_m))
        T_now_first = None
        if self._kiss is not None and self._size_m is not None:
            centred = points - self._origin
            points = centred[np.linalg.norm(centred, axis=1) < _REACH * self._size_m]
            if len(points) >= _MIN_POINTS:
                self._kiss.register_frame(points, np.array([]))
                T_cam_centred = make_transform(np.eye(3), self._origin)
                # last_pose takes the present sensor axes to those of the map, the first frame's.
                T_now_map = invert_transform(self._kiss.last_pose)
                T_now_first = T_cam_centred @ T_now_map @ invert_transform(T_cam_centred)
        return T_now_first


class KissIcp(Baseline):
    """The peer without a model: how the target moved since the first frame, whose pose is given."""

    def __init__(self, given: Given) -> None:
        self._T_cam_model_first = given.first_pose
        self._odometry = Odometry(given.target.diameter_m)

    def pose(self, frame: Frame) -> FloatArray | None:
        """None where fewer than 50 points came back."""
        T_now_first = self._odometry.register(frame)
        return None if T_now_first is None else T_now_first @ self._T_cam_model_first


def _extent(points: FloatArray) -> float:
    """Diagonal of the box about the points, but for the outermost, m."""
    low, high = np.percentile(points, _EXTENT_PERCENTILES, axis=0)
    return float(np.linalg.norm(high - low))


def _settings(size_m: float) -> KISSConfig:
    """KISS-ICP's settings for a target of a size."""
    # Built without validation because that is where environment variables would be read.
    return KISSConfig.model_construct(
        # A frame is taken at one instant, so there is nothing to deskew.
        data=DataConfig(deskew=False, min_range=0.0, max_range=_REACH * size_m),
        mapping=MappingConfig(voxel_size=_VOXEL * size_m, max_points_per_voxel=_POINTS_PER_VOXEL),
        # More threads sum in another order each time.
        registration=RegistrationConfig(
            max_num_threads=1, convergence_criterion=_CONVERGENCE * size_m
        ),
        adaptive_threshold=AdaptiveThresholdConfig(
            initial_threshold=_FIRST_THRESHOLD * size_m, min_motion_th=_MIN_MOTION * size_m
        ),
    )
