"""Symmetry groups against solids whose groups are known."""

import numpy as np
import pytest
import trimesh

from pcnav.core.spatial import exp_rotation, make_transform, rotation_fault, transform_points
from pcnav.target.mesh import mesh_diameter
from pcnav.target.symmetry import Resolution, find_symmetry, group_name

POSE = make_transform(exp_rotation(np.array([0.3, -1.1, 0.7])), np.array([3.0, -2.0, 5.0]))


def motions_of(mesh):
    found = find_symmetry(mesh)
    assert found.roundness is None
    return found.motions


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


def box_with_chamfers_that_only_nearly_agree():
    """A box whose faces have no congruent partners, though a half turn moves nothing by 2e-4."""
    mesh = solid((1, 2, 3)).subdivide().subdivide()
    rng = np.random.default_rng(0)
    mesh.vertices += 1e-4 * mesh_diameter(mesh) * rng.uniform(-1.0, 1.0, mesh.vertices.shape)
    return mesh


def box_with_a_lost_twin():
    """One of two ribs is there twice over as thin, so that its own faces have no twins."""
    ribs = [solid((0.3, 0.02, 2.0), (0, y, 0)) for y in (1.01, -1.01)]
    return trimesh.util.concatenate([solid((1, 2, 3)), ribs[0], ribs[1].subdivide()])


@pytest.mark.parametrize("make", [box_with_chamfers_that_only_nearly_agree, box_with_a_lost_twin])
def test_what_no_sensor_tells_apart_is_symmetric(make):
    assert group_name(motions_of(make())) == "D2"


def test_a_finer_sensor_tells_more_apart():
    bump = solid((0.3, 0.3, 0.02), (0, 0, 1.51))
    mesh = trimesh.util.concatenate([solid((1, 2, 3)), bump])
    assert isinstance(mesh, trimesh.Trimesh)
    coarse, fine = Resolution(0.02, 0.02), Resolution(0.002, 0.005)
    assert find_symmetry(mesh, coarse).name == "D2"
    assert find_symmetry(mesh, fine).name == "C2 about z"


@pytest.mark.parametrize(
    ("mesh", "name"),
    [
        (prism(16), "round about z, alike from both ends"),
        (trimesh.creation.cone(1.0, 2.0, sections=32), "round about z"),
        (trimesh.creation.icosphere(3), "ball: round about all axes"),
    ],
    ids=["stage of 16 sides", "cone", "ball"],
)
def test_facets_finer_than_the_noise_are_a_round_body(mesh, name):
    mesh = mesh.copy()
    mesh.apply_transform(POSE)
    roundness = find_symmetry(mesh).roundness
    assert roundness is not None
    at_origin = mesh.copy()
    at_origin.apply_transform(np.linalg.inv(POSE))
    assert find_symmetry(at_origin).name == name
    if len(roundness.axes_model) == 1:
        assert abs(roundness.axes_model[0] @ POSE[:3, 2]) > np.cos(1e-4)
        across = np.cross(roundness.point_model - POSE[:3, 3], POSE[:3, 2])
    else:
        across = roundness.point_model - POSE[:3, 3]
    assert np.linalg.norm(across) < 1e-3


def test_facets_coarser_than_the_noise_are_none():
    stage = prism(16)
    assert find_symmetry(stage, Resolution(1e-4, 0.005)).name == "D16 about z"


def test_a_mark_makes_a_round_body_none():
    mark = solid((0.2, 0.2, 0.2), (1.0, 0.0, 0.2))
    assert group_name(motions_of(trimesh.util.concatenate([prism(48), mark]))) == "C1"
