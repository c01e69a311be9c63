"""Recorded camera poses: of the stated noise, and the truth is left as it is."""

import numpy as np
import pytest

from pcnav.config.pipeline_file import Pipeline
from pcnav.config.sensors import CameraTable
from pcnav.core.spatial import invert_transform, log_rotation, make_transform
from pcnav.simulation.camera_pose import recorded_poses
from pcnav.simulation.depth import Scene
from pcnav.target.satellite import Target


def test_recorded_poses_are_off_by_the_stated_noise() -> None:
    rng = np.random.default_rng(0)
    true = make_transform(np.broadcast_to(np.eye(3), (2000, 3, 3)), rng.normal(size=(2000, 3)))
    table = CameraTable(position_sd_m=0.002, attitude_sd_deg=0.1)
    recorded = recorded_poses(true, table, 7)
    off = recorded @ invert_transform(true)
    turn = log_rotation(off[:, :3, :3])
    np.testing.assert_allclose(turn.std(axis=0), np.deg2rad(0.1), rtol=0.06)
    # Of the camera's centre, in its own axes.
    centre = invert_transform(off)[:, :3, 3]
    np.testing.assert_allclose(centre.std(axis=0), 0.002, rtol=0.06)
    assert np.abs(np.corrcoef(turn[1:, 0], turn[:-1, 0])[0, 1]) < 0.1
    np.testing.assert_array_equal(recorded_poses(true, CameraTable(), 7), true)
    again = recorded_poses(true, table, 7)
    np.testing.assert_array_equal(again, recorded)


def test_frames_and_truth_are_those_of_the_true_camera(boxsat: Target) -> None:
    plain = Pipeline.model_validate({"scenario": {"frames": 2}, "camera": {"width_px": 64}})
    noisy = plain.model_copy(
        update={"camera": plain.camera.model_copy(update={"attitude_sd_deg": 0.3})}
    )
    scenes = [Scene.showing(boxsat, pipeline) for pipeline in (plain, noisy)]
    for exact, seen in zip(*scenes, strict=True):
        np.testing.assert_array_equal(exact.depth_m, seen.depth_m)
        assert np.abs(exact.T_cam_world - seen.T_cam_world).max() > 1e-4
    np.testing.assert_array_equal(scenes[0].truth.poses, scenes[1].truth.poses)
    assert scenes[1].info.camera_attitude_sd_rad == pytest.approx(np.deg2rad(0.3))
    assert scenes[0].info.camera_attitude_sd_rad == 0.0
