"""Result folders: exact round trip, streaming in flat memory."""

import csv
import tracemalloc
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from evo.tools import file_interface
from hypothesis import given
from hypothesis import strategies as st

from pcnav.config.pipeline_file import Pipeline, read_pipeline
from pcnav.config.region import OWN_MASKS, RegionTable
from pcnav.core.spatial import exp_rotation
from pcnav.dynamics.blocks import (
    ATTITUDE,
    ATTITUDE_LAYOUT,
    CENTRE,
    MOTION_LAYOUT,
    POSE_LAYOUT,
    RATE,
    ROTATION_LAYOUT,
)
from pcnav.runs.collector import collected
from pcnav.runs.estimate import Estimate, Output
from pcnav.runs.nis_window import NIS_WINDOW_FRAMES
from pcnav.runs.places import located, relocatable
from pcnav.runs.provenance import library_versions, pipeline_toml
from pcnav.runs.reader import count_outcomes, read_features, read_points, read_records, read_run
from pcnav.runs.run import Run
from pcnav.runs.writer import RunWriter
from tests.runs.made_estimates import DEPTH, empty, estimate, made, write

OUTPUTS = {
    "depth": DEPTH,
    "principal_axes": Output(MOTION_LAYOUT, notes=("n_used", "p_x"), has_features=True),
    "attitude_inertia": Output(ROTATION_LAYOUT, notes=("sd_measured_rad",)),
    "image_motion": Output(ATTITUDE_LAYOUT, (RATE,), ("outcome", "agreeing"), has_nis=False),
    "open3d_icp": Output(POSE_LAYOUT, has_nis=False),
}
"""As the estimators of these names have them."""


def assert_same(run: Run, expected: Run) -> None:
    """Equal to the bit, but for rotations, which pass through a quaternion."""
    got, wanted = run.trajectory, expected.trajectory
    assert got.layout == wanted.layout
    assert got.values.keys() == wanted.values.keys()
    for name, values in wanted.values.items():
        atol = 2e-15 if name == ATTITUDE.name else 0.0
        np.testing.assert_allclose(got.values[name], values, rtol=0.0, atol=atol)
    if wanted.layout.blocks:
        np.testing.assert_array_equal(got.covariance, wanted.covariance)
        np.testing.assert_array_equal(got.sd, wanted.sd)
    if got.T_cam_target is not None and wanted.T_cam_target is not None:
        known = np.isfinite(wanted.T_cam_target[:, 0, 0])
        np.testing.assert_allclose(got.T_cam_target[known], wanted.T_cam_target[known], atol=2e-15)
    assert run.status == expected.status
    np.testing.assert_array_equal(run.time_s, expected.time_s)
    np.testing.assert_array_equal(run.has_estimate, expected.has_estimate)
    np.testing.assert_array_equal(run.nis, expected.nis)
    np.testing.assert_array_equal(run.nis_dof, expected.nis_dof)
    np.testing.assert_array_equal(run.window_nis, expected.window_nis)
    for name, notes in run.notes.items():
        np.testing.assert_array_equal(notes, expected.notes[name])


@pytest.mark.parametrize("name", OUTPUTS)
def test_round_trip_keeps_every_bit(tmp_path: Path, name: str) -> None:
    output = OUTPUTS[name]
    estimates = made(output)
    write(tmp_path / "run", estimates, output=output)
    run = read_run(tmp_path / "run", with_covariance=True)
    assert_same(run, collected(name, output, estimates))
    assert run.is_finished and not run.segments
    if name != "open3d_icp":
        assert run.estimator == name
    if name == "image_motion":
        assert run.words["outcome"][:3] == ("", "", "measured, more or less")
    has_poses = (tmp_path / "run" / "poses.tum").is_file()
    assert has_poses == (name in ("depth", "principal_axes", "open3d_icp"))
    assert (tmp_path / "run" / "measurements.csv").is_file() == (name == "depth")
    assert (tmp_path / "run" / "covariances.npz").is_file() == (name != "open3d_icp")


