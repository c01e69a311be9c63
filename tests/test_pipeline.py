"""The whole way from a pipeline file to a result folder, on a short piece of the shipped demo."""

import csv
import json
import logging
import shutil
import tomllib
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from evo.tools.file_interface import read_tum_trajectory_file

from pcnav.config.pipeline_file import EstimatorTable, Pipeline, read_pipeline
from pcnav.config.scenario import ScenarioTable
from pcnav.config.shipped import shipped_mesh, shipped_pipeline
from pcnav.core.errors import InputError
from pcnav.core.spatial import rotation_angle
from pcnav.dynamics.blocks import RATE
from pcnav.dynamics.state import STATE_SIZE
from pcnav.pipeline import run
from pcnav.recordings.truth import read_truth
from pcnav.runs.estimate import Estimate
from pcnav.runs.reader import read_records, read_run
from pcnav.runs.records import ACCEPTED
from pcnav.simulation.depth import Scene
from pcnav.target.satellite import load_target

FRAMES = 24
PEERS = ("open3d_icp", "small_gicp", "kiss_icp")
ESTIMATES = ("states.csv", "poses.tum", "measurements.csv")


@dataclass(frozen=True)
class Made:
    """A simulated sequence, the result made of it, and what the run told on its way."""

    sequence: Path
    result: Path
    mesh: Path
    told: list[tuple[Estimate, int, int]]


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Made:
    """The shipped demo, shortened."""
    folder = tmp_path_factory.mktemp("made")
    demo, mesh = shipped_pipeline("demo"), shipped_mesh("boxsat")
    assert demo is not None and mesh is not None
    pipeline = read_pipeline(demo)
    rate = pipeline.scenario.frame_rate_hz
    short = pipeline.model_copy(
        update={"scenario": ScenarioTable(frames=FRAMES, frame_rate_hz=rate)}
    )
    sequence, result = folder / "sequence", folder / "result"
    Scene.showing(load_target(mesh), short).write(sequence)
    told: list[tuple[Estimate, int, int]] = []
    run(sequence, result, Pipeline(seed=5), on_estimate=lambda *news: told.append(news))
    return Made(sequence, result, mesh, told)


def same_estimates(one: Path, other: Path) -> bool:
    """Whether two results hold the same estimates, bit for bit."""
    with np.load(one / "covariances.npz") as a, np.load(other / "covariances.npz") as b:
        same_P = a["P"].tobytes() == b["P"].tobytes()
    return same_P and all(
        (one / name).read_bytes() == (other / name).read_bytes() for name in ESTIMATES
    )


def test_every_frame_is_told_of_once(made: Made) -> None:
    assert [(done, total) for _, done, total in made.told] == [
        (k, FRAMES) for k in range(1, FRAMES + 1)
    ]
    track = read_run(made.result)
    assert track.status == tuple(estimate.status for estimate, _, _ in made.told)


def test_the_pose_is_found_and_as_good_as_it_should_be(made: Made) -> None:
    track, truth = read_run(made.result), read_truth(made.sequence)
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


def test_evo_reads_the_poses(made: Made) -> None:
    track = read_run(made.result)
    trajectory = read_tum_trajectory_file(str(made.result / "poses.tum"))
    assert trajectory.check()[0]
    known, poses = track.has_estimate, track.trajectory.T_cam_target
    assert poses is not None
    np.testing.assert_allclose(trajectory.timestamps, track.time_s[known], rtol=0, atol=1e-12)
    np.testing.assert_allclose(np.array(trajectory.poses_se3), poses[known], rtol=0, atol=1e-12)


def test_metrics_have_every_quantity_and_its_unit(made: Made) -> None:
    metrics = json.loads((made.result / "metrics.json").read_text())
    assert {"errors", "frames", "nees", "nis"} <= set(metrics)
    errors = json.dumps(metrics["errors"])
    for quantity in ("position_cam", "attitude", "com_model", "inertia_ratios", "omega_body"):
        assert quantity in errors
    assert "NaN" not in errors
    assert metrics["frames"] == FRAMES


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
    for axis in "xyz":
        assert prior[f"com_{axis}_m"] == pytest.approx(target.com_sd_m)
    assert prior["i_yy"] == pytest.approx(target.inertia_ratio_sd)
    assert {row["verdict"] for row in rows} <= {"known from data", "prior only"}
    # In 6 s the rate is seen, all of the inertia is not.
    verdicts = {row["state"]: row["verdict"] for row in rows}
    assert verdicts["w_x_rad_s"] == "known from data"
    assert "prior only" in {row["verdict"] for row in rows[15:20]}


