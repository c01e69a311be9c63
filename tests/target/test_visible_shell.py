"""What is left of a large mesh looks the same from everywhere outside, and the rest is inside."""

import numpy as np
import pytest
import trimesh

from pcnav.core.errors import InputError
from pcnav.target.satellite import load_target
from pcnav.target.visible_shell import visible_shell
from tests.target.mesh_files.satellites import joined


def fine(mesh, n_faces):
    """The mesh cut into at least so many triangles."""
    while len(mesh.faces) < n_faces:
        mesh = mesh.subdivide()
    return mesh


@pytest.fixture(scope="module")
def full():
    """A bus with equipment in it and a part that reaches into it, under an open umbrella."""
    bus = fine(trimesh.creation.box(extents=(2.0, 2.0, 3.0)), 12_000)
    tank = fine(trimesh.creation.icosphere(subdivisions=3, radius=0.7), 10_000)
    mast = fine(trimesh.creation.box(extents=(0.2, 0.2, 3.0)), 3_000)
    mast.apply_translation([0.3, 0.2, 2.0])
    umbrella = fine(trimesh.creation.icosphere(subdivisions=3, radius=1.5), 5_000)
    umbrella = umbrella.slice_plane([0.0, 0.0, 0.6], [0.0, 0.0, 1.0])
    umbrella.apply_translation([0.0, 0.0, 2.0])
    return joined([bus, tank, mast, umbrella])


def first_hits(mesh, origins, directions):
    """(n,) distance to the surface along rays (n, 3), inf for none; a missed ray is inf."""
    points, ray, _ = mesh.ray.intersects_location(origins, directions, multiple_hits=False)
    distance = np.full(len(origins), np.inf)
    distance[ray] = np.linalg.norm(points - origins[ray], axis=1)
    return distance


def test_the_shell_looks_like_the_mesh(full):
    shell = visible_shell(full)
    # The tank, and what of the mast is inside the bus.
    assert len(full.faces) - len(shell.faces) > 10_000
    rng = np.random.default_rng(1)
    away = rng.normal(size=(40_000, 3))
    away *= 8.0 / np.linalg.norm(away, axis=1, keepdims=True)
    aim = full.vertices[rng.integers(len(full.vertices), size=len(away))]
    before, after = (first_hits(mesh, away, aim - away) for mesh in (full, shell))
    assert np.isfinite(before).sum() > 30_000
    np.testing.assert_allclose(after, before, atol=1e-4)


def test_the_inside_is_not_shown(full, tmp_path):
    closed = joined(list(full.split(only_watertight=True)))
    closed.export(tmp_path / "sat.stl")
    target = load_target(tmp_path / "sat.stl")
    assert target.mesh_origin.n_faces == len(closed.faces)
    assert len(target.mesh.faces) < len(closed.faces) - 10_000
    assert len(target.rectangles) >= 5


def test_small_meshes_are_left_as_they_are(repository):
    target = load_target(repository / "meshes" / "boxsat.obj")
    assert len(target.mesh.faces) == target.mesh_origin.n_faces == 468


def test_names_for_rectangles_that_are_not_there_are_refused(tmp_path):
    trimesh.creation.icosphere(subdivisions=2).export(tmp_path / "ball.stl")
    name = "[[rectangles.names]]\nname='a'\ncentroid_model_m=[0,0,0]\nnormal_model=[1,0,0]"
    (tmp_path / "ball.toml").write_text(name)
    with pytest.raises(InputError, match="has no rectangle"):
        load_target(tmp_path / "ball.stl")
