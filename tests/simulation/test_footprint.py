"""Pixels with an area, against shapes whose cover of a pixel is known."""

from typing import Any

import numpy as np
import pytest
import trimesh

from pcnav.config.sensors import NoiseTable
from pcnav.core.arrays import FloatArray
from pcnav.core.camera import PinholeCamera
from pcnav.core.spatial import exp_rotation, make_transform
from pcnav.simulation.footprint import FootprintSampler
from pcnav.simulation.surroundings.part import Part
from pcnav.simulation.surroundings.view import SceneRenderer, SceneView

CAMERA = PinholeCamera(64, 48, 100.0, 100.0, 31.5, 23.5)
FINE = 16


def plate(width: float, height: float, z: float, x: float = 0.0, y: float = 0.0) -> trimesh.Trimesh:
    made = trimesh.creation.box((width, height, 1e-3))
    made.apply_translation((x, y, z))
    assert isinstance(made, trimesh.Trimesh)
    return made


def view(
    mesh: trimesh.Trimesh, T: FloatArray | None = None, *parts: Part, **noise: Any
) -> SceneView:
    poses = (np.eye(4) if T is None else T)[None]
    renderer = SceneRenderer(mesh, poses, parts, CAMERA)
    table = NoiseTable.model_validate({"footprint_rays": FINE, **noise})
    return FootprintSampler(renderer, table).sampled(renderer.render(0), renderer.poses(0))


@pytest.mark.parametrize(("footprint", "least"), [("any", 0.0), ("quarter", 0.25), ("half", 0.5)])
def test_a_pixel_returns_from_the_share_of_it_that_is_covered(footprint: str, least: float) -> None:
    # At 5 m a pixel is 0.05 m wide. The right edge of the plate moves over a pixel.
    for share in np.arange(0.04, 1.0, 0.13):
        right = (40.0 - 0.5 + share - CAMERA.cx) * 0.05
        mesh = plate(2.0, 1.0, 5.0 + 0.5e-3, x=right - 1.0)
        seen = view(mesh, footprint=footprint).seen.depth_m[24]
        assert (seen[40] > 0.0) == (share >= least + 1e-9)
        assert seen[39] > 0.0 and seen[41] == 0.0
        np.testing.assert_allclose(seen[seen > 0.0], 5.0, atol=1e-5)


def test_a_bar_thinner_than_a_pixel_returns_where_no_centre_meets_it() -> None:
    # 0.4 px wide, right of the centres of a column.
    bar = plate(0.02, 2.0, 5.0, x=(32.25 - CAMERA.cx) * 0.05)
    assert not view(bar).seen.depth_m.any()
    for footprint, returns in (("any", True), ("quarter", True), ("half", False)):
        found = view(bar, footprint=footprint).seen.depth_m
        assert set(np.nonzero(found)[1]) == ({32} if returns else set())


@pytest.mark.parametrize("shape", ["box", "ball"])
def test_every_pixel_returns_by_its_own_cover(shape: str) -> None:
    """The edges of a box, and the outline of a ball without any edge, against rays everywhere."""
    T = make_transform(exp_rotation(np.array([0.3, 0.5, 0.2])), np.array([0.05, 0.02, 6.0]))
    ball = trimesh.creation.icosphere(4, 0.8)
    mesh = trimesh.creation.box((1.0, 0.8, 0.6)) if shape == "box" else ball
    cover, mean = everywhere(mesh, T)
    assert (np.count_nonzero((cover > 0.0) & (cover < 1.0))) > 50
    for footprint, least in (("any", 1e-9), ("quarter", 0.25), ("half", 0.5)):
        found = view(mesh, T, footprint=footprint).seen.depth_m
        np.testing.assert_array_equal(found > 0.0, cover >= least)
        both = found > 0.0
        # Where no edge is the centre stands for the mean; the ball's facets bend within a pixel.
        bend = 2e-3 if shape == "box" else 8e-3
        np.testing.assert_allclose(found[both], mean[both], atol=bend)


def everywhere(mesh: trimesh.Trimesh, T: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(height, width) covered share and mean depth of all pixels."""
    offset = (np.arange(FINE) + 0.5) / FINE - 0.5
    u = (np.arange(CAMERA.width)[:, None] + offset).ravel()
    v = (np.arange(CAMERA.height)[:, None] + offset).ravel()
    x, y = np.meshgrid((u - CAMERA.cx) / CAMERA.fx, (v - CAMERA.cy) / CAMERA.fy)
    rays = np.stack([x, y, np.ones_like(x)], axis=-1).reshape(-1, 3)
    origin = -T[:3, :3].T @ T[:3, 3]
    where, ray, _ = mesh.ray.intersects_location(
        np.broadcast_to(origin, rays.shape), rays @ T[:3, :3], multiple_hits=False
    )
    depth = np.zeros(len(rays))
    depth[ray] = where @ T[2, :3] + T[2, 3]
    cells = depth.reshape(CAMERA.height, FINE, CAMERA.width, FINE)
    count = (cells > 0.0).sum(axis=(1, 3))
    return count / FINE**2, cells.sum(axis=(1, 3)) / np.maximum(count, 1)


def test_before_a_wall_the_nearest_surface_that_covers_enough_returns_or_all_are_mixed() -> None:
    wall = Part(plate(20.0, 20.0, 8.0 + 0.5e-3), np.eye(4)[None])
    share = 0.375
    right = (40.0 - 0.5 + share - CAMERA.cx) * 0.05
    mesh = plate(2.0, 1.0, 5.0 + 0.5e-3, x=right - 1.0)
    quarter = view(mesh, None, wall, footprint="quarter")
    assert (quarter.seen.depth_m > 0.0).all()
    assert quarter.seen.depth_m[24, 40] == pytest.approx(5.0) and quarter.part[24, 40] == 0
    half = view(mesh, None, wall, footprint="half")
    assert half.seen.depth_m[24, 40] == pytest.approx(8.0) and half.part[24, 40] == 1
    mixed = view(mesh, None, wall, footprint="any", footprint_mixes=True)
    expected = share * 5.0 + (1.0 - share) * 8.0
    assert mixed.seen.depth_m[24, 40] == pytest.approx(expected, abs=0.02)
    # Alone, the target's pixel is what it would be without the wall.
    assert quarter.target.depth_m[24, 40] == pytest.approx(5.0)
    assert half.target.depth_m[24, 40] == 0.0
