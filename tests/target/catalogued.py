"""The rectangles of a mesh, as `load_target` finds them."""

import trimesh

from pcnav.target.catalogue import (
    MINIMUM_SIDE_FRACTION,
    RECTANGLE_TOLERANCE,
    Rectangle,
    rectangles_among,
)
from pcnav.target.facets import planar_faces
from pcnav.target.mesh import mesh_diameter


def find_rectangles(
    mesh: trimesh.Trimesh, minimum_side_fraction: float = MINIMUM_SIDE_FRACTION
) -> tuple[Rectangle, ...]:
    minimum_side = minimum_side_fraction * mesh_diameter(mesh)
    faces = planar_faces(mesh, 0.8 * minimum_side**2)
    return rectangles_among(faces, minimum_side, RECTANGLE_TOLERANCE, "rectangle")