def test_the_report_tells_errors_and_recording(made: Made) -> None:
    page = (made.result / "report.html").read_text()
    assert "Against the truth" in page
    assert "One frame as it was understood" in page
    assert str(made.sequence) in page


def test_the_truth_never_enters_an_estimate(made: Made, tmp_path: Path) -> None:
    """The same frames without truth give the same bits, and a report without errors."""
    sequence, result = tmp_path / made.sequence.name, tmp_path / "result"
    shutil.copytree(made.sequence, sequence)
    for name in ("scene_gt.json", "truth.csv"):
        (sequence / name).unlink()
    summary = run(sequence, result, Pipeline(seed=5), target_mesh=made.mesh)
    assert same_estimates(result, made.result)
    assert summary.metrics.errors is None
    assert not (result / "metrics.json").exists()
    assert "Against the truth" not in summary.report.read_text()


@pytest.mark.usefixtures("quick_drawings")
def test_the_saved_pipeline_repeats_the_run(made: Made, tmp_path: Path) -> None:
    saved = read_pipeline(made.result / "pipeline.toml")
    assert saved.seed == 5
    assert saved.sequence == str(made.sequence.resolve())
    # The sequence carries its own copy of the mesh.
    assert saved.target_mesh == str((made.sequence / made.mesh.name).resolve())
    result = tmp_path / "result"
    run(Path(saved.sequence), result, saved)
    assert same_estimates(result, made.result)
    assert (result / "metrics.json").read_bytes() == (made.result / "metrics.json").read_bytes()
    assert (result / "pipeline.toml").read_bytes() == (made.result / "pipeline.toml").read_bytes()


def plain_scene(made: Made, folder: Path, frames: int) -> Path:
    """A plain BOP scene of the first frames: no additions of ours, no truth."""
    (folder / "depth").mkdir(parents=True)
    cameras = json.loads((made.sequence / "scene_camera.json").read_text())
    kept = {}
    for number in map(str, range(frames)):
        kept[number] = {key: cameras[number][key] for key in ("cam_K", "depth_scale")}
        name = f"depth/{int(number):06d}.png"
        shutil.copy(made.sequence / name, folder / name)
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
    assert tomllib.loads((tmp_path / "one" / "pipeline.toml").read_text())["target_mesh"] == str(
        made.mesh.resolve()
    )
    caplog.clear()
    stated = f'[sequence]\ntarget_mesh = "{made.mesh.as_posix()}"\n[sensor]\nrange_sigma_m = 0.01\n'
    (scene / "sequence.toml").write_text(stated)
    run(scene, tmp_path / "two", Pipeline(target_mesh=str(other)))
    assert read_pipeline(tmp_path / "two" / "pipeline.toml").target_mesh == str(made.mesh.resolve())
    assert any("twinwing" in record.getMessage() for record in caplog.records)


@pytest.mark.usefixtures("quick_drawings")
@pytest.mark.parametrize("name", ["open3d_icp", "small_gicp", "kiss_icp", "pcnav_single_frame"])
def test_peers_run_like_any_estimator(made: Made, tmp_path: Path, name: str) -> None:
    """From the pose that pcnav acquires: the truth tells them nothing."""
    if name == "small_gicp":
        pytest.importorskip("small_gicp", reason="small_gicp comes with the extra `bench`")
    sequence = tmp_path / made.sequence.name
    shutil.copytree(made.sequence, sequence)
    summary = run(made.sequence, tmp_path / "one", estimator=name)
    found = read_run(tmp_path / "one")
    acquired = read_run(made.result).status.index("locked") if name in PEERS else 0
    locked = ("locked",) * (FRAMES - acquired)
    assert found.status == ("acquiring",) * acquired + locked
    assert found.estimator == name and found.pipeline is not None
    names = ("metrics.json", "pipeline.toml", "poses.tum", "report.html", "states.csv")
    assert sorted(path.name for path in (tmp_path / "one").iterdir()) == list(names)
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


def test_an_estimator_that_does_not_fit_is_refused(made: Made, tmp_path: Path) -> None:
    for name, told in (("nobody", "expected one of depth, pcnav"), ("hu2024", "expected one of")):
        with pytest.raises(InputError, match=told) as raised:
            run(made.sequence, tmp_path / "result", estimator=name)
        assert "--estimator" in str(raised.value)
    with pytest.raises(InputError, match=r"expected a folder with tracks\.csv"):
        run(made.sequence, tmp_path / "result", estimator="principal_axes")
    with pytest.raises(InputError, match=r"estimator\.kind: expected one of"):
        run(made.sequence, tmp_path / "result", Pipeline(estimator=EstimatorTable(kind="nobody")))
