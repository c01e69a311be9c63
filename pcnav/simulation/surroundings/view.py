"""Target and parts in one clean depth image: of every pixel the nearest surface."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import trimesh

from pcnav.core.arrays import BoolArray, FloatArray, IntArray
from pcnav.core.camera import PinholeCamera
from pcnav.simulation.readout import Exposures
from pcnav.simulation.surroundings.part import Part
from pcnav.target.rendering import DepthRenderer, RenderedDepth, Window
from pcnav.target.row_motion import Exposure


@dataclass(frozen=True)
class SceneView:
    """A clean depth image of a scene."""

    seen: RenderedDepth
    """Of every pixel the nearest surface; the faces of the parts count on from the target's."""
    target: RenderedDepth
    """The target alone, as if nothing else were there."""
    part: IntArray
    """(height, width) 0 where the target is seen, 1 and up for the parts, -1 for nothing."""

    @staticmethod
    def of_target(rendered: RenderedDepth) -> "SceneView":
        """Nothing but the target."""
        return SceneView(rendered, rendered, np.where(rendered.triangle >= 0, 0, -1))

    @property
    def shows_target(self) -> BoolArray:
        """(height, width)"""
        return np.asarray(self.part == 0)


class SceneRenderer:
    """Renders the frames of a scene."""

    def __init__(
        self,
        mesh: trimesh.Trimesh,
        T_cam_model: FloatArray,
        parts: Sequence[Part],
        camera: PinholeCamera,
        exposures: Exposures | None = None,
    ) -> None:
        """``exposures`` of a sensor whose pixels are not exposed at once."""
        self._exposures, self._camera = exposures, camera
        self.meshes = (mesh, *(part.mesh for part in parts))
        """The target's first."""
        self.renderers = tuple(DepthRenderer(each, camera) for each in self.meshes)
        """Of the meshes."""
        self._poses = (T_cam_model, *(part.T_cam_part for part in parts))

    def poses(self, k: int) -> list[FloatArray]:
        """(4, 4) of the meshes in frame k; nan of those that are not there."""
        return [poses[k] for poses in self._poses]

    def render(self, k: int, rays: FloatArray | None = None) -> SceneView:
        """The clean image of frame k, of the rays that the pixels look along; of others of a scan,
        (height, width, 3), where they are given."""
        rendered = [
            (number, renderer.render(poses[k], self._exposure(number, k, rays)))
            for number, (renderer, poses) in enumerate(
                zip(self.renderers, self._poses, strict=True)
            )
            if np.isfinite(poses[k]).all()
        ]
        view = SceneView.of_target(rendered[0][1])
        for number, part in rendered[1:]:
            view = _with_part(view, part, number)
        return view

    def _exposure(self, number: int, k: int, rays: FloatArray | None) -> Exposure | None:
        """When the pixels of frame k see one of the meshes; None where all do at once."""
        if self._exposures is None:
            return None
        found = self._exposures.of_frame(number, self._poses[number], k, self._camera)
        return found if found is None or rays is None else replace(found, rays=rays)


def _with_part(view: SceneView, part: RenderedDepth, number: int) -> SceneView:
    """With a part where it is nearer than what was seen."""
    seen = view.seen
    nearer = (part.triangle >= 0) & ((seen.triangle < 0) | (part.depth_m < seen.depth_m))
    faces = len(seen.inverse_depth_planes)
    merged = replace(
        seen,
        depth_m=np.where(nearer, part.depth_m, seen.depth_m),
        triangle=np.where(nearer, part.triangle + faces, seen.triangle),
        window=_around(seen.window, part.window),
        inverse_depth_planes=np.vstack([seen.inverse_depth_planes, part.inverse_depth_planes]),
        moving=None,
    )
    return replace(view, seen=merged, part=np.where(nearer, number, view.part))


def _around(first: Window, second: Window) -> Window:
    """The smallest window that holds two."""
    rows, columns = (
        slice(min(a.start, b.start), max(a.stop, b.stop)) if a.stop > a.start else b
        for a, b in zip(first, second, strict=True)
    )
    return rows, columns
