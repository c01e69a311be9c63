"""Runs on what one camera sees: simulated, estimated and judged from end to end."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pcnav.config.image_motion import ImageMotionTable
from pcnav.config.pipeline_file import read_pipeline
from pcnav.config.sensors import ImageCameraTable, ShadingTable
from pcnav.config.shipped import shipped_mesh
from pcnav.core.errors import InputError
from pcnav.core.spatial import rotation_angle, rotation_from_xyzw
from pcnav.dynamics.blocks import ATTITUDE
from pcnav.estimators.image_motion.estimator import ImageMotionEstimator
from pcnav.evaluation.observability.sources import observability_of_run
from pcnav.files.csv_table import read_csv
from pcnav.pipeline import run
from pcnav.recordings.monocular_tracks import (
    CAMERA_FILE,
    read_monocular_tracks,
    write_monocular_tracks,
)
from pcnav.recordings.tracks import TRACKS_FILE
from pcnav.recordings.truth import read_truth
from pcnav.simulation.simulate import simulate
from tests.pipeline.made import EXACT, Made, command, one_camera, shipped

COLUMNS = ImageMotionEstimator.output.columns


@pytest.fixture(scope="module")
def made(made_of: Callable[[str], Made]) -> Made:
    return made_of("image_motion")


@pytest.fixture
def recording(made: Made) -> Path:
    return made.recording


def states(folder: Path) -> dict[str, Any]:
    """Columns of states.csv: tuples of words, arrays of numbers."""
    words = ("status", "outcome")
    table = read_csv(folder / "states.csv", COLUMNS, words)
    numbers = {n: table.numbers((n,))[:, 0] for n in COLUMNS if n not in words}
    return {**numbers, **{name: table.words(name) for name in words}}


def test_exact_tracks_give_the_true_motion(made: Made) -> None:
    attitude, rate = made.summary.metrics.quantities
    assert attitude.whole.maximum < 1e-6
    assert attitude.whole.frames == 13
    # What the polynomial leaves of a rate that changes.
    assert rate.whole.maximum < 2e-2

    # The same from the files alone: angles between frames do not know the axes.
    found, truth = states(made.result), read_truth(made.recording)
    assert truth is not None and ATTITUDE in truth
    R = rotation_from_xyzw(np.column_stack([found[f"q_{k}"] for k in "xyzw"]))
    turned = rotation_angle(R[0].T @ R)
    true = rotation_angle(truth[ATTITUDE][0].T @ truth[ATTITUDE])
    np.testing.assert_allclose(turned, true, atol=1e-6)
    assert found["status"] == ("acquiring", *["locked"] * 13)
    assert found["outcome"][:2] == ("first frame of a segment", "measured")
    assert "first frame of a segment" in made.summary.report.read_text()
    assert read_pipeline(made.result / "pipeline.toml").image_motion == EXACT


@pytest.mark.study
def test_few_matches_coast_with_the_reason_and_many_new_ones_begin_anew(
    recording: Path, tmp_path: Path
) -> None:
    tracks = read_monocular_tracks(recording)
    frames = list(tracks.frames)
    for k in (5, 6):
        few = slice(0, 7)
        frames[k] = replace(
            frames[k], features=frames[k].features[few], pixels=frames[k].pixels[few]
        )
    for k in range(9, 14):
        frames[k] = replace(frames[k], features=frames[k].features + 10**6)
    write_monocular_tracks(tmp_path / "gaps", replace(tracks, frames=tuple(frames)))
    summary = run(tmp_path / "gaps", tmp_path / "run", one_camera())
    found = states(tmp_path / "run")
    assert found["status"][5:7] == ("coasting", "coasting")
    assert found["outcome"][5:7] == ("fewer than 12 matches",) * 2
    assert np.isnan(found["q_x"][5:7]).all() and np.isfinite(found["q_x"][7])
    assert found["matches"][5] <= 7
    assert found["segment"][8:10].tolist() == [0.0, 1.0]
    assert found["status"][9:11] == ("acquiring", "locked")
    # Without a truth there are no errors, and the report says how the axes changed.
    assert not summary.metrics.quantities
    assert not (tmp_path / "run" / "metrics.json").exists()
    assert "2 segments" in summary.report.read_text(encoding="utf-8")


def test_a_single_face_is_told_and_not_measured(tmp_path: Path) -> None:
    pytest.importorskip("poselib")
    ahead = one_camera(frames=6)
    body = ahead.body.model_copy(update={"attitude_rotvec_deg": (0.0, 0.0, 0.0)})
    robust = ahead.model_copy(update={"body": body, "image_motion": ImageMotionTable()})
    simulate(robust).write(tmp_path / "plane")
    run(tmp_path / "plane", tmp_path / "run", robust)
    found = states(tmp_path / "run")
    assert found["outcome"][1:] == ("points of one plane explain the matches",) * 5
    assert found["status"] == ("acquiring",) * 6


def test_a_truth_is_compared_segment_by_segment(recording: Path, tmp_path: Path) -> None:
    tracks = read_monocular_tracks(recording)
    frames = [
        replace(frame, features=frame.features + (10**6 if k >= 7 else 0))
        for k, frame in enumerate(tracks.frames)
    ]
    write_monocular_tracks(tmp_path / "two", replace(tracks, frames=tuple(frames)))
    (tmp_path / "two" / "truth.csv").write_bytes((recording / "truth.csv").read_bytes())
    summary = run(tmp_path / "two", tmp_path / "run", one_camera())
    assert summary.metrics.frames_compared == 12
    assert summary.metrics.quantities[0].whole.maximum < 1e-6


def test_blackouts_and_noise_are_simulated(tmp_path: Path) -> None:
    noisy = one_camera(frames=12, sigma_px=0.5)
    table = noisy.features.model_copy(update={"blackouts_s": ((3.0, 5.0),)})
    simulate(noisy.model_copy(update={"features": table})).write(tmp_path / "noisy")
    simulate(one_camera(frames=12)).write(tmp_path / "exact")
    first, second = (
        read_monocular_tracks(tmp_path / "noisy"),
        read_monocular_tracks(tmp_path / "exact"),
    )
    assert [len(frame.features) == 0 for frame in first.frames] == [k in (3, 4) for k in range(12)]
    assert first.pixel_sigma_px == 0.5
    np.testing.assert_array_equal(first.frames[0].features, second.frames[0].features)
    apart = np.concatenate(
        [
            a.pixels - b.pixels
            for a, b in zip(first.frames, second.frames, strict=True)
            if len(a.features) == len(b.features)
        ]
    )
    assert np.std(apart) == pytest.approx(0.5, rel=0.1)


def test_bad_input_is_one_line_and_leaves_nothing(recording: Path, tmp_path: Path) -> None:
    bare = tmp_path / "bare"
    bare.mkdir()
    (bare / TRACKS_FILE).write_bytes((recording / TRACKS_FILE).read_bytes())
    with pytest.raises(InputError) as caught:
        run(bare, tmp_path / "run", one_camera())
    assert CAMERA_FILE in str(caught.value) and "\n" not in str(caught.value)
    with pytest.raises(InputError, match="images or a video"):
        run(recording / "truth.csv", tmp_path / "run", one_camera())
    with pytest.raises(InputError, match="does not hold"):
        run(recording, recording, one_camera(), overwrite=True)
    late = tmp_path / "late"
    simulate(one_camera(frames=3)).write(late)
    rows = (late / "truth.csv").read_text(encoding="utf-8").splitlines()
    later = ",".join(["900.0", *rows[1].split(",")[1:]])
    (late / "truth.csv").write_text(f"{rows[0]}\n{later}\n", encoding="utf-8")
    with pytest.raises(InputError, match="none match"):
        run(late, tmp_path / "run", one_camera())
    assert not (tmp_path / "run").exists()


def test_images_need_a_mesh(tmp_path: Path) -> None:
    wanted = one_camera(images=True)
    with pytest.raises(InputError, match="mesh"):
        simulate(wanted).write(tmp_path / "images")


@pytest.mark.study
def test_the_shipped_scenario_by_command(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("poselib")
    recorded, out = tmp_path / "recording", tmp_path / "run"
    assert command(monkeypatch, "simulate", "applsci2022", "-o", recorded) == 0
    assert "61 frames" in capsys.readouterr().out
    camera = read_monocular_tracks(recorded).camera
    assert (camera.width, camera.fx, camera.cx) == (2048, 2909.0, 1024.0)
    truth = read_truth(recorded)
    assert truth is not None and ATTITUDE in truth
    assert command(monkeypatch, "run", recorded, "-o", out) == 0
    assert "angular rate" in capsys.readouterr().out
    metrics = json.loads((out / "metrics.json").read_text(encoding="utf-8"))
    assert metrics["errors"]["attitude_deg"]["whole"]["rms"] < 1.0
    assert metrics["nees"]["theta_body"]["mean_per_degree_of_freedom"] < 2.0

    assert command(monkeypatch, "run", recorded, "--pipeline", "boxsat", "-o", tmp_path / "x") == 2
    assert "image_motion" in capsys.readouterr().err
    (recorded / CAMERA_FILE).unlink()
    arguments = ("run", recorded, "--pipeline", "applsci2022", "-o", tmp_path / "x")
    assert command(monkeypatch, *arguments) == 2
    told = capsys.readouterr().err
    assert CAMERA_FILE in told and told.count("\n") == 1
    assert not (tmp_path / "x").exists()


def test_images_are_followed_and_leave_their_tracks(tmp_path: Path) -> None:
    pytest.importorskip("cv2")
    pytest.importorskip("poselib")
    # A coarser look at the shipped scenario.
    camera = ImageCameraTable(images=True, width_px=320, height_px=320, focal_px=800.0)
    coarse = {"image_camera": camera, "shading": ShadingTable(supersampling=1)}
    small, mesh = shipped("images", 4, **coarse), shipped_mesh("boxsat")
    summary = simulate(small, target_mesh=mesh).write(tmp_path / "images")
    assert summary.endswith("(4 frames)")
    out = tmp_path / "run"
    run(tmp_path / "images", out, small)
    tracks = read_monocular_tracks(out)
    assert len(tracks.frames) == 4
    assert tracks.pixel_sigma_px == small.feature_tracker.pixel_sigma_px
    found = states(out)
    assert found["features"].tolist() == [len(frame.features) for frame in tracks.frames]
    assert (out / "metrics.json").is_file()
    # A run on images keeps the mesh they were simulated of in its pipeline: not to be opened with.
    with pytest.raises(InputError, match=r"states\.csv: rows"):
        observability_of_run(out)
    # The result is a recording: it gives the same attitudes again.
    run(out, tmp_path / "again", small)
    assert states(tmp_path / "again")["outcome"] == found["outcome"]
