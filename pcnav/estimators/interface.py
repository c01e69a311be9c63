"""What every estimator is given, what it answers, and what is known of it beforehand."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import Enum, StrEnum
from typing import Any, Protocol

from pcnav.dynamics.blocks import Layout
from pcnav.recordings.recording import RecordingKind
from pcnav.runs.estimate import Estimate


class AxesPolicy(Enum):
    """How a truth is brought into the axes that an estimator reports in."""

    SAME = "same"
    """They are the truth's."""
    SYMMETRY = "symmetry"
    """They are the model's, up to the target's symmetry: the nearest equivalent truth counts."""
    PRINCIPAL = "principal"
    """They are the principal axes, of falling moments, with the signs nearest to the run."""
    PER_SEGMENT = "per_segment"
    """They are the camera's at the first frame of every segment."""


class FirstPose(StrEnum):
    """What an estimator has to be told of the pose in the first frame."""

    NOTHING = "nothing"
    NEAR = "near"
    """True but for a fixed turn and shift."""
    EXACT = "exact"
    """True: an odometry without a model says motions only, and its errors are to be its own."""


class Estimator(Protocol):
    """Takes in the frames of a recording in order of time."""

    layout: Layout

    def step(self, frame: Any, /) -> Estimate:
        """The estimate at the time of the frame. Raises `InputError` for one that cannot be."""


@dataclass(frozen=True)
class EstimatorEntry:
    """One estimator, as the registry lists it."""

    title: str
    takes: frozenset[RecordingKind]
    """The kinds of recordings that it lives on."""
    axes: AxesPolicy
    layout: Layout
    make: Callable[..., Estimator]
    settings: frozenset[str]
    """The tables of the pipeline file that it reads."""
    first_pose: FirstPose = FirstPose.NOTHING
    remembers: bool = True
    """Whether a pose follows from earlier ones: a symmetric target must then keep one attitude."""
    library: Callable[[str], object] | None = None
    """Imports an extra that it needs; given what for, raises `InputError` where it is missing."""


Registry = Mapping[str, EstimatorEntry]
