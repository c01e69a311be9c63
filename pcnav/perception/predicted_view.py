"""What the catalogue faces should look like from a predicted pose.

A face in an image is seldom the bare rectangle of the catalogue: other parts and the image border
hide some of it, and rims thinner than a pixel count as part of it. So the model is ray-cast at the
predicted pose and that clean frame goes through the very same segmentation and moments as the
measured one. How the moments of an expected face sit on its catalogue rectangle is then known.
"""

from dataclasses import dataclass, replace

import numpy as np

from pcnav.config.depth import PerceptionTable
from pcnav.core.arrays import FloatArray, IntArray
from pcnav.core.camera import PinholeCamera
from pcnav.perception.rectangles import SegmentShape, shape_of_segment
from pcnav.perception.returns import Window, window_of_returns
from pcnav.perception.segmentation import (
    PredictedSurface,
    Segment,
    Segmenter,
    settled_pixels,
)
from pcnav.recordings.sequence import Frame
from pcnav.target.rendering import DepthRenderer, RenderedDepth
from pcnav.target.satellite import Rectangle, Target

_ON_FACE_FRACTION = 1e-3
"""A triangle lies on a catalogue rectangle when it is this close to it, over the diameter."""
_SAME_PLANE = 1e-6
"""Relative difference below which two planes are one."""
_NO_FACE = -1


@dataclass(frozen=True)
class PredictedFace:
    """One catalogue rectangle as the predicted pose shows it."""

    rectangle: Rectangle
    T_cam_rect: FloatArray
    """(4, 4) predicted pose of the whole catalogue rectangle."""
    shape: SegmentShape
    """Of the part that is seen."""
    n_pixels: int


@dataclass(frozen=True)
class PredictedView:
    """The predicted view."""

    rendered: RenderedDepth
    surface: PredictedSurface | None
    """What each pixel should show; None when the target is out of view."""
    faces: tuple[PredictedFace, ...]
    labels: IntArray
    """(height, width) of the image: index into ``faces``, -1 for none."""


