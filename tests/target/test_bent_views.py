"""Views through a distorting lens: every ray that meets the mesh is cast."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from pcnav.core.arrays import BoolArray, FloatArray
from pcnav.core.camera import PinholeCamera, pixel_rays, pixels_without_ray
from pcnav.core.distortion import Distortion, DistortionModel
from pcnav.core.spatial import exp_rotation, invert_transform, make_transform
from pcnav.target.rendering import DepthRenderer

CAMERA = PinholeCamera.from_field_of_view(96, 64, np.deg2rad(80.0))
LENSES = {
    "barrel": Distortion(DistortionModel.OPENCV, (-0.2, 0.05, 0.0, 0.0, 0.0)),
    "cushion": Distortion(DistortionModel.OPENCV, (0.4, 0.1, 0.01, -0.02, 0.0)),
    "folds": Distortion(DistortionModel.OPENCV, (-0.55, 0.0, 0.0, 0.0, 0.0)),
    "fisheye": Distortion(DistortionModel.FISHEYE, (-0.05, 0.01, 0.0, 0.0)),
}


def hit(mesh: trimesh.Trimesh, camera: PinholeCamera, T_cam_model: FloatArray) -> BoolArray:
    """(height, width) pixels whose rays meet a mesh: all of them cast."""
    rays = pixel_rays(camera).reshape(-1, 3)
    directions = rays @ T_cam_model[:3, :3]
    origins = np.broadcast_to(invert_transform(T_cam_model)[:3, 3], directions.shape)
    found = mesh.ray.intersects_first(origins, directions) >= 0
    seen = np.asarray(found).reshape(camera.height, camera.width)
    blind = pixels_without_ray(camera)
    return seen if blind is None else seen & ~blind


@pytest.mark.parametrize("name", LENSES)
def test_no_pixel_of_a_mesh_is_lost(name: str) -> None:
    camera = replace(CAMERA, distortion=LENSES[name])
    mesh = trimesh.util.concatenate(
        [trimesh.creation.box((2.0, 1.0, 1.5)), trimesh.creation.box((7.0, 0.4, 0.02))]
    )
    assert isinstance(mesh, trimesh.Trimesh)
    renderer, rng, total = DepthRenderer(mesh, camera), np.random.default_rng(3), 0
    for k in range(25):
        # Near and far, and cut by every side of the image.
        distance = rng.uniform(2.0, 12.0)
        aside = rng.uniform(-0.9, 0.9, 2) * distance if k % 2 else np.zeros(2)
        R = exp_rotation(rng.normal(size=3) * 2.0)
        T = make_transform(R, np.array([*aside, distance]))
        rendered = renderer.render(T)
        expected = hit(mesh, camera, T)
        np.testing.assert_array_equal(rendered.triangle >= 0, expected, err_msg=str(k))
        total += int(expected.sum())
        # Pixels at the rim of the window are those of the image, or show nothing.
        rows, columns = rendered.window
        inside = rendered.triangle[rows, columns] >= 0
        if inside.any():
            assert rows.start == 0 or not inside[0].any()
            assert columns.stop == 96 or not inside[:, -1].any()
        assert expected.sum() == inside.sum()
    assert total > 5_000


def test_depth_through_a_lens_is_that_of_the_plane_along_the_ray() -> None:
    camera = replace(CAMERA, distortion=LENSES["barrel"])
    x, y = 2.0, 1.0
    corners = [[-x, -y, 0.0], [x, -y, 0.0], [x, y, 0.0], [-x, y, 0.0]]
    sheet = trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]], process=False)
    T = make_transform(exp_rotation(np.array([0.3, 0.7, 0.2])), np.array([0.5, 0.2, 4.0]))
    rendered = DepthRenderer(sheet, camera).render(T)
    normal, seen = T[:3, 2], rendered.triangle >= 0
    plane = (normal @ T[:3, 3]) / (pixel_rays(camera) @ normal)
    assert seen.sum() > 300
    np.testing.assert_allclose(rendered.depth_m[seen], plane[seen], rtol=1e-7)
