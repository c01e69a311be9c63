"""Meshes of few sides made round, against the bodies that they draw."""

from pathlib import Path

import numpy as np
import pytest
import trimesh

from pcnav.target.round_mesh import rounded
from pcnav.target.roundness import Roundness
from pcnav.target.satellite import load_target

AXIS = Roundness(np.array([0.3, -0.2, 0.0]), np.array([[0.0, 0.0, 1.0]]))
RADIUS, HEIGHT = 1.2, 4.0


def stage(sides: int) -> trimesh.Trimesh:
    """A tank and a nozzle, off the origin."""
    tank = trimesh.creation.cylinder(RADIUS, HEIGHT, sections=sides)
    nozzle = trimesh.creation.cone(0.7, 1.2, sections=sides)
    nozzle.apply_translation((0.0, 0.0, 1.6))
    mesh = trimesh.util.concatenate([tank, nozzle])
    assert isinstance(mesh, trimesh.Trimesh)
    mesh.apply_translation(AXIS.point_model)
    return mesh


def test_the_volume_is_that_of_the_round_body() -> None:
    drawn, body = stage(16), np.pi * RADIUS**2 * HEIGHT + np.pi * 0.7**2 * 1.2 / 3.0
    round_mesh = rounded(drawn, AXIS)
    assert drawn.volume < 0.98 * body
    assert round_mesh.volume == pytest.approx(body, rel=1e-3)
    # Closed as before, its ends flat, and no larger than the drawing.
    assert round_mesh.is_watertight and round_mesh.is_winding_consistent
    assert np.allclose(round_mesh.bounds[:, 2], drawn.bounds[:, 2])
    assert len(round_mesh.faces) < 20 * len(drawn.faces)


def test_all_vertices_lie_on_the_surface() -> None:
    mesh = rounded(stage(16), AXIS)
    x, y, z = (mesh.vertices - AXIS.point_model).T
    radius = np.hypot(x, y)
    of_tank = np.isclose(radius, RADIUS) | np.isclose(radius, 0.0)
    of_nozzle = np.isclose(radius, 0.7 * (1.0 - (z - 1.6) / 1.2))
    assert np.all(of_tank | of_nozzle)


def test_a_cap_without_a_middle_stays_flat_and_whole() -> None:
    angles = np.arange(12) * np.pi / 6.0
    rim = np.column_stack([np.cos(angles), np.sin(angles), np.zeros(12)])
    fan = [[0, k, k + 1] for k in range(1, 11)]
    wall = [[k, (k + 1) % 12, k + 12] for k in range(12)]
    wall += [[(k + 1) % 12, (k + 1) % 12 + 12, k + 12] for k in range(12)]
    mesh = trimesh.Trimesh(np.vstack([rim, rim - [0, 0, 1]]), fan + wall, process=False)
    about_z = Roundness(np.zeros(3), np.array([[0.0, 0.0, 1.0]]))
    found = rounded(mesh, about_z)
    is_cap = np.abs(found.face_normals[:, 2]) > 0.99
    assert found.area_faces[is_cap].sum() == pytest.approx(np.pi, rel=3e-3)


def test_a_ball_and_a_mesh_that_is_fine_already() -> None:
    ball = Roundness(np.zeros(3), np.eye(3))
    mesh = rounded(trimesh.creation.icosphere(1), ball)
    assert np.linalg.norm(mesh.vertices, axis=1) == pytest.approx(1.0, abs=1e-9)
    assert mesh.volume == pytest.approx(4.0 / 3.0 * np.pi, rel=0.01) and mesh.is_watertight
    fine = stage(128)
    assert rounded(fine, AXIS) is fine


def test_a_target_that_is_loaded_is_round(tmp_path: Path) -> None:
    path = tmp_path / "stage.stl"
    stage(16).export(path)
    target = load_target(path)
    assert target.roundness is not None
    # The facets of the drawing are off by up to 23 mm.
    assert target.roundness.deviation_m < 0.003