class ViewPredictor:
    """Predicts views of one target through one camera; the ray-casting scene is built once."""

    def __init__(
        self, target: Target, camera: PinholeCamera, settings: PerceptionTable, range_sigma_m: float
    ) -> None:
        self._target = target
        self.camera = camera
        self._settings = settings
        self.sigma_m = range_sigma_m
        """Noise along the ray."""
        self._renderer = DepthRenderer(target.mesh, camera)
        self._face_of_triangle = rectangle_of_triangle(target)

    def render(self, T_cam_model: FloatArray) -> RenderedDepth:
        """The clean view from a pose (4, 4)."""
        return self._renderer.render(T_cam_model)

    def predict(self, T_cam_model: FloatArray) -> PredictedView:
        """The faces that a pose (4, 4) shows."""
        rendered = self.render(T_cam_model)
        no_labels = np.full(rendered.depth_m.shape, _NO_FACE, dtype=np.intp)
        frame = Frame(0, 0.0, rendered.depth_m, rendered.camera, np.eye(4))
        window = window_of_returns(frame)
        if window is None:
            return PredictedView(rendered, None, (), no_labels)
        part = window.part
        shown = np.where(
            rendered.triangle[part] >= 0, self._face_of_triangle[rendered.triangle[part]], _NO_FACE
        ).ravel()
        counts = np.bincount(shown[shown >= 0], minlength=len(self._target.rectangles))
        planes, plane_of = self._visible_planes(counts, T_cam_model)
        if not planes:
            return PredictedView(rendered, None, (), no_labels)
        # The frame will be segmented with this surface as a guide, so the view is, too.
        segmenter = Segmenter(window, self.sigma_m, self._settings.minimum_plane_points)
        surface = self._surface(window, planes, segmenter.labels(planes)[0])
        segments, _ = replace(segmenter, expected=surface.part(part)).segments(planes, rounds=1)
        faces: list[PredictedFace] = []
        image = no_labels[part]
        for segment in segments:
            index = _rectangle_shown(segment, shown[segment.pixels], planes, plane_of)
            if index is None:
                continue
            rectangle = self._target.rectangles[index]
            shape = shape_of_segment(
                frame.camera, window, segment, self.sigma_m, self._settings.mode
            )
            image[np.unravel_index(segment.pixels, window.shape)] = len(faces)
            T_cam_rect = T_cam_model @ rectangle.T_model_rect
            faces.append(PredictedFace(rectangle, T_cam_rect, shape, len(segment.pixels)))
        return PredictedView(rendered, surface, tuple(faces), no_labels)

    def _surface(
        self, window: Window, planes: tuple[FloatArray, ...], plane_labels: IntArray
    ) -> PredictedSurface:
        """The expected surface over the whole image."""
        range_m = window.range_m.reshape(window.shape)
        settled = settled_pixels(plane_labels, range_m, self.sigma_m)
        shape = (self.camera.height, self.camera.width)
        surface = PredictedSurface(
            planes,
            np.full(shape, _NO_FACE, dtype=np.intp),
            np.zeros(shape),
            np.zeros(shape, dtype=bool),
        )
        surface.labels[window.part] = plane_labels
        surface.range_m[window.part] = range_m
        surface.settled[window.part] = settled
        return surface

    def _visible_planes(
        self, counts: IntArray, T_cam_model: FloatArray
    ) -> tuple[tuple[FloatArray, ...], dict[int, int]]:
        """Planes m of the rectangles that show enough pixels, largest first, coplanar ones once;
        and which plane each rectangle lies in."""
        planes: list[FloatArray] = []
        plane_of: dict[int, int] = {}
        for index in np.argsort(-counts).tolist():
            if counts[index] < self._settings.minimum_plane_points:
                break
            T_cam_rect = T_cam_model @ self._target.rectangles[index].T_model_rect
            normal, point = T_cam_rect[:3, 2], T_cam_rect[:3, 3]
            m = normal / (normal @ point)
            distance = [np.linalg.norm(m - other) / np.linalg.norm(m) for other in planes]
            if distance and min(distance) < _SAME_PLANE:
                plane_of[index] = int(np.argmin(distance))
            else:
                plane_of[index] = len(planes)
                planes.append(m)
        return tuple(planes), plane_of


def _rectangle_shown(
    segment: Segment, shown: IntArray, planes: tuple[FloatArray, ...], plane_of: dict[int, int]
) -> int | None:
    """The rectangle in the segment's own plane that most of its pixels show, if any."""
    distance = [np.linalg.norm(segment.fit.m - m) / np.linalg.norm(m) for m in planes]
    own = int(np.argmin(distance))
    counts = np.bincount(shown[shown >= 0], minlength=1)
    candidates = [
        index for index, plane in plane_of.items() if plane == own and index < len(counts)
    ]
    best = max(candidates, key=lambda index: int(counts[index]), default=None)
    return None if best is None or counts[best] == 0 else best


def rectangle_of_triangle(target: Target) -> IntArray:
    """(n,) index of the catalogue rectangle each triangle of the mesh lies on, -1 for none."""
    tolerance = _ON_FACE_FRACTION * target.diameter_m
    centres, normals = target.mesh.triangles_center, target.mesh.face_normals
    found = np.full(len(centres), _NO_FACE, dtype=np.intp)
    # Largest first in the catalogue: a small rectangle that shares a plane keeps its triangles.
    for index, rectangle in enumerate(target.rectangles):
        R, origin = rectangle.T_model_rect[:3, :3], rectangle.T_model_rect[:3, 3]
        local = (centres - origin) @ R
        half = 0.5 * np.array([rectangle.width_m, rectangle.length_m]) + tolerance
        inside = (np.abs(local[:, :2]) <= half).all(axis=1) & (np.abs(local[:, 2]) <= tolerance)
        found[inside & (np.abs(normals @ R[:, 2]) > 0.999)] = index
    return found
