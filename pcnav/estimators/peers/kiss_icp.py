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


class KissIcp(Baseline):
    """How the target moved since the first frame with returns, whose pose is given.

    Memory grows with the surface seen, not with the number of frames. The same frames give the
    same motion bit for bit; environment variables named ``kiss_icp_*`` change nothing. The target
    may drift by its own size from where it was first seen.
    """

    def __init__(self, given: Given) -> None:
        self._T_cam_model_first, self._size_m = given.first_pose, given.target.diameter_m
        self._kiss = KissICP(_settings(self._size_m))
        self._origin: FloatArray | None = None

    def pose(self, frame: Frame) -> FloatArray | None:
        """None where fewer than 50 points came back."""
        points = returns_of(frame)
        if self._origin is None:
            if len(points) < _MIN_POINTS:
                return None
            self._origin = points.mean(axis=0)
        centred = points - self._origin
        points = centred[np.linalg.norm(centred, axis=1) < _REACH * self._size_m]
        if len(points) < _MIN_POINTS:
            return None
        self._kiss.register_frame(points, np.array([]))
        T_cam_centred = make_transform(np.eye(3), self._origin)
        # last_pose takes the present sensor axes to those of the map, the first frame's.
        T_now_map = invert_transform(self._kiss.last_pose)
        T_now_first = T_cam_centred @ T_now_map @ invert_transform(T_cam_centred)
        return T_now_first @ self._T_cam_model_first


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
