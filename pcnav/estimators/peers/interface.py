"""What every estimator under test is given, and what it gives."""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from enum import StrEnum

from pcnav.config.depth import FilterTable, PerceptionTable
from pcnav.core.arrays import FloatArray
from pcnav.recordings.sequence import Frame, SequenceInfo
from pcnav.runs.results import FrameEstimate
from pcnav.runs.status import Status
from pcnav.target.satellite import Target


class FirstPose(StrEnum):
    """What an estimator has to be told of the pose in the first frame."""

    NOTHING = "nothing"
    NEAR = "near"
    """True but for a fixed turn and shift, see `pcnav.estimators.peers.icp.disturbed`."""
    EXACT = "exact"
    """True: an odometry without a model says motions only, and its errors are to be its own."""


@dataclass(frozen=True)
class Given:
    """What an estimator knows before the first frame."""

    target: Target
    info: SequenceInfo
    perception: PerceptionTable
    filtering: FilterTable
    seed: int
    """Of the estimator's own random draws."""
    T_cam_model_first: FloatArray | None = None
    """(4, 4) pose in the first frame, for those that cannot start without one; None for all
    others."""

    @property
    def range_sigma_m(self) -> float:
        """Noise along the ray as everyone is told it."""
        return self.perception.range_sigma_m or self.info.range_sigma_m

    @property
    def first_pose(self) -> FloatArray:
        """The pose in the first frame. Raises ``ValueError`` where none was given."""
        if self.T_cam_model_first is None:
            raise ValueError("T_cam_model_first: expected a pose, this estimator cannot start")
        return self.T_cam_model_first


@dataclass(frozen=True)
class Answer:
    """What an estimator says of one frame."""

    status: str
    """One of `pcnav.runs.status.Status`."""
    T_cam_model: FloatArray | None
    """(4, 4); None where it says nothing."""
    estimate: FrameEstimate | None = None
    """All that a filter says: state and covariance; None of those that give poses alone."""


class Estimator(ABC):
    """From frames, in their order, to poses."""

    @abstractmethod
    def step(self, frame: Frame) -> Answer:
        """Take in the next frame."""


class Baseline(Estimator):
    """An estimator that gives a pose or none, and says nothing of what it is worth."""

    @abstractmethod
    def pose(self, frame: Frame) -> FloatArray | None:
        """(4, 4) T_cam_model in the next frame; None where it finds none."""

    def step(self, frame: Frame) -> Answer:
        """The pose, called locked wherever there is one."""
        T_cam_model = self.pose(frame)
        return Answer(str(Status.LOST if T_cam_model is None else Status.LOCKED), T_cam_model)
