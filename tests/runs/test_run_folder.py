"""Result folders: exact round trip, streaming in flat memory, all or nothing on disk."""

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
from pcnav.core.arrays import FloatArray
from pcnav.core.errors import InputError
from pcnav.core.spatial import exp_rotation, make_transform
from pcnav.dynamics.blocks import (
    ATTITUDE,
    ATTITUDE_LAYOUT,
    CENTRE,
    MASS_CENTRE_LAYOUT,
    MOTION_LAYOUT,
    POSE_LAYOUT,
    RATE,
    ROTATION_LAYOUT,
    Block,
)
from pcnav.runs.collector import collected
from pcnav.runs.estimate import Estimate, FeaturePoint, FeatureUse, Output
from pcnav.runs.nis_window import NIS_WINDOW_FRAMES
from pcnav.runs.provenance import library_versions, pipeline_toml
from pcnav.runs.reader import count_outcomes, read_features, read_points, read_records, read_run
from pcnav.runs.records import ACCEPTED, RectangleRecord
from pcnav.runs.run import Run
from pcnav.runs.writer import RunWriter

DEPTH = Output(MASS_CENTRE_LAYOUT, notes=("inlier_ratio", "n_rectangles"), has_records=True)
OUTPUTS = {
    "depth": DEPTH,
    "principal_axes": Output(MOTION_LAYOUT, notes=("n_used", "p_x"), has_features=True),
    "attitude_inertia": Output(ROTATION_LAYOUT, notes=("sd_measured_rad",)),
    "image_motion": Output(ATTITUDE_LAYOUT, (RATE,), ("outcome", "agreeing"), has_nis=False),
    "open3d_icp": Output(POSE_LAYOUT, has_nis=False),
}
"""As the estimators of these names have them."""


def value_of(block: Block, generator: np.random.Generator) -> FloatArray:
    """Of arbitrary numbers with all their digits."""
    if block is ATTITUDE:
        return exp_rotation(generator.standard_normal(3))
    return generator.standard_normal(block.size) * 10.0 ** generator.integers(-7, 4)


def estimate(index: int, generator: np.random.Generator, output: Output = DEPTH) -> Estimate:
    """A frame with all that an output has."""
    draw = generator.standard_normal
    size = output.layout.size
    factor = draw((size, size))
    record = RectangleRecord(
        time_s=index / 3.0,
        rectangle='panel "a", +y',
        length_m=4.0 / 3.0,
        width_m=1e-3 / 7.0,
        T_cam_rect=make_transform(exp_rotation(draw(3)), draw(3)),
        sd=np.array([0.1 / 3.0, np.inf, 1e-9, 1.0, np.inf, 2.0]),
        case="X",
        outcome=ACCEPTED,
    )
    unknown = replace(record, rectangle="", case="", outcome="side cut; 2,1 m\nshort")
    words = {"outcome": "measured, more or less"}
    points = {k: FeaturePoint(draw(3), np.diag(draw(3) ** 2)) for k in (7, index)}
    return Estimate(
        time_s=index / 3.0,
        status="locked",
        values={block.name: value_of(block, generator) for block in output.blocks},
        covariance=factor @ factor.T if size else None,
        T_cam_target=make_transform(exp_rotation(draw(3)), draw(3) * 20.0)
        if output.has_poses
        else None,
        nis=float(generator.chisquare(6)) if output.has_nis else np.nan,
        nis_dof=6 if output.has_nis else 0,
        notes={name: words.get(name, float(generator.uniform())) for name in output.notes},
        records=(record, unknown) if output.has_records else (),
        features=FeatureUse((index, 7), (index,), (7,), points),
    )


def empty(index: int) -> Estimate:
    """A frame before anything is known."""
    return Estimate(index / 3.0, "acquiring")


def made(output: Output = DEPTH) -> list[Estimate]:
    """Frames with and without an estimate."""
    generator = np.random.default_rng(3)
    known = [estimate(i, generator, output) for i in range(2, 7)]
    return [empty(0), empty(1), *known, empty(7)]