@pytest.mark.parametrize("name", OUTPUTS)
def test_a_killed_run_is_read_up_to_its_last_whole_frame(tmp_path: Path, name: str) -> None:
    output = OUTPUTS[name]
    estimates, whole, going_on = made(output), tmp_path / "whole", tmp_path / "run"
    write(whole, estimates, output=output)
    with RunWriter(going_on, output) as writer:
        for each in estimates:
            writer.add(each)
        (staging,) = tmp_path.glob(".run-*")
        assert not read_run(staging, with_covariance=True).is_finished
        # Each file may have got anywhere, also to the middle of a line.
        text = (whole / "states.csv").read_text()
        (staging / "states.csv").write_text(text[: text.rindex("\n", 0, -1) - 2])
        if output.has_poses:
            lines = (whole / "poses.tum").read_text().splitlines(keepends=True)
            (staging / "poses.tum").write_text("".join(lines[:2]) + lines[2][:9])
        run = read_run(staging)
        assert len(run) == (4 if output.has_poses and output.layout.blocks else 6)
        shown = run.trajectory.at(slice(4))
        expected = collected(name, output, estimates).trajectory.at(slice(4))
        for block, values in expected.values.items():
            np.testing.assert_allclose(shown.values[block], values, atol=2e-15)
        assert shown.covariance is None
        if name == "depth":
            assert len(read_records(staging, float(run.time_s[-1]))) <= 4


def test_an_estimator_may_know_better_at_the_end(tmp_path: Path) -> None:
    output = OUTPUTS["image_motion"]
    estimates = made(output)
    with RunWriter(tmp_path / "run", output) as writer:
        for each in estimates:
            bare = {name: v for name, v in each.values.items() if name != RATE.name}
            writer.add(replace(each, values=bare))
        writer.revise(estimates)
    assert_same(
        read_run(tmp_path / "run", with_covariance=True),
        collected("image_motion", output, estimates),
    )


def test_quaternions_of_a_run_that_follows_signs_do_not_jump(tmp_path: Path) -> None:
    turns = [exp_rotation(np.array([0.0, 0.0, angle])) for angle in np.arange(0.0, 9.0, 0.5)]
    output = Output(ATTITUDE_LAYOUT, follows_signs=True)
    estimates = [
        Estimate(float(k), "locked", {ATTITUDE.name: R}, np.eye(3)) for k, R in enumerate(turns)
    ]
    write(tmp_path / "run", estimates, output=output)
    with (tmp_path / "run" / "states.csv").open(newline="") as file:
        q = np.array([[float(row[f"q_{x}"]) for x in "xyzw"] for row in csv.DictReader(file)])
    assert np.all(np.sum(q[1:] * q[:-1], axis=1) > 0.0) and q[:, 3].min() < -0.5


def test_axes_begun_anew_are_told(tmp_path: Path) -> None:
    output = OUTPUTS["image_motion"]
    estimates = made(output)
    turn = exp_rotation(np.array([0.1, 0.2, 0.3]))
    estimates[3] = replace(estimates[3], new_axes=turn)
    write(tmp_path / "run", estimates, output=output)
    (segment,) = read_run(tmp_path / "run").segments
    assert segment.time_s == 1.0
    np.testing.assert_allclose(segment.R_world_body, turn, atol=1e-15)


def test_points_and_features_of_a_run(tmp_path: Path) -> None:
    output = OUTPUTS["principal_axes"]
    estimates = made(output)
    write(tmp_path / "run", estimates, output=output)
    points, features = read_points(tmp_path / "run"), read_features(tmp_path / "run")
    assert points is not None and features is not None
    assert len(points.feature) == 10
    np.testing.assert_array_equal(points.p_body[2], estimates[3].features.points[7].p_body)
    assert features.feature.tolist() == [2, 3, 4, 5, 6, 7]
    assert features.frames_seen.tolist() == [1, 1, 1, 1, 1, 5]
    assert features.frames_rejected.tolist() == [0, 0, 0, 0, 0, 5]
    known = np.isfinite(features.p_body).all(axis=1)
    # Those of the last frame with an estimate.
    assert features.feature[known].tolist() == [6, 7]
    last = estimates[6].features.points[7]
    np.testing.assert_array_equal(features.sd[-1], np.sqrt(np.diag(last.covariance)))
    assert read_points(tmp_path) is None and read_features(tmp_path) is None


