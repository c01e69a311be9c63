"""Rendered depth against closed forms of planes, boxes and spheres."""

import numpy as np
import pytest
import trimesh

from pcnav.core.camera import PinholeCamera, pixel_rays, project
from pcnav.core.spatial import exp_rotation, invert_transform, make_transform, transform_points
from pcnav.target.rendering import DepthRenderer, depth_beyond_edge

CAMERA = PinholeCamera.from_field_of_view(96, 64, np.deg2rad(25.0))
ROTATION = exp_rotation(np.array([0.5, -0.8, 0.3]))
FLOAT32_ROUNDING = 1e-6


def sheet(width: float, height: float, z: float = 0.0) -> trimesh.Trimesh:
    x, y = 0.5 * width, 0.5 * height
    corners = [[-x, -y, z], [x, -y, z], [x, y, z], [-x, y, z]]
    return trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]], process=False)


def join(*parts: trimesh.Trimesh) -> trimesh.Trimesh:
    """One mesh of several."""
    mesh = trimesh.util.concatenate(list(parts))
    assert isinstance(mesh, trimesh.Trimesh)
    return mesh


def slab_depth(extents: np.ndarray, T_cam_model: np.ndarray) -> np.ndarray:
    """z-depth of a box by the slab method: the last entry before the first exit."""
    T_model_cam = invert_transform(T_cam_model)
    origin, rays = T_model_cam[:3, 3], pixel_rays(CAMERA) @ T_model_cam[:3, :3].T
    a, b = (-0.5 * extents - origin) / rays, (0.5 * extents - origin) / rays
    entry, leave = np.minimum(a, b).max(axis=-1), np.maximum(a, b).min(axis=-1)
    return np.where(entry < leave, entry, 0.0)


@pytest.mark.parametrize("distance", [6.0, 25.0, 400.0])
def test_box_matches_slab_method(distance: float) -> None:
    extents = np.array([1.0, 0.6, 1.5]) * distance / 8.0
    T = make_transform(ROTATION, np.array([0.03, -0.02, 1.0]) * distance)
    expected = slab_depth(extents, T)
    rendered = DepthRenderer(trimesh.creation.box(extents), CAMERA).render(T)
    seen = rendered.depth_m > 0.0
    assert seen.sum() > 300
    np.testing.assert_array_equal(seen, expected > 0.0)
    np.testing.assert_allclose(rendered.depth_m, expected, rtol=1e-7)
    np.testing.assert_array_equal(rendered.triangle >= 0, seen)


def test_sheet_is_seen_from_both_sides_and_exact_at_grazing_angles() -> None:
    for angle in (0.3, 1.5, np.pi - 1.45):
        T = make_transform(exp_rotation(np.array([0.0, angle, 0.0])), np.array([0.0, 0.0, 10.0]))
        rendered = DepthRenderer(sheet(4.0, 2.0), CAMERA).render(T)
        normal = T[:3, 2]
        with np.errstate(divide="ignore"):
            plane = (normal @ T[:3, 3]) / (pixel_rays(CAMERA) @ normal)
        seen = rendered.triangle >= 0
        assert seen.sum() > 50
        np.testing.assert_allclose(rendered.depth_m[seen], plane[seen], rtol=1e-7)


def test_fine_sphere_is_a_sphere() -> None:
    radius, centre = 1.5, np.array([0.2, -0.1, 12.0])
    mesh = trimesh.creation.icosphere(subdivisions=4, radius=radius)
    rendered = DepthRenderer(mesh, CAMERA).render(make_transform(ROTATION, centre))
    rays = pixel_rays(CAMERA)
    a, b = np.sum(rays**2, axis=-1), rays @ centre
    discriminant = b**2 - a * (centre @ centre - radius**2)
    # Away from the limb, where the facets' sag (1e-3 of the radius) is not magnified.
    inside = discriminant > 0.1 * discriminant.max()
    expected = (b - np.sqrt(np.where(inside, discriminant, 0.0))) / a
    assert inside.sum() > 500
    np.testing.assert_allclose(rendered.depth_m[inside], expected[inside], atol=8e-3)
    assert not (rendered.triangle[discriminant < 0.0] >= 0).any()


