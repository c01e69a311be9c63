"""Poses that sampled views propose, against those that frames were rendered at."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import trimesh

from pcnav.core.arrays import FloatArray
from pcnav.core.camera import PinholeCamera
from pcnav.core.spatial import invert_transform, rotation_angle, transform_points
from pcnav.perception.regions import candidate_regions
from pcnav.perception.sampled_views import SampledViews, sample_views
from pcnav.perception.view_matching import PartLayout
from pcnav.recordings.sequence import Frame
from pcnav.target.rendering import RenderedDepth
from pcnav.target.satellite import Target

Shoot = Callable[..., tuple[Frame, RenderedDepth]]
SIGMA = 0.01


def bent_pipe() -> trimesh.Trimesh:
    """A tank with a nozzle and a boom: round all over, without any symmetry."""
    tank = trimesh.creation.capsule(height=2.0, radius=0.9, count=[24, 24])
    nozzle = trimesh.creation.cone(radius=0.7, height=1.1, sections=32)
    nozzle.apply_translation([0.2, 0.0, -1.4])
    boom = trimesh.creation.cylinder(radius=0.2, height=2.4, sections=24)
    boom.apply_transform(trimesh.transformations.rotation_matrix(1.2, [1.0, 0.4, 0.0]))
    boom.apply_translation([0.3, 1.4, 1.0])
    joined = trimesh.util.concatenate([tank, nozzle, boom])
    assert isinstance(joined, trimesh.Trimesh)
    return joined


@pytest.fixture(scope="module")
def round_body(boxsat: Target) -> Target:
    return replace(boxsat, mesh=bent_pipe(), rectangles=(), symmetry_transforms=np.eye(4)[None])


def matched(frame: Frame, target: Target, views: SampledViews) -> list[FloatArray]:
    search = candidate_regions(frame, target, SIGMA)
    layout = PartLayout(search.regions[0], frame, views)
    layout.match()
    return [match.T_cam_model for match in layout.matches(target)]


def test_a_body_without_flat_faces_is_found_in_any_attitude(
    round_body: Target, shoot: Shoot, random_pose: Callable[..., FloatArray]
) -> None:
    views = sample_views(round_body.mesh)
    rng = np.random.default_rng(3)
    best = 0
    for seed in range(10):
        T = random_pose(rng, 12.0, 20.0)
        frame, _ = shoot(round_body.mesh, T, SIGMA, seed)
        found = matched(frame, round_body, views)
        right = [round_body.shows_alike(T, pose, 0.06, 0.02) for pose in found]
        assert any(right)
        best += right[0]
    assert best >= 8


def test_equal_poses_of_a_symmetric_target_are_one(
    twinwing: Target, shoot: Shoot, random_pose: Callable[..., FloatArray]
) -> None:
    views = sample_views(twinwing.mesh)
    T = random_pose(np.random.default_rng(4))
    frame, _ = shoot(twinwing.mesh, T, SIGMA)
    found = matched(frame, twinwing, views)
    right = [k for k, pose in enumerate(found) if twinwing.shows_alike(T, pose, 0.06, 0.02)]
    assert right == [0]


def test_sampled_surface_lies_on_the_mesh_and_faces_outward(round_body: Target) -> None:
    surface = sample_views(round_body.mesh).surface
    some, triangles = surface.points[::100], np.asarray(round_body.mesh.triangles)
    for point in some:
        on_faces = trimesh.triangles.closest_point(triangles, np.tile(point, (len(triangles), 1)))
        assert float(np.linalg.norm(on_faces - point, axis=1).min()) < 1e-6
    middle = round_body.mesh.bounds.mean(axis=0)
    # Of a tank, most of what is seen from outside looks away from the middle.
    outward = np.einsum("ij,ij->i", surface.points - middle, surface.normals)
    assert float(np.mean(outward > 0.0)) > 0.9


def test_a_target_cut_by_the_border_of_the_image_is_proposed(
    round_body: Target, camera: PinholeCamera, shoot: Shoot
) -> None:
    views = sample_views(round_body.mesh)
    T = np.eye(4)
    T[:3, :3] = trimesh.transformations.rotation_matrix(1.1, [0.3, 1.0, 0.2])[:3, :3]
    T[:3, 3] = [2.3, 0.0, 11.0]
    frame, clean = shoot(round_body.mesh, T, SIGMA)
    assert np.any(clean.depth_m[:, -1] > 0.0)
    search = candidate_regions(frame, round_body, SIGMA)
    layout = PartLayout(search.regions[0], frame, views)
    layout.match()
    found = [match.T_cam_model for match in layout.matches(round_body)]
    apart = [transform_points(invert_transform(pose) @ T, np.zeros((1, 3))) for pose in found]
    turn = [float(rotation_angle(pose[:3, :3].T @ T[:3, :3])) for pose in found]
    near = [np.linalg.norm(a) < 0.3 and t < 0.15 for a, t in zip(apart, turn, strict=True)]
    assert any(near)
