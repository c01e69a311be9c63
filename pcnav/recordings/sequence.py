"""What a depth sequence gives, whatever format it is stored in."""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, ClassVar

import numpy as np
from pydantic import Strict

from pcnav.config.first_pose import FirstPoseTable
from pcnav.config.length_unit import LengthUnit
from pcnav.config.scenario import InertiaRatios
from pcnav.config.table import Positive, Vector3
from pcnav.core.arrays import BoolArray, DepthImage, FloatArray
from pcnav.core.beams import Beams
from pcnav.core.camera import PinholeCamera, pixels_without_ray
from pcnav.core.errors import InputError
from pcnav.recordings.calibration import Calibration
from pcnav.recordings.depth_form import PLAIN, DepthForm
from pcnav.recordings.depth_image import (
    ImageSize,
    StoredDepth,
    read_depth_image,
    require_size,
)
from pcnav.recordings.depth_units import depth_in_metres
from pcnav.recordings.frame_checks import (
    checked_camera,
    checked_depth,
    checked_time,
    checked_transform,
    checked_unseen,
    required_numbers,
)
from pcnav.recordings.recording import RecordingKind
from pcnav.recordings.scan import Scan

_ThreePositive = Annotated[tuple[Positive, Positive, Positive], Strict(False)]
_FivePositive = Annotated[tuple[Positive, Positive, Positive, Positive, Positive], Strict(False)]

DEFAULT_RANGE_SIGMA_M = 0.005
"""Assumed where nothing states the noise of a recording: a structured-light camera at 2 m."""


@dataclass(frozen=True, repr=False)
class Frame:
    """One depth image and where the camera was when it was taken.

    Its making checks it: whatever is no depth becomes a hole, and a rotation off by rounding is
    made orthonormal. Raises `InputError`, which names the frame and the field.
    """

    index: int
    """Position in the sequence, counted from 0."""
    time_s: float
    depth_m: DepthImage
    """(height, width) z-depth, m; 0 = no return."""
    camera: PinholeCamera
    T_cam_world: FloatArray
    """(4, 4) camera pose; `world` is inertial and equals `hill` at time 0."""
    unseen: BoolArray | None = None
    """(height, width) pixels of which nothing is known, not even that nothing is there: outside a
    region of interest, or nearer than the near gate. None where there is no such pixel."""
    masked_m: DepthImage | None = None
    """(height, width) z-depth, m, of what a mask left out of the frame, 0 elsewhere. Where that is
    nearer than the target it hides it, and where the target goes on in it the mask is too small.
    None where nothing was left out."""
    beams: Beams | None = None
    """Of a scan, whose image ``depth_m`` is: where and when its pixels look. None of an image."""

    def __post_init__(self) -> None:
        where = f"frame {self.index}"
        checked_time(where, self.time_s)
        checked_camera(where, self.camera)
        checked_unseen(where, self.unseen, self.camera)
        depth_m = checked_depth(where, self.depth_m, self.camera)
        T_cam_world = checked_transform(where, "T_cam_world", self.T_cam_world)
        object.__setattr__(self, "depth_m", depth_m)
        object.__setattr__(self, "T_cam_world", T_cam_world)

    @staticmethod
    def blind(index: int, time_s: float, camera: PinholeCamera, T_cam_world: FloatArray) -> "Frame":
        """A frame of which nothing is known but its time and camera."""
        shape = (camera.height, camera.width)
        depth_m, unseen = np.zeros(shape, dtype=np.float32), np.ones(shape, dtype=np.bool_)
        return Frame(index, time_s, depth_m, camera, T_cam_world, unseen)

    @staticmethod
    def of_scan(
        index: int, time_s: float, scan: Scan, camera: PinholeCamera, T_cam_world: FloatArray
    ) -> "Frame":
        """A scan laid over a camera's pixels; of those without a beam nothing is known."""
        beams = scan.on(camera)
        unseen = None if beams.is_seen.all() else ~beams.is_seen
        return Frame(index, time_s, beams.image, camera, T_cam_world, unseen, beams=beams)

    def __repr__(self) -> str:
        returns = self.depth_m[self.depth_m > 0.0]
        size, what = f"{self.camera.width} x {self.camera.height}", "no return"
        if returns.size:
            reach = f"{returns.min():.4g} to {returns.max():.4g} m"
            what = f"{returns.size:,} returns from {reach}"
        return f"<Frame {self.index} at {self.time_s:g} s: {size}, {what}>"

    def strided(self, stride: int) -> "Frame":
        """Every so many pixels of it only, as a smaller camera in the same place would see them."""
        if stride == 1:
            return self
        depth_m = np.ascontiguousarray(self.depth_m[::stride, ::stride])
        unseen, masked_m = self.unseen, self.masked_m
        if unseen is not None:
            unseen = np.ascontiguousarray(unseen[::stride, ::stride])
        if masked_m is not None:
            masked_m = np.ascontiguousarray(masked_m[::stride, ::stride])
        beams = None if self.beams is None else self.beams.strided(stride)
        return Frame(
            *(self.index, self.time_s, depth_m, self.camera.strided(stride), self.T_cam_world),
            *(unseen, masked_m, beams),
        )