def write(
    folder: Path, estimates: list[Estimate], overwrite: bool = False, output: Output = DEPTH
) -> None:
    with RunWriter(folder, output, overwrite) as writer:
        for each in estimates:
            writer.add(each)


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


@pytest.fixture
def frames() -> list[Estimate]:
    return made()


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


def test_an_exception_leaves_nothing(tmp_path: Path, frames: list[Estimate]) -> None:
    with (
        pytest.raises(KeyboardInterrupt),
        RunWriter(tmp_path / "new" / "deep" / "run", DEPTH) as writer,
    ):
        writer.add(frames[3])
        raise KeyboardInterrupt
    assert list(tmp_path.iterdir()) == []


def test_an_earlier_run_survives_until_the_new_one_is_complete(
    tmp_path: Path, frames: list[Estimate]
) -> None:
    folder = tmp_path / "run"
    write(folder, frames)
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    with pytest.raises(InputError, match="overwrite"):
        write(folder, frames[:2])
    with pytest.raises(RuntimeError, match="fault"), RunWriter(folder, DEPTH, True) as writer:
        writer.add(frames[3])
        raise RuntimeError("fault")
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before
    assert [path.name for path in tmp_path.iterdir()] == ["run"]
    with RunWriter(folder, DEPTH, overwrite=True) as writer:
        writer.add(frames[3])
        writer.finish_tables()
        assert {path.name: path.read_bytes() for path in folder.iterdir()} == before
    assert len(read_run(folder)) == 1
    assert [path.name for path in tmp_path.iterdir()] == ["run"]


def test_overwriting_spares_a_folder_that_is_no_run(tmp_path: Path) -> None:
    (tmp_path / "thesis").mkdir()
    (tmp_path / "thesis" / "chapter1.tex").write_text("years of work")
    with pytest.raises(InputError, match=r"states\.csv"):
        write(tmp_path / "thesis", [empty(0)], overwrite=True)
    assert (tmp_path / "thesis" / "chapter1.tex").read_text() == "years of work"
    with pytest.raises(InputError, match="this is a file"):
        write(tmp_path / "thesis" / "chapter1.tex", [empty(0)], overwrite=True)


def test_an_empty_folder_is_used(tmp_path: Path) -> None:
    write(tmp_path, [empty(0)])
    assert len(read_run(tmp_path)) == 1


def test_additions_appear_with_the_run(tmp_path: Path, frames: list[Estimate]) -> None:
    folder = tmp_path / "run"
    with RunWriter(folder, DEPTH) as writer:
        writer.add(frames[3])
        staging = writer.finish_tables()
        writer.write_text("note.txt", f"{len(read_run(staging))} frame of 5 °")
        writer.write_json("metrics.json", {"rms_m": 0.5})
        with pytest.raises(RuntimeError, match="finish_tables"):
            writer.add(frames[4])
        with pytest.raises(ValueError, match="JSON"):
            writer.write_json("bad.json", {"rms_m": float("nan")})
        assert not folder.exists()
    assert (folder / "note.txt").read_text(encoding="utf-8") == "1 frame of 5 °"
    assert sorted(path.name for path in folder.iterdir()) == [
        *("covariances.npz", "measurements.csv", "metrics.json"),
        *("note.txt", "poses.tum", "states.csv"),
    ]


def test_half_an_estimate_is_refused(tmp_path: Path) -> None:
    whole = made()[3]
    for half in (
        replace(whole, T_cam_target=None),
        replace(whole, covariance=None),
        replace(whole, values={}),
    ):
        with pytest.raises(ValueError, match="together"):
            write(tmp_path / "run", [half])
    with pytest.raises(ValueError, match="shape"):
        write(tmp_path / "run", [replace(made()[3], covariance=np.eye(3))])


