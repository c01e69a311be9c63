"""The peer without a model: KISS-ICP, whose motion is carried on from the first pose."""

from pcnav.core.arrays import FloatArray
from pcnav.estimators.peers.interface import Baseline, Given
from pcnav.estimators.peers.kiss_icp import Odometry
from pcnav.recordings.sequence import Frame


class KissIcp(Baseline):
    """KISS-ICP says how the target moved since the first frame; that frame's pose is given."""

    def __init__(self, given: Given) -> None:
        self._T_cam_model_first = given.first_pose
        self._odometry = Odometry(given.target.diameter_m)

    def pose(self, frame: Frame) -> FloatArray | None:
        """None where fewer than 50 points came back."""
        T_now_first = self._odometry.register(frame).T_now_first
        return None if T_now_first is None else T_now_first @ self._T_cam_model_first