class InitialPrior(FirstPoseTable):
    """[initial] of sequence.toml: prior knowledge stored with it; what is None is unknown."""

    com_model_m: Vector3 | None = None
    """Mass centre in the model frame."""
    com_sd_m: _ThreePositive | None = None
    """Its standard deviations."""
    inertia_ratios: InertiaRatios | None = None
    inertia_ratios_sd: _FivePositive | None = None


@dataclass(frozen=True)
class FirstPosePrior:
    """Where the target is believed to be in the first frame."""

    T_cam_model: FloatArray
    """(4, 4) pose of the model."""
    position_sd_m: float
    """Standard deviation of each component of its position."""
    attitude_sd_rad: float
    """Standard deviation of its attitude about each axis."""


@dataclass(frozen=True)
class SequenceInfo:
    """What holds for the whole sequence."""

    name: str
    mean_motion_rad_s: float
    """Of the chaser's circular orbit; 0 means a laboratory (straight-line relative motion)."""
    range_sigma_m: float | None
    """Standard deviation of the noise along the ray; None where it is not known."""
    target_mesh: Path | None
    """The mesh the sequence says it shows, resolved to a path, when it says so."""
    initial: InitialPrior | None = None
    camera_position_sd_m: float = 0.0
    """Standard deviation of each component of the camera's position in `T_cam_world`, camera
    axes, white from frame to frame."""
    camera_attitude_sd_rad: float = 0.0
    """Standard deviation of the camera's attitude about each of its axes, likewise."""
    row_readout_s: float = 0.0
    """Time from the exposure of the first row to that of the last; 0 of a global shutter. The
    time of a frame is that of its middle row."""
    scan_s: float = 0.0
    """Time that a scan takes, of which each return has a time of its own; 0 of images."""
    time_zero_s: float = 0.0
    """Time stamp of the recording that is time 0 of its frames."""
    first_pose: FirstPosePrior | None = None
    """None where nothing is known of it."""
    mesh_unit: LengthUnit | None = None
    """Unit of the mesh's coordinates, where the sequence states it."""
    calibration: Calibration | None = None
    """How well camera, clock and mesh are known; None where it is not stated."""

    def __post_init__(self) -> None:
        where = f"recording {self.name}"
        sigma_m = self.range_sigma_m
        if sigma_m is not None and not 0.0 < sigma_m < math.inf:
            expected = "expected a finite number above 0, or None where it is not known"
            raise InputError(where, "range_sigma_m", f"{expected}, got {sigma_m}")
        required_numbers(
            where,
            mean_motion_rad_s=self.mean_motion_rad_s,
            camera_position_sd_m=self.camera_position_sd_m,
            camera_attitude_sd_rad=self.camera_attitude_sd_rad,
            row_readout_s=self.row_readout_s,
            scan_s=self.scan_s,
        )

    @property
    def takes_time(self) -> bool:
        """Whether a frame shows a target that moves meanwhile."""
        return self.row_readout_s > 0.0 or self.scan_s > 0.0


def stated_or_default_sigma(info: SequenceInfo, chosen_m: float | None = None) -> float:
    """Noise along the ray, m: the one chosen, else the one stated, else the default."""
    return chosen_m or info.range_sigma_m or DEFAULT_RANGE_SIGMA_M


