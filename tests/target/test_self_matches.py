"""Nearly symmetric solids whose differences are known."""

import numpy as np
import pytest
import trimesh

from pcnav.core.spatial import exp_rotation, make_transform, rotation_angle
from pcnav.target.mesh import mesh_diameter
from pcnav.target.self_matches import SelfMatcher, near_symmetries

POSE = make_transform(exp_rotation(np.array([0.3, -1.1, 0.7])), np.array([3.0, -2.0, 5.0]))


def box(size, centre=(0.0, 0.0, 0.0)):
    shift = trimesh.transformations.translation_matrix(centre)
    return trimesh.creation.box(extents=size, transform=shift)


def two_wings_and_a_bracket():
    """Half turns about x, y and z leave all but the bracket, which hides 0.08 of the body."""
    body, bracket = box((1.0, 1.0, 2.0)), box((0.2, 0.4, 0.2), (0.6, 0.0, 0.5))
    wings = [box((1.0, 3.0, 0.04), (0.0, y, 0.0)) for y in (2.0, -2.0)]
    return trimesh.util.concatenate([body, *wings, bracket])


@pytest.fixture(scope="module")
def found():
    mesh = two_wings_and_a_bracket()
    mesh.apply_transform(POSE)
    return near_symmetries(SelfMatcher(mesh, 0.005 * mesh_diameter(mesh)))


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_the_half_turns_that_only_a_bracket_breaks(found, axis):
    expected = make_transform(exp_rotation(np.pi * np.eye(3)[axis]), np.zeros(3))
    expected = POSE @ expected @ np.linalg.inv(POSE)
    R = np.stack([match.T_model[:3, :3] for match in found[:3]])
    angles = rotation_angle(expected[:3, :3].T @ R)
    assert angles.min() < np.radians(0.1)
    match = found[int(angles.argmin())]
    # It leaves the middle of the body where it is.
    middle = POSE[:3, 3]
    assert np.linalg.norm(match.T_model[:3, :3] @ middle + match.T_model[:3, 3] - middle) < 0.01
    body, wings = 2 * 1.0 + 4 * 2.0 - 2 * 0.04 - 0.08, 2 * (2 * 3.0 + 2 * 0.12 + 0.04)
    bracket = 2 * 0.04 + 3 * 0.08
    assert match.differing_share == pytest.approx(bracket / (body + wings + bracket), rel=0.3)


def test_motions_come_with_the_share_that_differs_in_rising_order(found):
    shares = [match.differing_share for match in found]
    assert shares == sorted(shares)
    assert min(shares) > 0.0 and max(shares) <= 0.4
    angles = rotation_angle(np.stack([match.T_model[:3, :3] for match in found]))
    assert np.all(angles > np.radians(10.0))


def test_a_lump_without_likeness_has_none():
    rng = np.random.default_rng(0)
    lump = trimesh.creation.icosphere(2)
    directions = rng.normal(size=(4, 3))
    size = 1.0 + 0.6 * np.tanh(lump.vertices @ directions.T).clip(0.0) @ np.array(
        [1, 0.8, 0.5, 1.2]
    )
    lump.vertices = lump.vertices * size[:, None]
    assert near_symmetries(SelfMatcher(lump, 0.005 * mesh_diameter(lump)), 0.2) == ()


def test_returns_of_a_ball_with_boxes_on_it_tell_how_it_is_turned() -> None:
    """Seen from one side, and turned about the ball, not about the middle of the surface."""
    ball = trimesh.creation.icosphere(2, 0.5)
    boxes = [box((0.25, 0.2, 0.15), (0.5, 0.0, 0.1)), box((0.1, 0.3, 0.2), (-0.1, 0.35, 0.35))]
    mesh = trimesh.util.concatenate([ball, *boxes])
    assert isinstance(mesh, trimesh.Trimesh)
    points, _ = trimesh.sample.sample_surface(mesh, 3000, seed=1)
    seen = points[points @ [0.6, 0.5, 0.6] > 0.1]
    R = exp_rotation(np.array([1.9, -0.7, 1.1]))
    matcher = SelfMatcher(mesh, 0.005)
    found = matcher.turned(seen @ R.T, 8)
    assert len(found) == 8
    off = np.degrees([rotation_angle(motion[:3, :3] @ R) for motion in found])
    assert off.min() < 10.0
    assert np.argmin(off) < 2, "it is among the likeliest"
