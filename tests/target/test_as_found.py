"""Targets with parts that are not where their mesh has them."""

import numpy as np

from pcnav.core.spatial import exp_rotation, make_transform, transform_points
from pcnav.target.as_found import PartChanges, as_found
from pcnav.target.parts import parts_of
from pcnav.target.satellite import Target

T = make_transform(exp_rotation(np.array([0.0, 0.3, 0.0])), np.array([0.1, 0.0, -0.2]))


def test_a_part_is_moved_with_its_faces_and_nothing_else(boxsat: Target) -> None:
    parts = parts_of(boxsat)
    k = next(i for i, part in enumerate(parts.each) if part.name == "panel_long")
    other, measured = as_found(boxsat, parts, PartChanges({k: T}))
    own = parts.of_triangle == k
    corners = transform_points(T, boxsat.mesh.triangles[own].reshape(-1, 3))
    assert np.allclose(other.mesh.triangles[own].reshape(-1, 3), corners)
    assert np.allclose(other.mesh.triangles[~own], boxsat.mesh.triangles[~own])
    assert np.array_equal(measured, ~own)
    for before, after in zip(boxsat.rectangles, other.rectangles, strict=True):
        moves = before.name.startswith("panel_long")
        expected = T @ before.T_model_rect if moves else before.T_model_rect
        assert np.allclose(after.T_model_rect, expected)


def test_a_part_that_is_missing_is_not_in_the_mesh(boxsat: Target) -> None:
    parts = parts_of(boxsat)
    other, measured = as_found(boxsat, parts, PartChanges(missing=frozenset({2})))
    left = boxsat.mesh.area_faces[parts.of_triangle != 2].sum()
    assert np.isclose(other.mesh.area, left) and measured.all()
    assert len(other.rectangles) == len(boxsat.rectangles)