@dataclass(frozen=True, repr=False)
class Sequence:
    """Depth images in files, read frame by frame: memory does not grow with their sizes."""

    kind: ClassVar[RecordingKind] = RecordingKind.DEPTH

    path: Path
    """The folder it is read from."""
    info: SequenceInfo
    """What holds for the whole sequence."""
    images: Path
    """The folder of the images."""
    files: tuple[str, ...]
    """n of them in it, in order of time."""
    size: ImageSize
    """Of every image."""
    times_s: FloatArray
    """(n,)"""
    intrinsics: FloatArray
    """(n, 4) fx, fy, cx, cy, px."""
    depth_step_m: FloatArray
    """(n,) metres per stored unit; nan where it is not stated: floats are metres then."""
    T_cam_world: FloatArray
    """(n, 4, 4)"""
    form: DepthForm = PLAIN
    """What a stored pixel means."""
    read_image: Callable[[Path], StoredDepth] = read_depth_image
    """Reads one of the images, which need not be a file of its own. Raises `InputError`."""
    read_scan: Callable[[Path], Scan] | None = None
    """Of a recording of scans, reads one; its images are what they show on a grid of pixels."""
    object_id: int | None = None
    """Which of the objects of a BOP scene is the target; None where that was not asked."""

    def __repr__(self) -> str:
        lasts = f"{self.times_s[0]:g} to {self.times_s[-1]:g} s" if len(self) else "no time"
        frames = f"{len(self)} depth frames of {self.size.width} x {self.size.height}"
        return f"<Sequence {self.name}: {frames}, {lasts}>"

    @property
    def name(self) -> str:
        """What it is called."""
        return self.info.name

    def __len__(self) -> int:
        return len(self.files)

    def camera(self, index: int) -> PinholeCamera:
        """The camera that took a frame."""
        fx, fy, cx, cy = self.intrinsics[index].tolist()
        return PinholeCamera(*self.size, fx, fy, cx, cy, self.form.lens)

    def frame(self, index: int) -> Frame:
        """Read one frame. Raises `InputError` when its file is missing or damaged."""
        if not 0 <= index < len(self):
            raise IndexError(f"frame {index} of {len(self)}")
        path = self.images / self.files[index]
        if self.read_scan is not None:
            camera, time_s = self.camera(index), float(self.times_s[index])
            return Frame.of_scan(
                index, time_s, self.read_scan(path), camera, self.T_cam_world[index]
            )
        depth_m = self._in_metres(path, self.read_image(path), index)
        camera, time_s = self.camera(index), float(self.times_s[index])
        unseen = pixels_without_ray(camera)
        if unseen is not None:
            depth_m[unseen] = 0.0
        return Frame(index, time_s, depth_m, camera, self.T_cam_world[index], unseen)

    def blind_frame(self, index: int) -> Frame:
        """A frame of which nothing is known but its time and camera."""
        camera, time_s = self.camera(index), float(self.times_s[index])
        return Frame.blind(index, time_s, camera, self.T_cam_world[index])

    def read_depth(self, path: Path, index: int) -> DepthImage:
        """(height, width) z-depth, m, of an image in the form that the one of a frame has.

        Raises `InputError`.
        """
        return self._in_metres(path, read_depth_image(path), index)

    def taken(self, rows: slice) -> "Sequence":
        """Some of the frames, numbered anew. Raises `InputError` where none is left."""
        files = self.files[rows]
        if not files:
            expected = f"expected frames among its {len(self)}, got none from {rows.start} on"
            raise InputError(self.path, "--start", expected)
        # What is believed of the first frame holds for no other.
        first = self.info.first_pose if rows.start == 0 else None
        return replace(
            self,
            info=replace(self.info, first_pose=first),
            files=files,
            times_s=self.times_s[rows],
            intrinsics=self.intrinsics[rows],
            depth_step_m=self.depth_step_m[rows],
            T_cam_world=self.T_cam_world[rows],
        )

    def _in_metres(self, path: Path, stored: StoredDepth, index: int) -> DepthImage:
        require_size(path, stored, self.size)
        step_m = float(self.depth_step_m[index])
        if math.isnan(step_m):
            if stored.dtype.kind != "f":
                expected = "expected the mm of one unit, as integers have no unit of their own"
                raise InputError(path, "depth_scale", expected)
            step_m = 1.0
        return depth_in_metres(stored, step_m, self.form, self.camera(index))

    def __iter__(self) -> Iterator[Frame]:
        return (self.frame(index) for index in range(len(self)))
