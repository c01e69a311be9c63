"""Targets that are larger than their mesh, followed."""

import numpy as np
import pytest

from pcnav.config.depth import FilterTable, PerceptionTable
from pcnav.core.camera import PinholeCamera
from pcnav.core.spatial import exp_rotation, make_transform
from pcnav.estimators.depth.pose_measurement import moved_pose, pose_error
from pcnav.estimators.depth.tracker import Tracker
from pcnav.recordings.calibration import EXACT
from pcnav.recordings.sequence import Frame, SequenceInfo
from pcnav.target.rendering import DepthRenderer
from pcnav.target.satellite import Target

SIGMA_M, STEP_S, FRAMES = 0.02, 0.5, 18
CAMERA = PinholeCamera.from_field_of_view(160, 160, np.deg2rad(25.0))
FIRST = make_transform(exp_rotation(np.array([0.4, 0.7, -0.5])), np.array([0.1, -0.1, 20.0]))
RATES = np.array([0.02, 0.0, 0.02, 0.0, 0.0, np.deg2rad(8.0)])
POSES = [moved_pose(FIRST, STEP_S * k * RATES) for k in range(FRAMES)]


def followed(target: Target, factor: float, sd: float) -> tuple[float, float]:
    """The size that a tracker found, and its largest error, m, in the last frames."""
    renderer = DepthRenderer(target.scaled(factor).mesh, CAMERA)
    rng, errors = np.random.default_rng(8), []
    info = SequenceInfo("boxsat", 0.0, SIGMA_M, None, calibration=EXACT)
    tracker = Tracker(target, info, PerceptionTable(mesh_scale_sd=sd), FilterTable(), 0)
    for k, T_cam_model in enumerate(POSES):
        depth_m = renderer.render(T_cam_model).depth_m
        noisy = depth_m + SIGMA_M * rng.standard_normal(depth_m.shape)
        depth_m = np.where(depth_m > 0.0, noisy, 0.0).astype(np.float32)
        estimate = tracker.step(Frame(k, STEP_S * k, depth_m, CAMERA, np.eye(4)))
        assert estimate.T_cam_target is not None or k < 3
        if estimate.T_cam_target is not None:
            error = pose_error(T_cam_model, estimate.T_cam_target)
            errors.append(float(np.linalg.norm(error[:3])))
    return tracker.mesh_scale, max(errors[-4:])


def test_a_target_is_followed_at_the_size_it_has(boxsat: Target) -> None:
    size, error_m = followed(boxsat, 1.015, 0.01)
    assert size == pytest.approx(1.015, abs=1e-3)
    assert error_m < 4e-3


@pytest.mark.study
def test_a_mesh_taken_for_right_bends_the_pose(boxsat: Target) -> None:
    size, error_m = followed(boxsat, 1.015, 0.0)
    assert size == 1.0 and error_m > 1e-2


def test_a_mesh_that_is_right_is_left_as_it_is(boxsat: Target) -> None:
    size, error_m = followed(boxsat, 1.0, 0.01)
    assert size == 1.0 and error_m < 3e-3
