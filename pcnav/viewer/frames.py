"""Depth frames on demand: read, unprojected and compared with the model, a few of them kept."""

import threading
from collections import OrderedDict
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
import numpy.typing as npt

from pcnav.config.depth import PerceptionTable
from pcnav.core.arrays import BoolArray, FloatArray, IntArray
from pcnav.core.camera import PinholeCamera, pixel_rays
from pcnav.core.errors import InputError
from pcnav.core.spatial import transform_points
from pcnav.perception.scans import exposure_of_scan
from pcnav.recordings.sequence import Frame, Sequence, stated_or_default_sigma
from pcnav.target.rendering import DepthRenderer
from pcnav.target.row_motion import Exposure, Readout, row_times
from pcnav.target.satellite import Target
from pcnav.viewer.colouring import (
    EXPLAINED_SIGMA,
    Colours,
    face_names,
    label_colours,
    labels_of,
    range_residual,
    residual_colours,
    residual_scale,
)
from pcnav.viewer.palette import BESIDE, PLAIN

_MAX_KEPT_BYTES = 64_000_000
"""Of frames in memory, those of one run together."""
_MAX_RENDERERS = 4
"""A frame with many returns is shown by fewer of its pixels than its neighbour."""
_REACH_FRACTION = 0.55
"""Of the ball about the target, over the diameter; half of it holds the mesh itself."""
MAX_POINTS = 60_000
"""A browser without a graphics card draws no more of a cloud in time, unless the user says so."""

Labels = npt.NDArray[np.int16]
Pixels = tuple[npt.NDArray[np.int16], npt.NDArray[np.int16]]
"""Rows and columns."""


class ColourBy(StrEnum):
    """What the colour of a point tells."""

    PLANE = "plane"
    RECTANGLE = "rectangle"
    RESIDUAL = "residual, mm"
    PLAIN = "plain"


@dataclass(frozen=True)
class Shot:
    """One depth frame, ready to be drawn: every so many of its rows and columns."""

    frame: Frame
    """The rows and columns that are shown, as a frame of a camera that has no others. What follows
    is told of its returns alone, row by row: most of a large image may be empty."""
    stride: int
    n_returns: int
    """Of the whole frame."""
    shown: Pixels
    """(n,) each: the pixels of ``frame`` that returned."""
    points: npt.NDArray[np.float32]
    """(n, 3) camera frame, m."""
    planes: Labels
    """(n,) flat part of the surface that explains a return, -1 for none."""
    rectangles: Labels | None
    """(n,) rectangle of the catalogue; None without an estimate."""
    residual_m: npt.NDArray[np.float32] | None
    """(n,) range measured minus modelled, nan off the model; None without an estimate."""
    beside: BoolArray | None = None
    """(n,) what is farther from the target than it reaches; None without an estimate."""

    @property
    def n_bytes(self) -> int:
        """What it takes in memory."""
        kept = (self.frame.depth_m, *self.shown, self.points, self.planes)
        compared = (self.rectangles, self.residual_m, self.beside)
        return sum(each.nbytes for each in (*kept, *compared) if each is not None)

    @property
    def beside_share(self) -> float:
        """Share of the returns that belong to other things than the target."""
        if self.beside is None or not len(self.points):
            return 0.0
        return float(np.count_nonzero(self.beside) / len(self.points))

    def colours(self, by: ColourBy, scale_m: float) -> Colours:
        """(n, 3) of the returns, residuals up to a scale; (3,) one for all."""
        if by is ColourBy.PLAIN:
            return np.array(PLAIN, dtype=np.uint8)
        if self.shows_residuals(by):
            assert self.residual_m is not None
            found = residual_colours(self.residual_m, scale_m)
        else:
            # Of rectangles where those are asked for and known, else of planes.
            of_rectangles = by is ColourBy.RECTANGLE and self.rectangles is not None
            labels = self.rectangles if of_rectangles else self.planes
            assert labels is not None
            found = label_colours(labels)
        if self.beside is not None:
            found[self.beside] = BESIDE
        return found

    def shows_residuals(self, by: ColourBy) -> bool:
        """Whether its colours are those of residuals: without an estimate there are none."""
        return by is ColourBy.RESIDUAL and self.residual_m is not None


