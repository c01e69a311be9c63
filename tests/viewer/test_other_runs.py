"""Runs on feature tracks, on images and on attitudes are runs, too."""

from pathlib import Path

import numpy as np

from pcnav.attitude_pipeline import run_attitudes
from pcnav.config.pipeline_file import Pipeline, read_pipeline
from pcnav.config.shipped import shipped_pipeline
from pcnav.core.spatial import exp_rotation
from pcnav.feature_pipeline import run_features
from pcnav.runs.image_results import ImageTrack, write_states
from pcnav.runs.provenance import pipeline_toml
from pcnav.simulation.attitude_recording import simulate_attitudes
from pcnav.simulation.feature_recording import simulate_tracks
from pcnav.viewer.controls import available_layers
from pcnav.viewer.curves import groups_of
from pcnav.viewer.loaded_run import Snapshot, load_run
from pcnav.viewer.panels import facts_html
from pcnav.viewer.render_options import Layer

_FRAMES = 150


def test_a_run_on_feature_tracks_has_points_and_errors(tmp_path: Path) -> None:
    path = shipped_pipeline("hu2024")
    assert path is not None
    pipeline = read_pipeline(path)
    scenario = pipeline.scenario.model_copy(update={"frames": _FRAMES})
    pipeline = pipeline.model_copy(update={"scenario": scenario})
    simulate_tracks(pipeline, tmp_path / "tracks", False, path)
    summary = run_features(tmp_path / "tracks", tmp_path / "result", pipeline)
    loaded = load_run(summary.folder)
    assert len(loaded.track) == _FRAMES
    assert loaded.counted == "features"
    assert loaded.evaluation is not None
    known = np.flatnonzero(loaded.track.has_estimate)
    assert known.size
    if loaded.points_body is not None and len(loaded.points_body):
        assert np.isfinite(loaded.points_body).all()
    assert "mass centre" not in groups_of(loaded)
    assert groups_of(loaded)["position"]().charts[0].is_error
    assert "range" in facts_html(loaded, int(known[-1]), None)
    layers = available_layers(Snapshot((loaded,), 0, is_live=False))
    assert Layer.POINTS not in layers and Layer.RATE in layers


def test_a_run_on_images_has_attitude_and_rate_only(tmp_path: Path) -> None:
    n, rate = 5, np.array([0.0, 0.02, 0.01])
    time_s = np.arange(n, dtype=float)
    R = exp_rotation(time_s[:, None] * rate)
    R[0] = np.nan
    track = ImageTrack(
        time_s=time_s,
        R_world_body=R,
        omega_body=np.tile(rate, (n, 1)),
        covariance=np.tile(1e-4 * np.eye(3), (n, 1, 1)),
        status=("acquiring", *["locked"] * (n - 1)),
        outcome=("measured",) * n,
        is_first=np.arange(n) == 0,
        segment=np.zeros(n, dtype=np.intp),
        reference=(None, *range(n - 1)),
        n_features=np.full(n, 30),
        n_matches=np.full(n, 20),
        n_agreeing=np.full(n, 18),
    )
    write_states(tmp_path, track)
    (tmp_path / "pipeline.toml").write_text(pipeline_toml(Pipeline(), {}))
    loaded = load_run(tmp_path)
    assert loaded.track.has_estimate.tolist() == [False, True, True, True, True]
    assert np.allclose(loaded.track.T_cam_model[1:, :3, :3], R[1:])
    assert not loaded.has_position
    assert list(groups_of(loaded)) == ["attitude", "rate", "consistency"]
    for make in groups_of(loaded).values():
        assert make().charts
    facts = facts_html(loaded, 2, None)
    assert "range" not in facts and "deg/s" in facts and "nan" not in facts
    layers = available_layers(Snapshot((loaded,), 0, is_live=False))
    assert Layer.POSITION not in layers and Layer.BODY in layers


def test_a_run_on_attitudes_has_rotation_and_inertia(tmp_path: Path) -> None:
    path = shipped_pipeline("deng2024")
    assert path is not None
    pipeline = read_pipeline(path)
    scenario = pipeline.scenario.model_copy(update={"frames": 60})
    pipeline = pipeline.model_copy(update={"scenario": scenario})
    simulate_attitudes(pipeline, tmp_path / "recording")
    summary = run_attitudes(tmp_path / "recording", tmp_path / "result", pipeline)
    loaded = load_run(summary.folder)
    assert len(loaded.track) == 60 and not loaded.has_position
    assert list(groups_of(loaded)) == ["attitude", "rate", "inertia ratios", "consistency"]
    for make in groups_of(loaded).values():
        assert make().charts
    facts = facts_html(loaded, 59, None)
    assert "over Ixx" in facts and "nan" not in facts
    layers = available_layers(Snapshot((loaded,), 0, is_live=False))
    assert Layer.PRINCIPAL in layers and Layer.POSITION not in layers
