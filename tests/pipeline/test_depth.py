"""Runs on depth frames: a short piece of the shipped demo."""

import csv
import json
import logging
import shutil
import tomllib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from pcnav.config.pipeline_file import EstimatorTable, Pipeline, read_pipeline
from pcnav.config.shipped import shipped_mesh
from pcnav.core.errors import InputError
from pcnav.core.spatial import rotation_angle
from pcnav.dynamics.blocks import RATE
from pcnav.dynamics.state import STATE_SIZE
from pcnav.estimators.peers.icp import disturbed
from pcnav.files.manifest import MANIFEST_FILE
from pcnav.pipeline import run
from pcnav.recordings.first_pose import table_of
from pcnav.recordings.sequence import FirstPosePrior
from pcnav.recordings.truth import read_truth
from pcnav.runs.reader import read_records, read_run
from pcnav.runs.records import ACCEPTED
from pcnav.target.satellite import load_target
from tests.pipeline.made import Made

FRAMES = 24
PEERS = ("open3d_icp", "small_gicp", "kiss_icp")


@pytest.fixture(scope="module")
def made(made_of: Callable[[str], Made]) -> Made:
    return made_of("depth")


def test_the_pose_is_found_and_as_good_as_it_should_be(made: Made) -> None:
    track, truth = read_run(made.result), read_truth(made.recording)
    assert truth is not None and truth.T_cam_target is not None and RATE in truth
    assert track.has_estimate[4:].all()
    settled = slice(8, None)
    assert track.trajectory.T_cam_target is not None
    T, true_T = track.trajectory.T_cam_target[settled], truth.T_cam_target[settled]
    position_m = np.linalg.norm(T[:, :3, 3] - true_T[:, :3, 3], axis=1)
    turn = rotation_angle(np.swapaxes(true_T[:, :3, :3], 1, 2) @ T[:, :3, :3])
    # At 18 m with 10 mm of noise a single frame is good to about 0.5 mm and 0.03 degrees.
    assert np.max(position_m) < 2e-3
    assert np.max(np.degrees(turn)) < 0.1
    spin = np.linalg.norm(track.trajectory[RATE][-1] - truth[RATE][-1])
    assert np.degrees(spin) < 0.1
    assert np.linalg.norm(truth[RATE][-1]) > np.radians(5.0)


def test_the_rectangles_are_in_the_catalogue_and_of_its_sizes(made: Made) -> None:
    catalogue = {rectangle.name: rectangle for rectangle in load_target(made.mesh).rectangles}
    used = [record for record in read_records(made.result) if record.outcome == ACCEPTED]
    assert len(used) > FRAMES
    assert {record.rectangle for record in used} <= set(catalogue)
    assert len({record.rectangle for record in used}) >= 3
    counts = read_run(made.result).notes["n_rectangles"]
    assert len(used) == counts.sum()


def test_what_is_known_of_every_state_is_written(made: Made) -> None:
    with (made.result / "knowledge.csv").open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    # 20 states, 3 combinations of the mass centre's components and 5 of the inertia ratios.
    assert len(rows) == 28
    track = read_run(made.result)
    sd = np.array([float(row["posterior_sd"]) for row in rows[:STATE_SIZE]])
    assert track.trajectory.sd is not None
    np.testing.assert_allclose(sd, track.trajectory.sd[-1], rtol=1e-9)
    target = load_target(made.mesh)
    prior = {row["state"]: float(row["prior_sd"]) for row in rows}
    com_sd, ratios_sd = target.mass.prior.sd
    assert [prior[f"com_{axis}_m"] for axis in "xyz"] == pytest.approx(com_sd)
    assert prior["i_yy"] == pytest.approx(ratios_sd[0])
    assert {row["verdict"] for row in rows} <= {"known from data", "prior only"}
    # In 6 s the rate is seen, all of the inertia is not.
    verdicts = {row["state"]: row["verdict"] for row in rows}
    assert verdicts["w_x_rad_s"] == "known from data"
    assert "prior only" in {row["verdict"] for row in rows[15:20]}


