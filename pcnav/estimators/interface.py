"""What every estimator is given, what it answers, and what is known of it beforehand."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum, StrEnum
from typing import TYPE_CHECKING, Any, ClassVar

from pcnav.config.pipeline_file import Pipeline
from pcnav.core.arrays import FloatArray
from pcnav.dynamics.mass_prior import PriorMass
from pcnav.recordings.recording import RecordingKind
from pcnav.recordings.sequence import stated_or_default_sigma
from pcnav.runs.estimate import Estimate, Output

if TYPE_CHECKING:
    from pcnav.estimators.depth.views import FrameView
    from pcnav.perception.sensor_noise import SensorNoise
    from pcnav.perception.view_hypotheses import SearchReport
    from pcnav.recordings.sequence import Frame
    from pcnav.target.row_motion import Exposure
    from pcnav.target.satellite import Target


class AxesPolicy(Enum):
    """How a truth is brought into the axes that an estimator reports in.

    A run that began axes of its own has segments: they decide then, whatever its estimator says.
    """

    SAME = "same"
    """They are the truth's."""
    SYMMETRY = "symmetry"
    """They are the model's, up to the target's symmetry: the nearest equivalent truth counts."""
    SYMMETRY_OF_FRAME = "symmetry_of_frame"
    """So, but in every frame another: of an estimator that remembers nothing."""
    PRINCIPAL = "principal"
    """They are the principal axes, of falling moments, with the signs nearest to the run."""
    PER_SEGMENT = "per_segment"
    """They are the camera's at the first frame of every segment of the run."""


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

    pipeline: Pipeline
    """Its settings, and the seed of its own random draws."""
    about: Any
    """What holds for the whole recording: a `SequenceInfo` of depth frames, otherwise the
    recording, whose frames are none of its business yet."""
    model: "Target | None" = None
    """Of depth frames."""
    T_cam_model_first: FloatArray | None = None
    """(4, 4) pose in the first frame, for those that cannot start without one."""

    @property
    def target(self) -> "Target":
        """The target's model. Raises ``ValueError`` where none was given."""
        if self.model is None:
            raise ValueError("model: expected that of the target")
        return self.model

    @property
    def range_sigma_m(self) -> float:
        """Noise along the ray as everyone is told it."""
        return stated_or_default_sigma(self.about, self.pipeline.perception.range_sigma_m)

    @property
    def first_pose(self) -> FloatArray:
        """The pose in the first frame. Raises ``ValueError`` where none was given."""
        if self.T_cam_model_first is None:
            raise ValueError("T_cam_model_first: expected a pose, this estimator cannot start")
        return self.T_cam_model_first


class Estimator(ABC):
    """Takes in the frames of a recording in order of time."""

    output: Output
    """What its answers hold."""
    min_frames: ClassVar[int] = 1
    """Frames that it takes until there can be an estimate."""

    @abstractmethod
    def step(self, frame: Any, /) -> Estimate:
        """The estimate at the time of the frame. Raises `InputError` for one that cannot be."""

    def forecast(self, frame: Any, /) -> Estimate | None:
        """What a frame of a later time in which nothing is seen would be answered; it is not taken
        in. None of one that cannot tell."""
        del frame
        return None

    def finish(self) -> Sequence[Estimate] | None:
        """All estimates once more, where frames that came later change them."""
        return None

    @property
    def best_view(self) -> "tuple[Estimate, FrameView] | None":
        """The frame understood best so far, of one that measures depth frames."""
        return None

    @property
    def search_report(self) -> "SearchReport | None":
        """Where the target was looked for, of one that searches depth frames."""
        return None

    @property
    def sensor_noise(self) -> "SensorNoise | None":
        """Noise of the sensor as it was learnt, of one that learns it."""
        return None

    def exposure(self, frame: "Frame", T_cam_model: FloatArray, /) -> "Exposure | None":
        """Where the target at a pose (4, 4) is when each pixel of the last frame sees it, as it was
        taken to move; None where all pixels see at once."""
        del frame, T_cam_model
        return None

    @property
    def mesh_scale(self) -> float:
        """By which the target was found to be larger than its mesh."""
        return 1.0

    @property
    def budget(self) -> Mapping[str, FloatArray]:
        """(n, n) covariances by the name of what makes them, which add up to that of the last
        estimate that it stood for, in the order of its layout; empty where they are not known."""
        return {}

    @property
    def remarks(self) -> tuple[str, ...]:
        """Sentences of warning that it has logged."""
        return ()

    @property
    def prior(self) -> PriorMass | None:
        """What was believed of the mass before the first frame, of one with such a belief."""
        return None


@dataclass(frozen=True)
class EstimatorEntry:
    """One estimator, as the registry lists it."""

    title: str
    takes: tuple[RecordingKind, ...]
    """The kinds of recordings that it lives on; the first is the one that is simulated for it."""
    axes: AxesPolicy
    make: Callable[[Given], Estimator]
    """Imports what it needs: the registry itself is light."""
    first_pose: FirstPose = FirstPose.NOTHING
    library: Callable[[str], object] | None = None
    """Imports an extra that it needs; given what for, raises `InputError` where it is missing."""
    judged_over_trace: bool = False
    """Whether the NEES of the inertia is that of its entries over the trace: in ratios a wide
    distribution is a bent one."""
