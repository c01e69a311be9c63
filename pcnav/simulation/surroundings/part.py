"""A body beside the target, and the shapes such bodies are made of."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import trimesh

from pcnav.core.arrays import FloatArray
from pcnav.core.spatial import make_transform
from pcnav.target.mesh import plane_axes


@dataclass(frozen=True)
class Part:
    """A rigid body of the scene that is not the target."""

    mesh: trimesh.Trimesh
    """Its surface, part frame, m."""
    T_cam_part: FloatArray
    """(n, 4, 4) pose in every frame; nan where it is not there."""
    return_fraction: float = 1.0
    """Share of its pixels that return."""


@dataclass(frozen=True)
class Stage:
    """Where and when parts are placed."""

    T_cam_hill: FloatArray
    """(n, 4, 4)"""
    T_cam_model: FloatArray
    """(n, 4, 4) true pose of the target."""
    time_s: FloatArray
    """(n,)"""
    mesh: trimesh.Trimesh
    """Of the target, model frame, m."""
    diameter_m: float
    """Of the target."""

    @property
    def middle_cam(self) -> FloatArray:
        """(3,) middle of the target's bounding box at time 0, camera frame, m."""
        return np.asarray(self._middles_cam[0])

    @property
    def _middles_cam(self) -> FloatArray:
        """(n, 3)"""
        middle = np.asarray(self.mesh.bounds).mean(axis=0)
        return np.asarray(self.T_cam_model[:, :3, :3] @ middle + self.T_cam_model[:, :3, 3])

    def at_rest(self) -> FloatArray:
        """(n, 4, 4) T_cam_part of a part given in the camera's axes at time 0, at rest in Hill."""
        first = self.T_cam_hill[0]
        return np.asarray(self.T_cam_hill @ np.linalg.inv(first))

    def with_target(self) -> FloatArray:
        """(n, 4, 4) T_cam_part of a part given in the camera's axes at time 0 that moves with the
        target."""
        return np.asarray(self.T_cam_model @ np.linalg.inv(self.T_cam_model[0]))

    def with_middle(self) -> FloatArray:
        """(n, 4, 4) the same of a part that keeps its attitude and its place before the target's
        middle."""
        middles = self._middles_cam
        return make_transform(np.eye(3), middles - middles[0])


def joined(shapes: Sequence[trimesh.Trimesh]) -> trimesh.Trimesh:
    """One mesh of several."""
    mesh = trimesh.util.concatenate(list(shapes))
    assert isinstance(mesh, trimesh.Trimesh)
    return mesh


def rod(start: FloatArray, end: FloatArray, radius_m: float) -> trimesh.Trimesh:
    """A cylinder with round ends between two points (3,)."""
    axis = end - start
    length = float(np.linalg.norm(axis))
    capsule = trimesh.creation.capsule(height=length, radius=radius_m, count=[16, 16])
    # Where along its axis the origin lies differs between releases of trimesh.
    capsule.apply_translation(-np.asarray(capsule.bounds).mean(axis=0))
    middle = 0.5 * (start + end)
    capsule.apply_transform(make_transform(plane_axes((axis / length)[None])[0], middle))
    return capsule


def ball(middle: FloatArray, radius_m: float) -> trimesh.Trimesh:
    """A sphere of triangles about a point (3,)."""
    made: trimesh.Trimesh = trimesh.creation.icosphere(3, radius_m)
    made.apply_translation(middle)
    return made


def box(extents: FloatArray, T: FloatArray) -> trimesh.Trimesh:
    """A box of extents (3,) about the origin of a frame, at a pose (4, 4)."""
    made: trimesh.Trimesh = trimesh.creation.box(extents, transform=T)
    return made


def sheet(
    width_m: float, height_m: float, roughness_m: float, rng: np.random.Generator
) -> trimesh.Trimesh:
    """A rectangle about the origin, z its normal; rough ones have a smooth random height."""
    if roughness_m == 0.0:
        half = 0.5 * np.array([width_m, height_m, 0.0])
        vertices = half * [[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]
        return trimesh.Trimesh(vertices, [[0, 1, 2], [0, 2, 3]], process=False)
    side = np.linspace(-0.5, 0.5, _CELLS + 1)
    x, y = (array.ravel() for array in np.meshgrid(width_m * side, height_m * side))
    vertices = np.stack([x, y, roughness_m * rng.standard_normal(x.size)], axis=1)
    corner = (np.arange(_CELLS)[:, None] * (_CELLS + 1) + np.arange(_CELLS)).ravel()
    square = np.stack([corner, corner + 1, corner + _CELLS + 2, corner + _CELLS + 1], axis=1)
    faces = np.vstack([square[:, [0, 1, 2]], square[:, [0, 2, 3]]])
    return trimesh.Trimesh(vertices, faces, process=False)


_CELLS = 64
"""Of a rough sheet along each side."""