def plain_scene(made: Made, folder: Path, frames: int) -> Path:
    """A plain BOP scene of the first frames: no additions of ours, no truth."""
    (folder / "depth").mkdir(parents=True)
    cameras = json.loads((made.recording / "scene_camera.json").read_text())
    kept = {}
    for number in map(str, range(frames)):
        kept[number] = {key: cameras[number][key] for key in ("cam_K", "depth_scale")}
        name = f"depth/{int(number):06d}.png"
        shutil.copy(made.recording / name, folder / name)
    (folder / "scene_camera.json").write_text(json.dumps(kept))
    return folder


@pytest.mark.usefixtures("quick_drawings")
def test_a_plain_bop_scene_needs_a_mesh_and_warns_once(
    made: Made, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.WARNING, logger="pcnav")
    scene = plain_scene(made, tmp_path / "scene", 5)
    with pytest.raises(InputError, match="target_mesh"):
        run(scene, tmp_path / "result", Pipeline())
    caplog.clear()
    run(scene, tmp_path / "result", Pipeline(), target_mesh=made.mesh)
    (record,) = caplog.records
    for assumed in ("timestamp_s", "camera at rest", "sequence.toml"):
        assert assumed in record.getMessage()
    track = read_run(tmp_path / "result")
    np.testing.assert_array_equal(track.time_s, np.arange(5.0))
    assert track.has_estimate.any()


