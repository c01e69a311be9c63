"""What a browser is drawn: layers that stay off, pages that leave early."""

import threading
import time
from contextlib import nullcontext
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from pcnav.core.spatial import exp_rotation, xyzw_from_rotation
from pcnav.dynamics.blocks import ATTITUDE, POSITION
from pcnav.dynamics.kepler import KeplerOrbit
from pcnav.viewer import app
from pcnav.viewer.camera import Viewfinder
from pcnav.viewer.controls import _notes_html
from pcnav.viewer.layers import RunLayers, lie_apart
from pcnav.viewer.loaded_run import LoadedRun, Snapshot, finished
from pcnav.viewer.palette import RUNS
from pcnav.viewer.render_options import DEFAULT_LAYERS, Layer, RenderOptions
from pcnav.viewer.server import LOOPBACK, LocalServer
from pcnav.viewer.target_layer import TargetLayer
from tests.viewer.conftest import FRAMES


def test_a_trail_that_is_off_stays_off(loaded: LoadedRun) -> None:
    server = LocalServer(LOOPBACK, 0, "trail")
    try:
        layer = TargetLayer(server.scene, "/run_1", loaded, (255, 0, 0), is_first=True)
        for layers, shown in ((DEFAULT_LAYERS - {Layer.TRAIL}, False), (DEFAULT_LAYERS, True)):
            layer.show(FRAMES - 1, RenderOptions(layers=layers))
            layer.refresh_trail()
            assert layer._trail.visible is shown
    finally:
        server.stop()


def test_names_that_would_lie_over_others_are_left_out() -> None:
    pixels = np.array([[0.0, 0.0], [20.0, 5.0], [20.0, 30.0], [np.nan, np.nan], [200.0, 0.0]])
    assert lie_apart(pixels, [10] * 5).tolist() == [True, False, True, True, True]
    # A long one reaches farther.
    assert lie_apart(pixels[[0, 4]], [10, 60]).tolist() == [True, False]


def test_the_page_sees_points_where_its_camera_projects_them() -> None:
    R = exp_rotation(np.array([0.2, -0.7, 0.4]))
    x, y, z, w = xyzw_from_rotation(R)
    camera = SimpleNamespace(
        wxyz=np.array([w, x, y, z]),
        position=np.array([1.0, -2.0, 3.0]),
        **{"fov": 0.7, "image_height": 600},
    )
    client: Any = SimpleNamespace(camera=camera)
    ahead, top, behind = camera.position + np.array(
        [R @ [0.0, 0.0, 5.0], R @ [0.0, -5.0 * np.tan(0.35), 5.0], R @ [0.0, 0.0, -5.0]]
    )
    seen = Viewfinder(client).pixels(np.array([ahead, top, behind]))
    np.testing.assert_allclose(seen[:2], [[0.0, 0.0], [0.0, -300.0]], atol=1e-9)
    assert np.isnan(seen[2]).all()


class _Camera(SimpleNamespace):
    """viser's: what is set as a tuple is an array."""

    def __setattr__(self, name: str, value: Any) -> None:
        super().__setattr__(name, np.array(value) if isinstance(value, tuple) else value)


