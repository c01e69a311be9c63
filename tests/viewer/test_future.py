"""The ghost of a forecast stands where the target comes to be."""

from pathlib import Path

import numpy as np

from pcnav.core.spatial import rotation_angle
from pcnav.runs.reader import read_run
from pcnav.runs.result_files import COVARIANCES_FILE, POSES_FILE, STATES_FILE, SUMMARY_FILE
from pcnav.viewer.future import future_poses
from pcnav.viewer.loaded_run import LoadedRun
from pcnav.viewer.render_options import RenderOptions
from pcnav.viewer.server import LOOPBACK, LocalServer
from pcnav.viewer.target_layer import TargetLayer
from tests.viewer.conftest import FRAMES


def test_the_future_of_a_run_is_seen_by_its_camera(loaded: LoadedRun) -> None:
    assert loaded.future is not None
    # Of this recording the target turns before a camera at rest in the turning orbit frame.
    times, truth = loaded.run.time_s, loaded.errors
    assert truth is not None
    omega = loaded.trajectory.values["omega_body"][-1]
    for ahead in (5.0, 10.0):
        pose = loaded.future[ahead]
        turned = rotation_angle(loaded.T_cam_model[-1, :3, :3].T @ pose.T_cam_model[:3, :3])
        np.testing.assert_allclose(turned, ahead * np.linalg.norm(omega), rtol=0.2)
        moved = np.linalg.norm(pose.T_cam_model[:3, 3] - loaded.T_cam_model[-1, :3, 3])
        assert moved < 0.5 + 3.0 * pose.reach * np.sqrt(np.trace(pose.covariance_cam))
    assert len(times) == FRAMES
    spread = [np.trace(loaded.future[ahead].covariance_cam) for ahead in (5.0, 30.0, 120.0)]
    assert spread[0] < spread[1] < spread[2]


def test_the_ghost_is_drawn_where_it_is_asked_for(loaded: LoadedRun) -> None:
    server = LocalServer(LOOPBACK, 0, "future")
    try:
        layer = TargetLayer(server.scene, "/run_1", loaded, (255, 0, 0), is_first=True)
        for ahead in (None, 10.0):
            layer.show(FRAMES - 1, RenderOptions(forecast_s=ahead))
            assert layer._future.visible is (ahead is not None)
        assert loaded.future is not None
        place = loaded.future[10.0].T_cam_model[:3, 3]
        np.testing.assert_allclose(layer._future.position, place)
    finally:
        server.stop()


def test_a_run_that_cannot_tell_has_no_future(tmp_path: Path, run_folder: Path) -> None:
    assert future_poses(tmp_path, np.eye(4)) is None
    for name in (STATES_FILE, POSES_FILE, COVARIANCES_FILE, SUMMARY_FILE):
        assert (run_folder / name).is_file(), "what a future is told from"
    assert read_run(run_folder).has_estimate[-1]
