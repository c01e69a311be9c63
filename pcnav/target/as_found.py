"""A target whose parts are not where its mesh has them."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
import trimesh

from pcnav.core.arrays import BoolArray, FloatArray
from pcnav.core.spatial import transform_points
from pcnav.target.parts import Parts
from pcnav.target.satellite import Target


@dataclass(frozen=True)
class PartChanges:
    """What is known of parts, by their places in `Parts.each`, that are not as in the mesh."""

    moved: Mapping[int, FloatArray] = field(default_factory=dict)
    """(4, 4) motion of the model frame from where the mesh has a part to where it is."""
    missing: frozenset[int] = frozenset()
    strange: frozenset[int] = frozenset()
    """They differ in a way that is not known."""

    @property
    def parts(self) -> frozenset[int]:
        """All of them."""
        return frozenset(self.moved) | self.missing | self.strange


def as_found(target: Target, parts: Parts, changes: PartChanges) -> tuple[Target, BoolArray]:
    """The target as it is, and which of its triangles (n_faces,) are where they are known to be
    exactly enough to tell a pose by.

    Its catalogue keeps all faces in their order, those of a missing part, too; its symmetry stays
    that of the mesh.
    """
    triangles = np.array(target.mesh.triangles, dtype=np.float64)
    rectangles = list(target.rectangles)
    for k, T in changes.moved.items():
        own = parts.of_triangle == k
        triangles[own] = transform_points(T, triangles[own].reshape(-1, 3)).reshape(-1, 3, 3)
        for i in np.flatnonzero(parts.of_rectangle == k).tolist():
            rectangles[i] = replace(rectangles[i], T_model_rect=T @ rectangles[i].T_model_rect)
    kept = ~np.isin(parts.of_triangle, list(changes.missing))
    corners = triangles[kept].reshape(-1, 3)
    # Bodies that a file has joined share corners; equal corners are joined again.
    mesh = trimesh.Trimesh(corners, np.arange(len(corners)).reshape(-1, 3), process=True)
    measured = ~np.isin(parts.of_triangle[kept], list(changes.parts))
    return replace(target, mesh=mesh, rectangles=tuple(rectangles)), measured
