"""Depth frames on demand: read, unprojected and compared with the model, a few of them kept."""

import threading
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from pcnav.config.depth import PerceptionTable
from pcnav.core.arrays import BoolArray, FloatArray, IntArray
from pcnav.core.camera import PinholeCamera, pixel_rays
from pcnav.core.errors import InputError
from pcnav.core.spatial import transform_points
from pcnav.recordings.sequence import Frame, Sequence, stated_or_default_sigma
from pcnav.target.rendering import DepthRenderer
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

_KEPT = 48
"""Frames in memory: half a megabyte each."""
_REACH_FRACTION = 0.55
"""Of the ball about the target, over the diameter; half of it holds the mesh itself."""
_MAX_POINTS = 60_000
"""A browser draws no more of a cloud in time; larger frames show every so many points."""


Pixels = tuple[IntArray, IntArray]
"""Rows and columns."""


class ColourBy(StrEnum):
    """What the colour of a point tells."""

    PLANE = "plane"
    RECTANGLE = "rectangle"
    RESIDUAL = "residual, mm"
    PLAIN = "plain"


@dataclass(frozen=True)
class Shot:
    """One depth frame, ready to be drawn."""

    frame: Frame
    shown: Pixels
    """Those that are drawn as points."""
    points: npt.NDArray[np.float32]
    """(n, 3) camera frame, m."""
    planes: IntArray
    """(height, width) flat part of the surface that explains a return, -1 for none."""
    rectangles: IntArray | None
    """(height, width) rectangle of the catalogue; None without an estimate."""
    residual_m: FloatArray | None
    """(height, width) range measured minus modelled; None without an estimate."""
    beside: BoolArray | None = None
    """(height, width) what is farther from the target than it reaches; None without an estimate."""

    def colours(
        self, by: ColourBy, scale_m: float, at: Pixels | BoolArray | None = None
    ) -> Colours:
        """(n, 3) of pixels, by default of the points, residuals up to a scale; (3,) one for all."""
        at = self.shown if at is None else at
        if by is ColourBy.PLAIN:
            return np.array(PLAIN, dtype=np.uint8)
        if self.shows_residuals(by):
            assert self.residual_m is not None
            found = residual_colours(self.residual_m[at], scale_m)
        else:
            # Of rectangles where those are asked for and known, else of planes.
            of_rectangles = by is ColourBy.RECTANGLE and self.rectangles is not None
            labels = self.rectangles if of_rectangles else self.planes
            assert labels is not None
            found = label_colours(labels[at])
        if self.beside is not None:
            found[self.beside[at]] = BESIDE
        return found

    def shows_residuals(self, by: ColourBy) -> bool:
        """Whether its colours are those of residuals: without an estimate there are none."""
        return by is ColourBy.RESIDUAL and self.residual_m is not None

    def thinned(self, most: int) -> "Shot":
        """The same frame with no more than so many points, evenly left out."""
        step = max(1, -(-len(self.points) // most))
        rows, columns = self.shown
        return replace(self, points=self.points[::step], shown=(rows[::step], columns[::step]))


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
        self._kept = lru_cache(_KEPT)(self._read)

    def get(self, index: int, time_s: float, T_cam_model: FloatArray | None) -> Shot | None:
        """A frame compared with the model at a pose (4, 4); None where it is not on disk."""
        pose = None if T_cam_model is None else tuple(T_cam_model.ravel().tolist())
        with self._lock:
            return self._kept(index, time_s, pose)

    def camera(self) -> PinholeCamera | None:
        """The camera of the first frame; None where that is not on disk."""
        try:
            return self.recording.frame(0).camera
        except InputError:
            return None

    def _read(self, index: int, time_s: float, pose: tuple[float, ...] | None) -> Shot | None:
        if index >= len(self.recording):
            return None
        try:
            frame = self.recording.frame(index)
        except InputError:
            return None
        if frame.time_s != time_s:
            return None
        rows, columns = np.nonzero(frame.depth_m > 0.0)
        step = max(1, -(-len(rows) // _MAX_POINTS))
        shown = (rows[::step], columns[::step])
        rays, depth_m = pixel_rays(frame.camera)[shown], frame.depth_m[shown]
        points = (rays * depth_m[:, None].astype(np.float64)).astype(np.float32)
        if pose is None:
            # It brings Open3D, which most views never need and all would wait for.
            from pcnav.perception.perceive import perceive

            seen = perceive(frame, (), self._settings, self.sigma_m, self._seed)
            return Shot(frame, shown, points, seen.image_labels, None, None)
        T_cam_model = np.reshape(pose, (4, 4))
        rendered = self._renderer(frame.camera).render(T_cam_model)
        residual_m = range_residual(frame.depth_m, rendered)
        planes, rectangles = (
            labels_of(rendered, residual_m, of_face, self.sigma_m)
            for of_face in (self._names.plane, self._names.rectangle)
        )
        beside = self._beside(frame, T_cam_model)
        return Shot(frame, shown, points, planes, rectangles, residual_m, beside)

    def _beside(self, frame: Frame, T_cam_model: FloatArray) -> BoolArray:
        """(height, width) returns that lie outside a ball about the target at a pose."""
        middle = np.asarray(self._target.mesh.bounds).mean(axis=0)
        off = pixel_rays(frame.camera) * frame.depth_m[..., None].astype(np.float64)
        off -= transform_points(T_cam_model, middle[None])[0]
        reach_m = _REACH_FRACTION * self._target.diameter_m + EXPLAINED_SIGMA * self.sigma_m
        return np.asarray((frame.depth_m > 0.0) & (np.einsum("ijk,ijk->ij", off, off) > reach_m**2))

    def _renderer(self, camera: PinholeCamera) -> DepthRenderer:
        if camera not in self._renderers:
            # Some sequences state a camera for every frame.
            self._renderers.clear()
            self._renderers[camera] = DepthRenderer(self._target.mesh, camera)
        return self._renderers[camera]