class FrameStore:
    """The frames of one run, by number; safe to ask from several threads.

    ``settings`` and ``seed`` are those of the run: they find the planes of a frame that has no
    estimate.
    """

    def __init__(
        self, sequence: Sequence, target: Target, settings: PerceptionTable, seed: int
    ) -> None:
        self.recording, self._target = sequence, target
        self._settings, self._seed = settings, seed
        self.sigma_m = stated_or_default_sigma(sequence.info, settings.range_sigma_m)
        self.scale_m = residual_scale(self.sigma_m)
        self._names = face_names(target.mesh, target.rectangles)
        self._renderers: dict[PinholeCamera, DepthRenderer] = {}
        # One thread at a time: the ray caster is shared, and two that ask for the same frame
        # would read it twice.
        self._lock = threading.Lock()
        self._kept: OrderedDict[_Key, Shot | None] = OrderedDict()
        self._kept_bytes = 0
        self._reader = ThreadPoolExecutor(1, "pcnav frames")
        self._ahead: Future[Shot | None] | None = None

    def get(
        self,
        index: int,
        time_s: float,
        T_cam_model: FloatArray | None,
        max_points: int = MAX_POINTS,
        motion: Readout | None = None,
    ) -> Shot | None:
        """A frame compared with the model at a pose (4, 4); None where it is not on disk.

        ``motion`` is the target's in the camera, where the frame took a time to be taken. No more
        than about so many of its returns are read, compared and drawn.
        """
        pose = None if T_cam_model is None else tuple(T_cam_model.ravel().tolist())
        key = (index, time_s, pose, max_points)
        with self._lock:
            if key in self._kept:
                self._kept.move_to_end(key)
            else:
                self._keep(key, self._read(*key, motion))
            return self._kept[key]

    def read_ahead(
        self,
        index: int,
        time_s: float,
        T_cam_model: FloatArray | None,
        max_points: int,
        motion: Readout | None = None,
    ) -> None:
        """Get a frame that will be asked for next, unless another is being read ahead."""
        if self._ahead is None or self._ahead.done():
            asked = (index, time_s, T_cam_model, max_points, motion)
            self._ahead = self._reader.submit(self.get, *asked)

    @property
    def takes_time(self) -> bool:
        """Whether a frame's returns are seen one after the other."""
        return self.recording.info.takes_time

    def _keep(self, key: "_Key", shot: Shot | None) -> None:
        self._kept[key] = shot
        self._kept_bytes += 0 if shot is None else shot.n_bytes
        while self._kept_bytes > _MAX_KEPT_BYTES and len(self._kept) > 1:
            _, gone = self._kept.popitem(last=False)
            self._kept_bytes -= 0 if gone is None else gone.n_bytes

    def camera(self) -> PinholeCamera | None:
        """The camera of the first frame; None where that is not on disk."""
        try:
            return self.recording.frame(0).camera
        except InputError:
            return None

    def _read(
        self,
        index: int,
        time_s: float,
        pose: tuple[float, ...] | None,
        max_points: int,
        motion: Readout | None,
    ) -> Shot | None:
        if index >= len(self.recording):
            return None
        try:
            whole = self.recording.frame(index)
        except InputError:
            return None
        if whole.time_s != time_s:
            return None
        n_returns = int(np.count_nonzero(whole.depth_m > 0.0))
        stride = _stride(n_returns, max_points)
        frame = whole.strided(stride)
        rows, columns = np.divmod(np.flatnonzero(frame.depth_m > 0.0), frame.depth_m.shape[1])
        rays, depth_m = rays_at(frame, rows, columns), frame.depth_m[rows, columns]
        points = (rays * depth_m[:, None].astype(np.float64)).astype(np.float32)
        shown = (rows.astype(np.int16), columns.astype(np.int16))
        if pose is None:
            labels = self._planes(whole, n_returns, stride * rows, stride * columns)
            return Shot(frame, stride, n_returns, shown, points, labels, None, None)
        T_cam_model = np.reshape(pose, (4, 4))
        model_m, faces = self._modelled(frame, rays, shown, T_cam_model, motion)
        residual_m = range_residual(depth_m, rays, model_m, faces)
        planes, rectangles = (
            labels_of(faces, residual_m, of_face, self.sigma_m).astype(np.int16)
            for of_face in (self._names.plane, self._names.rectangle)
        )
        return Shot(
            *(frame, stride, n_returns, shown, points, planes, rectangles),
            residual_m.astype(np.float32),
            self._beside(points, T_cam_model),
        )

    def _planes(self, whole: Frame, n_returns: int, rows: IntArray, columns: IntArray) -> Labels:
        """(n,) planes that are found in a frame without an estimate, at some of its pixels.

        They are looked for in no more returns than are drawn by default: all of a large image
        would take seconds and most of a gigabyte.
        """
        # It brings Open3D, which most views never need and all would wait for.
        from pcnav.perception.perceive import perceive

        stride = _stride(n_returns, MAX_POINTS)
        seen = perceive(whole.strided(stride), (), self._settings, self.sigma_m, self._seed)
        return seen.image_labels[rows // stride, columns // stride].astype(np.int16)

    def _modelled(
        self,
        frame: Frame,
        rays: FloatArray,
        shown: Pixels,
        T_cam_model: FloatArray,
        motion: Readout | None,
    ) -> tuple[FloatArray, IntArray]:
        """z-depth (n,), m, of the model where the returns of a frame look, and its faces (n,)."""
        renderer = self._renderer(frame.camera)
        exposure = self._exposure(frame, T_cam_model, motion)
        if exposure is None:
            # Of a large image that is mostly empty only the returns have to be asked for.
            return renderer.cast(rays, T_cam_model)
        rendered = renderer.render(T_cam_model, exposure)
        return rendered.depth_m[shown].astype(np.float64), rendered.triangle[shown]

    def _exposure(
        self, frame: Frame, T_cam_model: FloatArray, motion: Readout | None
    ) -> Exposure | None:
        """When and where the pixels of a frame look; None where all look at once."""
        if frame.beams is not None:
            return exposure_of_scan(frame.beams, frame.camera, T_cam_model, motion)
        readout_s = self.recording.info.row_readout_s
        if readout_s == 0.0 or motion is None:
            return None
        times_s = row_times(readout_s, frame.camera.height)
        return Exposure.by_rows(motion.poses(T_cam_model, times_s), frame.camera.width)

    def _beside(self, points: npt.NDArray[np.float32], T_cam_model: FloatArray) -> BoolArray:
        """(n,) returns (n, 3) that lie outside a ball about the target at a pose."""
        middle = np.asarray(self._target.mesh.bounds).mean(axis=0)
        off = points - transform_points(T_cam_model, middle[None])[0].astype(np.float32)
        reach_m = _REACH_FRACTION * self._target.diameter_m + EXPLAINED_SIGMA * self.sigma_m
        return np.asarray(np.einsum("ij,ij->i", off, off) > reach_m**2)

    def _renderer(self, camera: PinholeCamera) -> DepthRenderer:
        if camera not in self._renderers:
            # Some sequences state a camera for every frame.
            if len(self._renderers) >= _MAX_RENDERERS:
                self._renderers.clear()
            self._renderers[camera] = DepthRenderer(self._target.mesh, camera)
        return self._renderers[camera]


def _stride(n_returns: int, most: int) -> int:
    """Of so many returns, one in how many rows and columns leaves no more than so many."""
    return max(1, int(np.ceil(np.sqrt(n_returns / most))))


def rays_at(frame: Frame, rows: IntArray, columns: IntArray) -> FloatArray:
    """(n, 3) that some pixels of a frame look along, z = 1."""
    camera = frame.camera
    if frame.beams is not None:
        return np.asarray(frame.beams.image_rays(camera)[rows, columns])
    if camera.distortion is not None:
        return np.asarray(pixel_rays(camera)[rows, columns])
    rays = np.ones((len(rows), 3))
    rays[:, 0], rays[:, 1] = (columns - camera.cx) / camera.fx, (rows - camera.cy) / camera.fy
    return rays


_Key = tuple[int, float, tuple[float, ...] | None, int]