@pytest.mark.parametrize(
    ("name", "line", "column", "text", "told"),
    [
        ("states.csv", 0, 1, "r_X", "expected a column r_x_m"),
        ("states.csv", 4, 0, "", "line 5, time_s"),
        ("states.csv", 4, 2, "abc", "line 5, r_y_m: expected a number, got 'abc'"),
        ("states.csv", 4, 2, "", "line 5: expected all of the state or none"),
        ("states.csv", 4, 7, "5.0", "line 5: expected a unit quaternion"),
        ("states.csv", 0, 23, "sd_X", "expected a column sd_r_y_m"),
        ("states.csv", 4, -4, "1.5", "line 5, nis_dof: expected a whole number"),
        ("states.csv", 4, -1, "1,1", "line 5: expected 48 fields, got 49"),
        ("measurements.csv", 2, 2, "long", "line 3, length_m"),
        ("poses.tum", 0, 0, "99.0", "poses.tum: timestamp"),
        ("poses.tum", 0, 1, "x", "expected rows of numbers"),
    ],
)
def test_a_damaged_field_is_told_in_one_line(
    tmp_path: Path,
    frames: list[Estimate],
    name: str,
    line: int,
    column: int,
    text: str,
    told: str,
) -> None:
    frames = [replace(frame, records=frame.records[:1]) for frame in frames]
    frames = [
        replace(frame, records=tuple(replace(r, rectangle="a") for r in frame.records))
        for frame in frames
    ]
    write(tmp_path / "run", frames)
    path = tmp_path / "run" / name
    separator = " " if name.endswith(".tum") else ","
    lines = path.read_text().splitlines()
    fields = lines[line].split(separator)
    fields[column] = text
    lines[line] = separator.join(fields)
    path.write_text("\n".join(lines) + "\n")
    with pytest.raises(InputError) as raised:
        read_run(tmp_path / "run")
        read_records(tmp_path / "run")
    assert told in str(raised.value)
    assert name in str(raised.value)
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize("name", ["states.csv", "poses.tum", "covariances.npz", "measurements.csv"])
@pytest.mark.parametrize("content", [None, b"", b"\xff\xfe broken \x00"])
def test_a_missing_or_broken_file_is_told(
    tmp_path: Path, frames: list[Estimate], name: str, content: bytes | None
) -> None:
    write(tmp_path / "run", frames)
    path = tmp_path / "run" / name
    path.unlink()
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(InputError, match=name):
        read_run(tmp_path / "run", with_covariance=True)
        read_records(tmp_path / "run")


def test_an_unknown_compression_is_told(tmp_path: Path, frames: list[Estimate]) -> None:
    write(tmp_path / "run", frames)
    path = tmp_path / "run" / "covariances.npz"
    content = bytearray(path.read_bytes())
    entry = content.index(b"PK\x01\x02")
    content[entry + 10] = 99
    content[content.index(b"PK\x01\x02", entry + 1) + 10] = 99
    path.write_bytes(content)
    with pytest.raises(InputError, match="arrays P and time_s"):
        read_run(tmp_path / "run", with_covariance=True)


def test_covariances_of_another_run_are_refused(tmp_path: Path, frames: list[Estimate]) -> None:
    write(tmp_path / "run", frames)
    write(tmp_path / "other", frames[:4])
    (tmp_path / "other" / "covariances.npz").replace(tmp_path / "run" / "covariances.npz")
    assert read_run(tmp_path / "run").trajectory.covariance is None
    with pytest.raises(InputError, match=r"covariances.npz: P: expected \(5, 20, 20\)"):
        read_run(tmp_path / "run", with_covariance=True)


@given(
    name=st.none() | st.text(st.characters(codec="utf-8"), max_size=12),
    seed=st.integers(0, 2**63 - 1),
    sigma=st.floats(0.0, 1e300),
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
    assert {"pcnav", "python", "scipy", "open3d", "trimesh", "filterpy"} <= set(versions)
    assert "not installed" not in versions.values()
    assert f"# numpy {np.__version__}" in pipeline_toml(Pipeline(), versions)