def test_a_page_that_has_not_moved_yet_is_where_it_was_told_to_be(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """What it says meanwhile would be in the address, and looked from after a reload."""
    before, after = (3.0, 3.0, 3.0, 0.0, 0.0, 0.0, 0.7), (1.0, -2.0, 5.0, 0.0, 0.5, 20.0, 0.9)
    opened, turned = (2.0, 2.0, 2.0, *before[3:]), (1.1, *after[1:])
    camera: Any = _Camera()
    told_s = [100.0]
    monkeypatch.setattr("pcnav.viewer.camera.time.monotonic", lambda: told_s[0])
    monkeypatch.setattr("pcnav.viewer.camera.drawing", lambda _: nullcontext())

    def says(state: tuple[float, ...]) -> None:
        camera.position, camera.look_at = np.array(state[:3]), np.array(state[3:6])
        camera.fov = state[6]

    says(before)
    client: Any = SimpleNamespace(camera=camera)
    finder = Viewfinder(client)
    assert finder.state == before
    # What is set is there at once; what the page said meanwhile comes later, and part by part.
    finder.set_state(opened)
    says(opened)
    finder.set_state(after)
    says(after)
    assert finder.state == after
    for late in (before, opened, (*before[:6], after[6]), (*after[:3], *before[3:6], after[6])):
        says(late)
        assert finder.state == after
    # Where the user turns it is believed at once, and after a while all that the page says.
    says(turned)
    assert finder.state == turned
    told_s[0] += 60.0
    says(before)
    assert finder.state == before


def test_nodes_stand_where_the_poses_say(loaded: LoadedRun) -> None:
    """The first number of a browser's quaternion is the real part."""
    R = exp_rotation(np.array([0.3, -1.1, 0.6]))
    k = FRAMES - 1
    poses = loaded.T_cam_model.copy()
    poses[k, :3, :3] = R
    turned = replace(
        loaded, run=replace(loaded.run, trajectory=replace(loaded.trajectory, T_cam_target=poses))
    )
    server = LocalServer(LOOPBACK, 0, "poses")
    try:
        layers = RunLayers(server.scene, (turned,), RUNS)
        layers.show(k, None, RenderOptions())
        for node in (layers._measured, layers._targets[0]._model):
            w, x, y, z = node.wxyz
            along_x = (1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y))
            np.testing.assert_allclose(along_x, R[:, 0], atol=1e-12)
            np.testing.assert_allclose(node.position, poses[k, :3, 3])
        truth = layers._targets[0]._ghost
        true = loaded.true_pose(k)
        assert true is not None
        w, *imaginary = truth.wxyz
        np.testing.assert_allclose(w, 0.5 * np.sqrt(1.0 + np.trace(true[:3, :3])), atol=1e-9)
        np.testing.assert_allclose(true[:3, :3] @ imaginary, imaginary, atol=1e-9)
    finally:
        server.stop()


def test_a_page_that_leaves_early_leaves_no_session(
    loaded: LoadedRun, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its session is built in one thread while another is told that it has gone."""
    building, closed = threading.Event(), threading.Event()
    clients: dict[int, Any] = {7: SimpleNamespace(client_id=7)}

    class Slow:
        def __init__(self, client: Any, *_: object) -> None:
            building.set()
            while clients:
                time.sleep(0.001)

        def close(self) -> None:
            closed.set()

    calls: dict[str, Any] = {}
    server: Any = SimpleNamespace(
        on_client_connect=lambda call: calls.setdefault("connect", call),
        on_client_disconnect=lambda call: calls.setdefault("disconnect", call),
        get_clients=lambda: clients,
    )
    monkeypatch.setattr(app, "Session", Slow)
    app.show(server, finished(loaded))
    client = clients[7]
    thread = threading.Thread(target=calls["connect"], args=(client,))
    thread.start()
    assert building.wait(10.0)
    calls["disconnect"](client)
    clients.clear()
    thread.join(10.0)
    assert closed.is_set()


def test_what_a_folder_says_is_text(loaded: LoadedRun) -> None:
    foreign = replace(loaded, notes=("<img src=x onerror=alert(1)>",))
    html = _notes_html(Snapshot((foreign,), 0, is_live=False))
    assert "<img" not in html and "&lt;img" in html


def test_runs_of_different_recordings_are_said_to_be_so(loaded: LoadedRun) -> None:
    assert loaded.run.pipeline is not None
    other = loaded.run.pipeline.model_copy(update={"sequence": "/elsewhere/sequence"})
    moved = replace(loaded, run=replace(loaded.run, pipeline=other))
    for second, said in ((moved, True), (loaded, False)):
        html = _notes_html(Snapshot((loaded, second), 0, is_live=False))
        assert ("different recordings" in html) is said


def test_the_position_is_told_in_the_axes_of_an_eccentric_orbit(loaded: LoadedRun) -> None:
    orbit = KeplerOrbit(1e-3, 0.3, 0.4)
    P = np.diag([1.0, 4.0, 9.0])
    times_s = loaded.run.time_s + 2000.0
    later = replace(loaded.run, trajectory=replace(loaded.trajectory, time_s=times_s))
    covariances = {POSITION.name: np.tile(P, (len(later), 1, 1))}
    told = replace(loaded, run=later, orbit=orbit, covariances=covariances)
    k = FRAMES - 1
    R_cam_world = loaded.T_cam_model[k, :3, :3] @ loaded.trajectory[ATTITUDE][k].T
    R = R_cam_world @ orbit.R_hill_world(float(times_s[k])).T
    np.testing.assert_allclose(told.position_spread_cam(k), R @ P @ R.T, atol=1e-12)