def test_handedness_and_pixel_centres() -> None:
    # A small sheet up and to the right in camera axes covers the pixels about its projection only.
    T = make_transform(np.eye(3), np.array([1.0, -0.5, 10.0]))
    rendered = DepthRenderer(sheet(0.4, 0.2), CAMERA).render(T)
    rows, columns = np.nonzero(rendered.depth_m)
    corners = project(CAMERA, np.array([[0.8, -0.6, 10.0], [1.2, -0.4, 10.0]]))
    assert columns.min() == np.ceil(corners[0, 0])
    assert columns.max() == np.floor(corners[1, 0])
    assert rows.min() == np.ceil(corners[0, 1])
    assert rows.max() == np.floor(corners[1, 1])


def test_nearer_part_hides_the_farther() -> None:
    mesh = join(sheet(2.0, 2.0), sheet(0.5, 0.5, z=-1.0))
    rendered = DepthRenderer(mesh, CAMERA).render(
        make_transform(np.eye(3), np.array([0.0, 0.0, 8.0]))
    )
    centre = rendered.depth_m[32, 48], rendered.triangle[32, 48]
    assert centre[0] == pytest.approx(7.0, abs=FLOAT32_ROUNDING)
    assert centre[1] in (2, 3)
    assert set(np.unique(rendered.depth_m).tolist()) == {0.0, 7.0, 8.0}


def test_behind_outside_and_around_the_camera() -> None:
    renderer = DepthRenderer(trimesh.creation.box((1.0, 1.0, 1.0)), CAMERA)
    behind = renderer.render(make_transform(np.eye(3), np.array([0.0, 0.0, -5.0])))
    outside = renderer.render(make_transform(np.eye(3), np.array([50.0, 0.0, 5.0])))
    assert not behind.depth_m.any()
    assert not outside.depth_m.any()
    inside = renderer.render(make_transform(np.eye(3), np.zeros(3)))
    np.testing.assert_allclose(inside.depth_m, 0.5, rtol=1e-7)


def test_renderer_can_be_used_again() -> None:
    renderer = DepthRenderer(trimesh.creation.box((1.0, 2.0, 3.0)), CAMERA)
    first = make_transform(ROTATION, np.array([0.0, 0.0, 15.0]))
    before = renderer.render(first).depth_m
    renderer.render(make_transform(np.eye(3), np.array([1.0, 0.0, 9.0])))
    np.testing.assert_array_equal(renderer.render(first).depth_m, before)


def test_occlusion_edges_are_found_and_creases_are_not() -> None:
    box = DepthRenderer(trimesh.creation.box((2.0, 1.6, 1.8)), CAMERA)
    creases = box.render(make_transform(ROTATION, np.array([0.0, 0.0, 10.0])))
    assert len(np.unique(creases.triangle)) >= 6
    assert not depth_beyond_edge(creases).any()

    gap = join(sheet(2.0, 2.0), sheet(0.5, 0.5, z=-1.0))
    rendered = DepthRenderer(gap, CAMERA).render(
        make_transform(np.eye(3), np.array([0.0, 0.0, 8.0]))
    )
    near = rendered.depth_m == 7.0
    far = rendered.depth_m == 8.0
    beyond = depth_beyond_edge(rendered)
    rim = {True: 8.0, False: 7.0}
    for is_near, mask, others in ((True, near, far), (False, far, near)):
        beside = np.zeros_like(others)
        beside[1:] |= others[:-1]
        beside[:-1] |= others[1:]
        beside[:, 1:] |= others[:, :-1]
        beside[:, :-1] |= others[:, 1:]
        expected = np.where(mask & beside, rim[is_near], 0.0)
        np.testing.assert_array_equal(np.where(mask, beyond, 0.0), expected)
    assert not beyond[~(near | far)].any()


FRAMED = np.array([[-9.0, -9.0], [9.0, -9.0], [9.0, 9.0], [-9.0, 9.0]])
"""Directions far outside the image."""


