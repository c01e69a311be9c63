"""An estimator that gives a pose or none, and says nothing of what it is worth."""

from abc import abstractmethod

from pcnav.core.arrays import FloatArray
from pcnav.dynamics.blocks import POSE_LAYOUT
from pcnav.estimators.interface import Estimator
from pcnav.recordings.sequence import Frame
from pcnav.runs.estimate import Estimate, Output
from pcnav.runs.status import Status


class Baseline(Estimator):
    """From depth frames, in their order, to poses alone."""

    output = Output(POSE_LAYOUT, has_nis=False)

    @abstractmethod
    def pose(self, frame: Frame) -> FloatArray | None:
        """(4, 4) T_cam_model in the next frame; None where it finds none."""

    def step(self, frame: Frame, /) -> Estimate:
        """The pose, called locked wherever there is one."""
        pose = self.pose(frame)
        status = Status.LOST if pose is None else Status.LOCKED
        return Estimate(frame.time_s, str(status), T_cam_target=pose)