@pytest.mark.usefixtures("quick_drawings")
def test_the_mesh_is_the_sequences_before_the_pipelines(
    made: Made, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """A pipeline's mesh serves a sequence that names none; where both do, a warning says so."""
    caplog.set_level(logging.WARNING, logger="pcnav")
    scene = plain_scene(made, tmp_path / "scene", 1)
    other = shipped_mesh("twinwing")
    assert other is not None
    run(scene, tmp_path / "one", Pipeline(target_mesh=str(made.mesh)))
    as_run = read_run(tmp_path / "one").pipeline
    assert as_run is not None
    assert as_run.target_mesh == str(made.mesh.resolve())
    caplog.clear()
    stated = f'[sequence]\ntarget_mesh = "{made.mesh.as_posix()}"\n[sensor]\nrange_sigma_m = 0.01\n'
    (scene / "sequence.toml").write_text(stated)
    run(scene, tmp_path / "two", Pipeline(target_mesh=str(other)))
    as_run = read_run(tmp_path / "two").pipeline
    assert as_run is not None
    assert as_run.target_mesh == str(made.mesh.resolve())
    assert any("twinwing" in record.getMessage() for record in caplog.records)


@pytest.mark.usefixtures("quick_drawings")
@pytest.mark.parametrize("name", ["open3d_icp", "small_gicp", "kiss_icp", "pcnav_single_frame"])
def test_peers_run_like_any_estimator(
    made: Made, tmp_path: Path, name: str, caplog: pytest.LogCaptureFixture
) -> None:
    """From the pose that pcnav acquires: the truth tells them nothing."""
    if name == "small_gicp":
        pytest.importorskip("small_gicp", reason="small_gicp comes with the extra `peers`")
    sequence = tmp_path / made.recording.name
    shutil.copytree(made.recording, sequence)
    summary = run(made.recording, tmp_path / "one", estimator=name)
    found = read_run(tmp_path / "one")
    acquired = read_run(made.result).status.index("locked") if name in PEERS else 0
    locked = ("locked",) * (FRAMES - acquired)
    assert found.status == ("acquiring",) * acquired + locked
    assert found.estimator == name and found.pipeline is not None
    # Poses alone have no observability, which is nothing to warn about.
    assert "observability" not in caplog.text
    names = {"metrics.json", "pipeline.toml", "poses.tum", "report.html", "states.csv"}
    names.add("summary.json")
    assert {path.name for path in (tmp_path / "one").iterdir()} == names | {MANIFEST_FILE}
    quantities = {each.key: each for each in summary.metrics.quantities}
    assert set(quantities) == {"position_cam", "attitude"}
    assert quantities["position_cam"].whole.maximum < 0.1
    assert quantities["attitude"].whole.maximum < 2.0
    for file in ("scene_gt.json", "truth.csv"):
        (sequence / file).unlink()
    # The pipeline as run names the estimator, too.
    run(sequence, tmp_path / "two", found.pipeline, target_mesh=made.mesh)
    for file in ("states.csv", "poses.tum"):
        assert (tmp_path / "one" / file).read_bytes() == (tmp_path / "two" / file).read_bytes()


@pytest.mark.usefixtures("quick_drawings")
def test_a_peer_begins_at_the_first_pose_where_one_is_stated(made: Made, tmp_path: Path) -> None:
    """Off by more than its errors afterwards; the pipeline as run repeats the run."""
    truth = read_truth(made.recording)
    assert truth is not None and truth.T_cam_target is not None
    T = disturbed(truth.T_cam_target[0], load_target(made.mesh).diameter_m)
    stated = table_of(FirstPosePrior(T, 0.2, 0.1))
    run(made.recording, tmp_path / "one", estimator="open3d_icp", initial_pose=stated)
    found = read_run(tmp_path / "one")
    assert found.status == ("locked",) * FRAMES
    assert found.trajectory.T_cam_target is not None
    off = np.linalg.norm((found.trajectory.T_cam_target - truth.T_cam_target)[:, :3, 3], axis=1)
    assert off.max() < 0.02 < np.linalg.norm((T - truth.T_cam_target[0])[:3, 3])
    repeated = read_pipeline(tmp_path / "one" / "pipeline.toml")
    assert repeated.initial_pose == stated
    run(made.recording, tmp_path / "two", repeated)
    poses = [(tmp_path / name / "poses.tum").read_bytes() for name in ("one", "two")]
    assert poses[0] == poses[1]


def test_an_estimator_that_does_not_fit_is_refused(made: Made, tmp_path: Path) -> None:
    for name, told in (("nobody", "expected one of depth, pcnav"), ("hu2024", "expected one of")):
        with pytest.raises(InputError, match=told) as raised:
            run(made.recording, tmp_path / "result", estimator=name)
        assert "--estimator" in str(raised.value)
    with pytest.raises(InputError, match=r"expected a folder with tracks\.csv"):
        run(made.recording, tmp_path / "result", estimator="principal_axes")
    with pytest.raises(InputError, match=r"estimator\.kind: expected one of"):
        run(made.recording, tmp_path / "result", Pipeline(estimator=EstimatorTable(kind="nobody")))


def test_a_bad_frame_is_coasted_over_and_listed_where_that_is_allowed(
    made: Made, tmp_path: Path, caplog: pytest.LogCaptureFixture, quick_drawings: None
) -> None:
    recording = tmp_path / "recording"
    shutil.copytree(made.recording, recording)
    for damaged in (recording / "depth" / "000012.png", recording / "depth" / "000023.png"):
        damaged.write_bytes(damaged.read_bytes()[:200])
    with pytest.raises(InputError, match="--skip-bad-frames"):
        run(recording, tmp_path / "none", target_mesh=made.mesh)
    assert not (tmp_path / "none").exists()
    result = tmp_path / "result"
    with caplog.at_level(logging.WARNING, logger="pcnav"):
        run(recording, result, Pipeline(skip_bad_frames=True), target_mesh=made.mesh)
    said = "2 of 24 frames could not be read and were coasted over: 12, 23"
    assert any(said in record.getMessage() for record in caplog.records)
    track = read_run(result)
    assert len(track) == FRAMES
    assert [track.status[k] for k in (11, 12, 13, 23)] == [
        *("locked", "coasting", "locked", "coasting")
    ]
    table = (result / "skipped_frames.csv").read_text(encoding="utf-8").splitlines()
    assert len(table) == 3
    assert table[1].startswith("12,")
    assert said in (result / "report.html").read_text(encoding="utf-8")
    assert tomllib.loads((result / "pipeline.toml").read_text())["skip_bad_frames"] is True
    assert not (made.result / "skipped_frames.csv").exists()