def test_the_window_of_innovations_ends_with_a_track(tmp_path: Path) -> None:
    output = OUTPUTS["attitude_inertia"]
    generator = np.random.default_rng(1)
    estimates = [estimate(k, generator, output) for k in range(2 * NIS_WINDOW_FRAMES)]
    estimates[30] = empty(30)
    estimates[35] = replace(estimates[35], nis=np.nan, nis_dof=0)
    write(tmp_path / "run", estimates, output=output)
    window = read_run(tmp_path / "run").window_nis
    nis = np.array([each.nis for each in estimates])
    np.testing.assert_allclose(window[25], nis[6:26].sum() / 120.0)
    assert np.isnan(window[30])
    # Nothing of the track before the gap is left, and a frame without innovation changes nothing.
    np.testing.assert_allclose(window[31], nis[31] / 6.0)
    assert window[35] == window[34]
    np.testing.assert_allclose(window[39], nis[[31, 32, 33, 34, 36, 37, 38, 39]].sum() / 48.0)


def test_a_folder_of_the_last_release_is_read(tmp_path: Path, frames: list[Estimate]) -> None:
    write(tmp_path / "run", frames)
    path = tmp_path / "run" / "states.csv"
    path.write_text(path.read_text().replace("inlier_ratio", "explained", 1))
    notes = read_run(tmp_path / "run").notes
    assert notes["inlier_ratio"][2] == frames[2].notes["inlier_ratio"]
    # Up to it the frames of images alone told where the axes were begun anew.
    output = replace(OUTPUTS["image_motion"], notes=("outcome", "segment"))
    images = made(output)
    images = [
        replace(each, notes={**each.notes, "segment": k // 4}) for k, each in enumerate(images)
    ]
    write(tmp_path / "images", images, output=output)
    segments = read_run(tmp_path / "images").segments
    assert [segment.time_s for segment in segments] == [2 / 3, 4 / 3]


def test_measurements_round_trip(tmp_path: Path, frames: list[Estimate]) -> None:
    write(tmp_path / "run", frames)
    written = [record for frame in frames for record in frame.records]
    read = read_records(tmp_path / "run")
    assert len(read) == len(written) == 10
    for got, expected in zip(read, written, strict=True):
        for name in ("time_s", "rectangle", "length_m", "width_m", "case", "outcome"):
            assert getattr(got, name) == getattr(expected, name)
        np.testing.assert_array_equal(got.sd, expected.sd)
        np.testing.assert_allclose(got.T_cam_rect, expected.T_cam_rect, atol=2e-15)


def test_a_record_without_a_pose_reads_back_without_one(tmp_path: Path) -> None:
    frame = estimate(0, np.random.default_rng(0))
    record = replace(frame.records[0], T_cam_rect=np.full((4, 4), np.nan))
    write(tmp_path / "run", [replace(frame, records=(record,))])
    assert np.isnan(read_records(tmp_path / "run")[0].T_cam_rect[:3]).all()


def test_evo_reads_the_poses(tmp_path: Path, frames: list[Estimate]) -> None:
    write(tmp_path / "run", frames)
    trajectory = file_interface.read_tum_trajectory_file(str(tmp_path / "run" / "poses.tum"))
    expected = [frame for frame in frames if frame.T_cam_target is not None]
    assert trajectory.num_poses == len(expected) == 5
    for i, frame in enumerate(expected):
        assert frame.T_cam_target is not None
        assert trajectory.timestamps[i] == frame.time_s
        np.testing.assert_allclose(trajectory.poses_se3[i], frame.T_cam_target, atol=1e-14)


def test_columns_are_those_of_the_documented_format(tmp_path: Path, frames: list[Estimate]) -> None:
    write(tmp_path / "run", frames)
    with (tmp_path / "run" / "states.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    frame = frames[3]
    assert frame.covariance is not None
    row = rows[3]
    assert float(row["com_y_m"]) == frame[CENTRE][1]
    assert float(row["sd_com_y_m"]) ** 2 == pytest.approx(frame.covariance[7, 7], rel=1e-14)
    assert float(row["sd_theta_x_rad"]) ** 2 == pytest.approx(frame.covariance[9, 9], rel=1e-14)
    assert float(row["sd_w_z_rad_s"]) ** 2 == pytest.approx(frame.covariance[14, 14], rel=1e-14)
    assert float(row["sd_i_yz"]) ** 2 == pytest.approx(frame.covariance[19, 19], rel=1e-14)
    assert float(row["window_nis"]) == pytest.approx((frames[2].nis + frame.nis) / 12.0)
    assert float(row["inlier_ratio"]) == frame.notes["inlier_ratio"]
    assert rows[0]["r_x_m"] == rows[0]["nis"] == ""
    assert rows[0]["window_nis"] == rows[0]["inlier_ratio"] == ""


def test_a_run_without_frames_or_estimates_is_still_a_run(tmp_path: Path) -> None:
    write(tmp_path / "none", [])
    write(tmp_path / "unknown", [empty(0), empty(1)])
    assert len(read_run(tmp_path / "none", with_covariance=True)) == 0
    assert not read_run(tmp_path / "unknown", with_covariance=True).has_estimate.any()
    assert read_records(tmp_path / "unknown") == ()
    assert not count_outcomes(tmp_path / "unknown")


def test_memory_does_not_grow_with_the_run(tmp_path: Path) -> None:
    frame = estimate(0, np.random.default_rng(0))
    with RunWriter(tmp_path / "run", DEPTH) as writer:
        for _ in range(50):
            writer.add(frame)
        tracemalloc.start()
        before, _ = tracemalloc.get_traced_memory()
        for _ in range(1500):
            writer.add(frame)
        # 1,500 covariances are 4.8 MB; packing them must not gather them either.
        writer.finish_tables()
        _, peak = tracemalloc.get_traced_memory()
        tracemalloc.stop()
    assert peak - before < 1_000_000
    assert np.load(tmp_path / "run" / "covariances.npz")["P"].shape == (1550, 20, 20)


@given(
    name=st.none() | st.text(st.characters(codec="utf-8", exclude_characters="\0"), max_size=12),
    seed=st.integers(0, 2**63 - 1),
    sigma=st.floats(0.0, 1e15).filter(lambda x: x == 0.0 or x >= 1e-30),
)
def test_the_stored_pipeline_can_be_run_again(
    tmp_path_factory: pytest.TempPathFactory, name: str | None, seed: int, sigma: float
) -> None:
    pipeline = Pipeline.model_validate(
        {"seed": seed, "target_mesh": name, "noise": {"range_sigma_m": sigma}}
    )
    path = tmp_path_factory.mktemp("pipeline") / "pipeline.toml"
    path.write_text(pipeline_toml(pipeline, library_versions()), encoding="utf-8")
    assert read_pipeline(path) == pipeline


def test_versions_are_in_the_stored_pipeline() -> None:
    versions = library_versions()
    assert versions["numpy"] == np.__version__
    assert {"pcnav", "python", "scipy", "trimesh", "filterpy"} <= set(versions)
    assert "not installed" not in versions.values()
    assert f"# numpy {np.__version__}" in pipeline_toml(Pipeline(), versions)


def test_a_result_names_its_files_from_where_it_is(tmp_path: Path) -> None:
    """Moved together they are found; moved alone, what stayed is; lost, where it should be."""
    recording, home = tmp_path / "data" / "recording", tmp_path / "results" / "one"
    for folder in (recording, home):
        folder.mkdir(parents=True)
    pipeline = Pipeline(sequence=str(recording), region=RegionTable(masks=str(recording)))
    stored = relocatable(pipeline, home)
    assert (stored.sequence, stored.region.masks) == ("../../data/recording",) * 2
    assert located(stored, home) == pipeline
    alone = tmp_path / "one"
    home.rename(alone)
    assert located(stored, alone) == pipeline
    together = tmp_path / "moved"
    (together / "results").mkdir(parents=True)
    alone.rename(together / "results" / "one")
    (tmp_path / "data").rename(together / "data")
    moved = str(together / "data" / "recording")
    assert located(stored, together / "results" / "one").sequence == moved
    (together / "data").rename(tmp_path / "gone")
    assert located(stored, together / "results" / "one").sequence == moved
    own = Pipeline(region=RegionTable(masks=OWN_MASKS))
    assert located(relocatable(own, home), home) == own
