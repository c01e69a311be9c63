"""What pose errors of the calibration are taken for: against frames of a camera that has them."""

from dataclasses import replace

import numpy as np
import pytest

from pcnav.core.arrays import DepthImage, FloatArray
from pcnav.core.camera import PinholeCamera, range_per_depth
from pcnav.core.spatial import make_transform
from pcnav.estimators.depth.pose_fit import fit_pose
from pcnav.estimators.depth.pose_measurement import pose_error
from pcnav.perception.calibration_evidence import evidence_of_fields
from pcnav.perception.calibration_fields import by_fields
from pcnav.perception.render_compare import RenderComparer
from pcnav.perception.sensor_noise import SensorNoise
from pcnav.recordings.calibration import Calibration
from pcnav.target.rendering import DepthRenderer
from pcnav.target.satellite import Target

CAMERA = PinholeCamera.from_field_of_view(256, 256, np.deg2rad(12.0))
NOISE = SensorNoise(0.02)
WIDE = np.diag(np.repeat([0.2, 0.05], 3) ** 2)
UNITS = Calibration(
    focal_sd=0.001,
    centre_sd_px=1.0,
    range_offset_sd_m=0.03,
    range_scale_sd=0.002,
    mesh_scale_sd=0.001,
)
"""What the errors of these tests are counted in."""


def shown(target: Target, pose: FloatArray, units: FloatArray) -> DepthImage:
    """The frame of a camera and a target whose calibration is off by so many units (6,)."""
    focal, across, down, offset_m, scale, size = units * [
        UNITS.focal_sd,
        UNITS.centre_sd_px,
        UNITS.centre_sd_px,
        UNITS.range_offset_sd_m,
        UNITS.range_scale_sd,
        UNITS.mesh_scale_sd,
    ]
    f = (1.0 + focal) * CAMERA.fx
    camera = replace(CAMERA, fx=f, fy=f, cx=CAMERA.cx + across, cy=CAMERA.cy + down)
    mesh = target.mesh.copy()
    mesh.apply_scale(1.0 + size)
    depth = DepthRenderer(mesh, camera).render(pose).depth_m.astype(np.float64)
    # What is measured lies along the ray that the pixel really has.
    ratio = range_per_depth(camera)
    measured = np.where(depth > 0.0, (depth * ratio * (1.0 + scale) + offset_m) / ratio, 0.0)
    return measured.astype(np.float32)


@pytest.mark.parametrize("error", range(6))
def test_a_pose_is_off_by_what_the_evidence_of_a_field_says(boxsat: Target, error: int) -> None:
    turn = np.linalg.qr(np.random.default_rng(4).standard_normal((3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))
    pose = make_transform(turn, np.array([0.4, -0.5, 15.0]))
    comparer, unit = RenderComparer(boxsat, CAMERA, NOISE), np.eye(6)[error]
    found, expected = [], []
    for sign in (1.0, -1.0):
        fit = fit_pose(shown(boxsat, pose, sign * unit), pose, WIDE, comparer)
        assert fit is not None and fit.comparison is not None
        used = [face.name in fit.used for face in fit.comparison.faces]
        places = fit.comparison.places(used)
        found.append(pose_error(pose, fit.T_cam_model))
        fields = evidence_of_fields(fit.comparison.seen, places) * UNITS.of_image(CAMERA)
        expected.append(fit.covariance @ fields @ unit)
    # The pixel grid displaces both alike.
    off, told = 0.5 * (found[0] - found[1]), 0.5 * (expected[0] + expected[1])
    for part in (slice(0, 3), slice(3, 6)):
        floor = 2e-4 if part.start == 0 else 1e-4
        size = float(np.linalg.norm(told[part]))
        assert off[part] == pytest.approx(told[part], abs=0.15 * size + floor)


def test_points_seem_displaced_to_where_the_pixel_is_taken_to_look() -> None:
    rng = np.random.default_rng(1)
    p_cam = rng.uniform(-1.0, 1.0, (40, 3)) + np.array([0.0, 0.0, 8.0])
    small, pose = 1e-6, make_transform(np.eye(3), np.array([0.1, 0.2, 8.0]))
    true = replace(
        CAMERA,
        fx=CAMERA.fx * (1.0 + 2.0 * small),
        fy=CAMERA.fy * (1.0 + 2.0 * small),
        cx=CAMERA.cx + 3.0 * small,
        cy=CAMERA.cy - 5.0 * small,
    )
    u = true.fx * p_cam[:, 0] / p_cam[:, 2] + true.cx
    v = true.fy * p_cam[:, 1] / p_cam[:, 2] + true.cy
    # The stated camera puts a pixel's depth on the ray that it thinks is that pixel's.
    x = (u - CAMERA.cx) / CAMERA.fx * p_cam[:, 2]
    y = (v - CAMERA.cy) / CAMERA.fy * p_cam[:, 2]
    seems = np.column_stack([x, y, p_cam[:, 2]])
    errors = np.array([2.0, 3.0 / CAMERA.fx, -5.0 / CAMERA.fy, 0.0, 0.0, 0.0])
    for axis in np.eye(3, 6):
        moved = by_fields(np.tile(axis, (40, 1)), p_cam, pose) @ errors
        assert (seems - p_cam) @ axis[:3] / small == pytest.approx(moved, rel=1e-4, abs=1e-4)
