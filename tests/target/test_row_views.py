"""Views whose rows are read out one after the other: each is that of its own pose."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from pcnav.core.camera import PinholeCamera, pixel_rays
from pcnav.core.distortion import Distortion, DistortionModel
from pcnav.core.spatial import exp_rotation, make_transform
from pcnav.target.rendering import DepthRenderer
from pcnav.target.row_motion import Exposure, Readout, row_times

CAMERA = PinholeCamera.from_field_of_view(96, 64, np.deg2rad(25.0))
LENS = Distortion(DistortionModel.OPENCV, (-0.8, 0.5, 0.0, 0.01, 0.0))
T = make_transform(exp_rotation(np.array([0.5, -0.8, 0.3])), np.array([0.2, -0.1, 12.0]))
READOUT = Readout(np.array([2.0, -1.5, 4.0, 0.8, -1.0, 1.5]))
"""Fast: two pixels a row."""


@pytest.mark.parametrize(
    "camera", [CAMERA, replace(CAMERA, distortion=LENS)], ids=["plain", "lens"]
)
def test_every_row_is_that_of_the_view_at_its_time(camera: PinholeCamera) -> None:
    renderer = DepthRenderer(trimesh.creation.box((2.0, 1.0, 1.5)), camera)
    poses = READOUT.poses(T, row_times(0.2, camera.height))
    rolling = renderer.render(T, Exposure.by_rows(poses, camera.width))
    still = renderer.render(T)
    assert (rolling.triangle != still.triangle).sum() > 50
    for v in range(camera.height):
        expected = renderer.render(poses[v])
        np.testing.assert_array_equal(rolling.triangle[v], expected.triangle[v])
        np.testing.assert_allclose(rolling.depth_m[v], expected.depth_m[v], rtol=1e-6)
    # Planes, row by row.
    rows, columns = np.nonzero(rolling.triangle >= 0)
    m = rolling.planes_at(rolling.triangle[rows, columns], (rows, columns))
    inverse = np.einsum("ij,ij->i", m, pixel_rays(camera)[rows, columns])
    np.testing.assert_allclose(inverse, 1.0 / rolling.depth_m[rows, columns], rtol=1e-6)


def test_the_middle_row_has_the_time_of_the_frame() -> None:
    times_s = row_times(0.03, 65)
    assert times_s[32] == 0.0
    assert times_s[-1] - times_s[0] == pytest.approx(0.03)
    poses = READOUT.poses(T, row_times(0.2, 65))
    np.testing.assert_allclose(poses[32], T, atol=1e-12)
    shift = poses[-1][:3, 3] - poses[0][:3, 3]
    np.testing.assert_allclose(shift, 0.2 * READOUT.twist[:3], atol=1e-12)


def test_points_of_the_model_move_between_rows() -> None:
    renderer = DepthRenderer(trimesh.creation.box((2.0, 1.0, 1.5)), CAMERA)
    poses = READOUT.poses(T, row_times(0.2, 64))
    planes = renderer.render(T, Exposure.by_rows(poses, CAMERA.width)).moving
    assert planes is not None
    p_model = np.random.default_rng(0).normal(size=(5, 3))
    row = np.array([0.0, 10.25, 31.5, 63.0, 80.0])
    pixels = np.column_stack([np.zeros(5), row])
    times_s = np.interp(row, np.arange(64), row_times(0.2, 64))
    for k in range(5):
        R = T[:3, :3] @ exp_rotation(READOUT.twist[3:] * times_s[k])
        expected = R @ p_model[k] + T[:3, 3] + READOUT.twist[:3] * times_s[k]
        np.testing.assert_allclose(planes.moved(p_model, pixels)[k], expected, atol=1e-5)
