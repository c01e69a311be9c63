"""Edges of boxes, sheets and seams, counted by hand."""

import numpy as np
import pytest
import trimesh

from pcnav.perception.mesh_edges import mesh_edges
from tests.perception.outlines import BOX, sheet


def test_edges_of_a_box_are_twelve_without_the_diagonals_of_its_faces() -> None:
    edges = mesh_edges(BOX)
    vertices = np.array(BOX.vertices)
    assert len(edges.ends) == len(np.unique(edges.ends, axis=0)) == 12
    along = vertices[edges.ends[:, 1]] - vertices[edges.ends[:, 0]]
    np.testing.assert_array_equal(np.count_nonzero(along, axis=1), 1)
    assert edges.wings.shape == (12, 2)
    faces = {frozenset(face) for face in BOX.faces.tolist()}
    for ends, wings in zip(edges.ends.tolist(), edges.wings.tolist(), strict=True):
        assert wings[0] != wings[1]
        assert {frozenset([*ends, wing]) for wing in wings} <= faces


@pytest.mark.parametrize(("fold", "expected"), [(0.0, 6), (0.3, 7)])
def test_edges_of_an_open_sheet_are_its_border_and_its_fold(fold: float, expected: int) -> None:
    corners = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [2, 0, fold], [2, 1, fold]])
    mesh = trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3], [1, 4, 5], [1, 5, 2]], process=False)
    ends = mesh_edges(mesh).ends.tolist()
    assert len(ends) == expected
    assert ([1, 2] in ends) is (fold > 0.0)
    assert len(mesh_edges(sheet(2.0, 1.0)).ends) == 4


def test_an_edge_of_three_faces_is_kept_with_all_its_wings() -> None:
    corners = [[0, 0, 0], [0, 1, 0], [-1, 0, 0], [1, 0, 0], [0, 0, 1]]
    mesh = trimesh.Trimesh(corners, [[0, 1, 2], [1, 0, 3], [0, 1, 4]], process=False)
    edges = mesh_edges(mesh)
    (seam,) = np.flatnonzero((edges.ends == [0, 1]).all(axis=1))
    assert set(edges.wings[seam].tolist()) == {2, 3, 4}
    assert len(edges.ends) == 7


def test_long_edges_of_a_fine_mesh_are_few_and_the_right_ones() -> None:
    body = trimesh.util.concatenate(
        [trimesh.creation.icosphere(subdivisions=5), trimesh.creation.box((0.1, 6.0, 1.0))]
    )
    assert isinstance(body, trimesh.Trimesh)
    edges = mesh_edges(body)
    long = edges.at_least(0.5)
    lengths = np.linalg.norm(np.diff(edges.vertices[edges.ends], axis=1)[:, 0], axis=1)
    assert np.array_equal(long, np.flatnonzero(lengths >= 0.5))
    assert 0 < len(long) < 30 < len(edges)
