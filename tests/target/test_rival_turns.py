"""Turns of a target that a start has to rule out."""

import numpy as np
import trimesh

from pcnav.core.arrays import FloatArray
from pcnav.core.spatial import exp_rotation, rotation_angle
from pcnav.target.rival_turns import rival_turns
from pcnav.target.symmetry import half_turns


def rivals(mesh: trimesh.parent.Geometry) -> FloatArray:
    assert isinstance(mesh, trimesh.Trimesh)
    return rival_turns(mesh, half_turns(mesh))


def has(turns: FloatArray, vector: list[float]) -> bool:
    """Whether a turn (rotation vector, quarter turns) is among some, to a few degrees."""
    R = exp_rotation(0.5 * np.pi * np.array(vector))
    return bool(np.min(rotation_angle(turns[:, :3, :3] @ R.T)) < 0.1)


def test_a_square_bus_with_a_bracket_is_taken_for_itself_after_quarter_turns() -> None:
    body = trimesh.creation.box((1.0, 1.0, 2.5))
    bracket = trimesh.creation.box((0.1, 0.3, 0.2))
    bracket.apply_translation((0.55, 0.1, 0.9))
    found = rivals(trimesh.util.concatenate([body, bracket]))
    assert has(found, [0.0, 0.0, 1.0]) and has(found, [0.0, 0.0, -1.0])
    for axis in np.eye(3):
        assert has(found, list(2.0 * axis))
    assert not has(found, [1.0, 0.0, 0.0])


def test_a_stage_that_is_nearly_round_is_taken_for_itself_after_any_turn_about_its_axis() -> None:
    stage = trimesh.creation.cylinder(0.6, 3.0, sections=48)
    box = trimesh.creation.box((0.2, 0.2, 0.2))
    box.apply_translation((0.65, 0.0, 0.8))
    mesh = trimesh.util.concatenate([stage, box])
    found = rivals(mesh)
    about = [abs(np.sin(t / 2)) for t in rotation_angle(found[:, :3, :3])]
    assert len(found) > 6 and min(about) > 0.2
    assert has(found, [0.0, 0.0, 1.0])
    # The turns are about the body, not about the origin of the file.
    moved = mesh.copy()
    moved.apply_translation((10.0, 0.0, 0.0))
    for T in rivals(moved):
        np.testing.assert_allclose(T[:3, :3] @ [10, 0, 0] + T[:3, 3], [10, 0, 0], atol=0.2)


def test_quarter_turns_of_a_box_of_three_sizes_are_none() -> None:
    found = rivals(trimesh.creation.box((1.0, 2.0, 4.0)))
    for axis in np.eye(3):
        assert has(found, list(2.0 * axis)) and not has(found, list(axis))
