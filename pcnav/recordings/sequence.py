"""What a depth sequence gives, whatever format it is stored in."""

from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar

import numpy as np

from pcnav.core.arrays import DepthImage, FloatArray
from pcnav.core.camera import PinholeCamera
from pcnav.recordings.recording import RecordingKind


@dataclass(frozen=True)
class Frame:
    """One depth image and where the camera was when it was taken."""

    index: int
    """Position in the sequence, counted from 0."""
    time_s: float
    depth_m: DepthImage
    """(height, width) z-depth, m; 0 = no return."""
    camera: PinholeCamera
    T_cam_world: FloatArray
    """(4, 4) camera pose; `world` is inertial and equals `hill` at time 0."""

    def strided(self, stride: int) -> "Frame":
        """Every so many pixels of it only, as a smaller camera in the same place would see them."""
        if stride == 1:
            return self
        depth_m = np.ascontiguousarray(self.depth_m[::stride, ::stride])
        return replace(self, depth_m=depth_m, camera=self.camera.strided(stride))


@dataclass(frozen=True)
class SequenceInfo:
    """What holds for the whole sequence."""

    name: str
    mean_motion_rad_s: float
    """Of the chaser's circular orbit; 0 means a laboratory (straight-line relative motion)."""
    range_sigma_m: float
    """Standard deviation of the noise along the ray."""
    target_mesh: Path | None
    """The mesh the sequence says it shows, resolved to a path, when it says so."""
    initial: "InitialPrior | None" = None


@dataclass(frozen=True)
class InitialPrior:
    """Optional prior knowledge stored with a sequence; None fields are unknown."""

    com_model_m: FloatArray | None = None
    """(3,) mass centre in the model frame."""
    com_sd_m: FloatArray | None = None
    """(3,) its standard deviations."""
    inertia_ratios: FloatArray | None = None
    """(5,)"""
    inertia_ratios_sd: FloatArray | None = None
    """(5,)"""


class Sequence(ABC):
    """A depth sequence that is read frame by frame: memory does not grow with its length."""

    kind: ClassVar[RecordingKind] = RecordingKind.DEPTH

    @property
    def name(self) -> str:
        """What it is called."""
        return self.info.name

    @property
    @abstractmethod
    def path(self) -> Path:
        """The folder it is read from."""

    @property
    @abstractmethod
    def info(self) -> SequenceInfo:
        """What holds for the whole sequence."""

    @abstractmethod
    def __len__(self) -> int: ...

    @abstractmethod
    def frame(self, index: int) -> Frame:
        """Read one frame. Raises `InputError` when its file is missing or damaged."""

    def __iter__(self) -> Iterator[Frame]:
        return (self.frame(index) for index in range(len(self)))
