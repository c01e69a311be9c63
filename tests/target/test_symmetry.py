"""Symmetry groups against solids whose groups are known."""

import numpy as np
import pytest
import trimesh

from pcnav.core.spatial import exp_rotation, make_transform, rotation_fault, transform_points
from pcnav.target.facets import planar_faces
from pcnav.target.mesh import mesh_diameter
from pcnav.target.symmetry import group_name, symmetry_motions

POSE = make_transform(exp_rotation(np.array([0.3, -1.1, 0.7])), np.array([3.0, -2.0, 5.0]))


def motions_of(mesh):
    return symmetry_motions(mesh, planar_faces(mesh, (0.015 * mesh_diameter(mesh)) ** 2))


def solid(size, centre=(0.0, 0.0, 0.0)):
    return trimesh.creation.box(
        extents=size, transform=trimesh.transformations.translation_matrix(centre)
    )


def prism(sections):
    return trimesh.creation.cylinder(1.0, 1.3, sections=sections)


CASES = [
    (solid((1, 2, 3)), "D2", 4),
    (solid((1, 1, 3)), "D4 about z", 8),
    (solid((2, 1, 1)), "D4 about x", 8),
    (solid((1, 1, 1)), "O", 24),
    (prism(6), "D6 about z", 12),
    (prism(5), "D5 about z", 10),
    (trimesh.creation.icosahedron(), "I", 60),
    (trimesh.Trimesh([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]],
                     [[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]]), "T", 12),
    # A second box on one face leaves the half turn, one beside the middle leaves nothing.
    (trimesh.util.concatenate([solid((1, 2, 3)), solid((0.5, 0.5, 0.5), (0, 0, 1.75))]),
     "C2 about z", 2),
    (trimesh.util.concatenate([solid((1, 2, 3)), solid((0.5, 0.5, 0.5), (0, 0.4, 1.75))]),
     "C1", 1),
]  # fmt: skip


@pytest.mark.parametrize(("mesh", "name", "order"), CASES, ids=[case[1] for case in CASES])
def test_group_of_a_known_solid(mesh, name, order):
    motions = motions_of(mesh)
    assert group_name(motions) == name
    assert len(motions) == order
    assert np.array_equal(motions[0], np.eye(4))


@pytest.mark.parametrize("k", [0, 3, 8])
def test_group_moves_with_the_mesh(k):
    mesh, _, order = CASES[k]
    moved = mesh.copy()
    moved.apply_transform(POSE)
    at_origin, away = motions_of(mesh), motions_of(moved)
    assert len(away) == order
    conjugated = POSE @ at_origin @ np.linalg.inv(POSE)
    distance = np.abs(conjugated[:, None] - away[None]).max(axis=(2, 3))
    assert distance.min(axis=1).max() < 1e-5


@pytest.mark.parametrize("k", [0, 3, 5])
def test_group_axioms_and_vertices(k):
    mesh = CASES[k][0].copy()
    mesh.apply_transform(POSE)
    motions = motions_of(mesh)
    products = (motions[:, None] @ motions[None]).reshape(-1, 4, 4)
    distance = np.abs(products[:, None] - motions[None]).max(axis=(2, 3))
    assert distance.min(axis=1).max() < 1e-5
    for T in motions:
        # A proper rotation, never a reflection, that permutes the vertices.
        assert rotation_fault(T[:3, :3]) is None
        gap = np.linalg.norm(transform_points(T, mesh.vertices)[:, None] - mesh.vertices, axis=-1)
        assert gap.min(axis=1).max() < 1e-5


def test_reflection_alone_is_no_symmetry():
    # An L of three unlike arms is mirrored by no turn; as a flat L with two equal arms a
    # reflection swaps the arms and so does a half turn about the diagonal.
    equal = trimesh.util.concatenate(
        [solid((1, 1, 0.5)), solid((2, 1, 0.5), (1.5, 0, 0)), solid((1, 2, 0.5), (0, 1.5, 0))]
    )
    assert group_name(motions_of(equal)) == "C2 about (0.707, 0.707, 0.000)"
    stepped = trimesh.util.concatenate([equal, solid((0.5, 0.5, 0.5), (0, 0, 0.5))])
    # With a block on top only the reflection is left.
    assert group_name(motions_of(stepped)) == "C1"


def test_cut_of_the_triangles_does_not_matter():
    rng = np.random.default_rng(3)
    mesh = solid((1, 2, 3)).subdivide()
    # Loose triangles, unevenly cut.
    some = rng.random(len(mesh.faces)) < 0.3
    mesh = mesh.subdivide(face_index=np.flatnonzero(some))
    assert group_name(motions_of(mesh)) == "D2"


def test_hidden_parts_do_not_break_a_symmetry():
    mesh = trimesh.util.concatenate([solid((1, 2, 3)), solid((0.2, 0.3, 0.4), (0.1, 0.4, 0.7))])
    assert group_name(motions_of(mesh)) == "D2"


def test_small_thing_that_sticks_out_breaks_a_symmetry():
    # A pin of 3 % of the diameter, a thousandth of the area.
    pin = solid((0.06, 0.06, 0.12), (0.3, 0.5, 1.56))
    mesh = trimesh.util.concatenate([solid((1, 2, 3)).subdivide(), pin])
    assert group_name(motions_of(mesh)) == "C1"


def test_without_flat_faces_only_the_identity():
    ball = trimesh.creation.icosphere(3)
    assert np.array_equal(symmetry_motions(ball, ()), np.eye(4)[None])