def with_all_rays(mesh: trimesh.Trimesh, T: np.ndarray) -> trimesh.Trimesh:
    """The mesh with specks far outside the image, so that its outline takes in every pixel."""
    z = float(transform_points(T, mesh.vertices)[:, 2].mean())
    specks = []
    for x, y in FRAMED * z:
        corners = np.array([[x, y, z], [x + 1e-3, y, z], [x, y + 1e-3, z]])
        in_model = transform_points(invert_transform(T), corners)
        specks.append(trimesh.Trimesh(in_model, [[0, 1, 2]], process=False))
    return join(mesh, *specks)


BODIES = {
    "box": trimesh.creation.box((1.0, 0.6, 1.5)),
    "sheet": sheet(1.2, 0.7),
    "two": join(sheet(0.2, 0.9), trimesh.creation.box((0.1, 0.1, 0.1))),
    "ball": trimesh.creation.icosphere(subdivisions=2, radius=0.6),
}


@pytest.mark.parametrize("name", BODIES)
def test_no_ray_that_meets_the_mesh_is_left_out(name: str) -> None:
    mesh, rng = BODIES[name], np.random.default_rng(0)
    poses = [
        make_transform(exp_rotation(rng.normal(size=3)), np.array([*offset, distance]))
        for distance in (4.0, 12.0, 150.0, 2000.0)
        for offset in rng.uniform(-0.25, 0.25, (5, 2)) * distance
    ]
    renderer, hits = DepthRenderer(mesh, CAMERA), []
    for T in poses:
        expected = DepthRenderer(with_all_rays(mesh, T), CAMERA).render(T)
        rendered = renderer.render(T)
        np.testing.assert_array_equal(rendered.triangle, expected.triangle)
        np.testing.assert_array_equal(rendered.depth_m, expected.depth_m)
        hits.append(np.count_nonzero(rendered.depth_m))
        edge = np.ones(rendered.depth_m.shape, dtype=np.bool_)
        edge[rendered.window] = False
        assert not rendered.depth_m[edge].any()
    # Large, small, cut by the border, and out of the image.
    assert max(hits) > 300
    assert any(0 < n < 100 for n in hits)
    assert min(hits) == 0


@pytest.mark.parametrize("turn", [0.5 * np.pi, 0.5 * np.pi - 1e-9, 0.5 * np.pi - 1e-3, 1.5])
@pytest.mark.parametrize("roll", [0.0, 0.3, 0.25 * np.pi])
def test_no_ray_is_left_out_of_a_sheet_that_is_seen_edge_on(turn: float, roll: float) -> None:
    mesh = sheet(3.0, 2.0)
    R = exp_rotation(np.array([0.0, 0.0, roll])) @ exp_rotation(np.array([0.0, turn, 0.0]))
    for x in (0.0, 0.4, 1.7):
        T = make_transform(R, np.array([x, 0.1, 8.0]))
        expected = DepthRenderer(with_all_rays(mesh, T), CAMERA).render(T)
        rendered = DepthRenderer(mesh, CAMERA).render(T)
        # Rays within the plane itself meet it or not by chance; none is left out.
        both = (rendered.triangle >= 0) & (expected.triangle >= 0)
        np.testing.assert_array_equal(both, expected.triangle >= 0)
        np.testing.assert_array_equal(rendered.triangle[both], expected.triangle[both])
        np.testing.assert_array_equal(rendered.depth_m[both], expected.depth_m[both])


def test_a_mesh_that_passes_the_camera_is_seen_all_over_the_image() -> None:
    # A tube about the optical axis that begins behind the camera, and its bottom at 6 m.
    extents = np.array([2.0, 2.0, 12.0])
    rendered = DepthRenderer(trimesh.creation.box(extents), CAMERA).render(
        make_transform(np.eye(3), np.zeros(3))
    )
    rays = np.abs(pixel_rays(CAMERA))
    np.testing.assert_allclose(
        rendered.depth_m, 1.0 / np.maximum(1.0 / 6.0, rays[..., :2].max(axis=-1)), rtol=1e-6
    )
