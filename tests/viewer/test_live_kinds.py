"""Runs on tracks, images and attitudes as they go on: what is shown is what is then stored."""

from pathlib import Path

import numpy as np
import pytest

from pcnav.cli.run_kinds import Work, attitudes_run, images_run, tracks_run
from pcnav.config.pipeline_file import Pipeline, read_pipeline
from pcnav.config.shipped import shipped_pipeline
from pcnav.simulation.attitude_recording import simulate_attitudes
from pcnav.simulation.feature_recording import simulate_tracks
from pcnav.simulation.image_recording import simulate_images
from pcnav.viewer.live import LiveView
from pcnav.viewer.loaded_run import LoadedRun
from pcnav.viewer.loading import load_run
from pcnav.viewer.server import LocalServer

_FRAMES = 60


def shortened(name: str) -> tuple[Path, Pipeline]:
    path = shipped_pipeline(name)
    assert path is not None
    pipeline = read_pipeline(path)
    scenario = pipeline.scenario.model_copy(update={"frames": _FRAMES})
    return path, pipeline.model_copy(update={"scenario": scenario})


def seen(work: Work) -> tuple[LoadedRun, LoadedRun]:
    """The last snapshot of a run that goes on, and that of its result."""
    served: list[LocalServer] = []
    counts: list[int] = []
    view = LiveView(0, served.append)

    def advance(done: int, total: int, failed: int = 0, /) -> None:
        snapshot = view.snapshot
        assert snapshot.is_live and len(snapshot.runs[0].track) == done
        counts.append(done)

    try:
        done = work(advance, view)
        assert counts == list(range(1, _FRAMES + 1)) and len(served) == 1
        last = view.snapshot.runs[0]
        stored = load_run(done.folder)
        view.finish(stored)
        assert view.snapshot.runs == (stored,) and not view.snapshot.is_live
    finally:
        view.stop()
    return last, stored


def assert_same(live: LoadedRun, stored: LoadedRun, *, rates: bool = True) -> None:
    assert live.counted == stored.counted
    assert live.has_position == stored.has_position and live.has_inertia == stored.has_inertia
    ours, theirs = live.track, stored.track
    assert ours.status == theirs.status
    assert ours.has_estimate.any()
    np.testing.assert_array_equal(ours.has_estimate, theirs.has_estimate)
    np.testing.assert_array_equal(ours.n_rectangles, theirs.n_rectangles)
    np.testing.assert_array_equal(ours.nis_dof, theirs.nis_dof)
    # The file holds attitudes as quaternions.
    np.testing.assert_allclose(ours.R_world_body, theirs.R_world_body, atol=1e-12)
    np.testing.assert_allclose(ours.T_cam_model, theirs.T_cam_model, atol=1e-9)
    known = ours.has_estimate
    if rates:
        np.testing.assert_array_equal(ours.omega_body, theirs.omega_body)
        np.testing.assert_array_equal(ours.inertia_ratios, theirs.inertia_ratios)
        np.testing.assert_array_equal(ours.sd[known], theirs.sd[known])


def test_stereo_tracks(tmp_path: Path) -> None:
    path, pipeline = shortened("segal2011")
    simulate_tracks(pipeline, tmp_path / "tracks", False, path)
    live, stored = seen(tracks_run(tmp_path / "tracks", path, pipeline, tmp_path / "out", False))
    assert_same(live, stored)
    assert live.orbit == stored.orbit


def test_images_of_one_camera(tmp_path: Path) -> None:
    path, pipeline = shortened("applsci2022")
    simulate_images(pipeline, tmp_path / "tracks", False, path)
    live, stored = seen(images_run(tmp_path / "tracks", pipeline, tmp_path / "out", False))
    assert_same(live, stored, rates=False)


def test_attitudes(tmp_path: Path) -> None:
    _, pipeline = shortened("deng2024")
    simulate_attitudes(pipeline, tmp_path / "attitudes", False)
    live, stored = seen(attitudes_run(tmp_path / "attitudes", pipeline, tmp_path / "out", False))
    assert_same(live, stored)


def test_a_frame_of_a_run_that_nothing_is_known_of() -> None:
    from pcnav.viewer.live import LiveRow

    with pytest.raises(RuntimeError, match="expect"):
        LiveView(0, print).add(LiveRow(0.0, "locked", {}))
