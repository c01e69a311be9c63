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
from pcnav.core.errors import InputError
from pcnav.core.spatial import exp_rotation, make_transform
from pcnav.dynamics.state import NavigationState
from pcnav.runs.provenance import library_versions, pipeline_toml
from pcnav.runs.result_writer import ResultWriter
from pcnav.runs.results import (
    ACCEPTED,
    FrameEstimate,
    RectangleRecord,
    read_measurements,
    read_track,
)


def estimate(index: int, generator: np.random.Generator) -> FrameEstimate:
    """A frame of arbitrary numbers with all their digits."""
    draw = generator.standard_normal
    factor = draw((20, 20))
    state = NavigationState(
        r_hill=draw(3) * 1e3,
        v_hill=draw(3) * 1e-7,
        com_model=draw(3),
        R_world_body=exp_rotation(draw(3)),
        omega_body=draw(3) / 3.0,
        inertia_ratios=draw(5),
    )
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
    return FrameEstimate(
        index=index,
        time_s=index / 3.0,
        state=state,
        covariance=factor @ factor.T,
        T_cam_model=make_transform(exp_rotation(draw(3)), draw(3) * 20.0),
        status="locked",
        nis=float(generator.chisquare(6)),
        nis_dof=6,
        n_rectangles=1,
        records=(record, unknown),
        inlier_ratio=float(generator.uniform()),
        window_nis=float(generator.chisquare(60)) / 60.0,
    )


def empty(index: int) -> FrameEstimate:
    """A frame before anything is known."""
    return FrameEstimate(index, index / 3.0, None, None, None, "acquiring", np.nan, 0, 0, ())


def write(folder: Path, estimates: list[FrameEstimate], overwrite: bool = False) -> None:
    with ResultWriter(folder, overwrite) as writer:
        for each in estimates:
            writer.add(each)


@pytest.fixture
def frames() -> list[FrameEstimate]:
    generator = np.random.default_rng(3)
    return [empty(0), empty(1), *(estimate(i, generator) for i in range(2, 7)), empty(7)]


def test_round_trip_keeps_every_bit(tmp_path: Path, frames: list[FrameEstimate]) -> None:
    write(tmp_path / "run", frames)
    track = read_track(tmp_path / "run", with_covariance=True)
    assert len(track) == len(frames)
    assert track.time_s.tolist() == [frame.time_s for frame in frames]
    assert track.has_estimate.tolist() == [frame.state is not None for frame in frames]
    assert track.status == tuple(frame.status for frame in frames)
    assert track.covariance is not None
    for i, frame in enumerate(frames):
        assert track.nis_dof[i] == frame.nis_dof
        assert track.n_rectangles[i] == frame.n_rectangles
        np.testing.assert_array_equal(track.nis[i], frame.nis)
        np.testing.assert_array_equal(track.window_nis[i], frame.window_nis)
        np.testing.assert_array_equal(track.inlier_ratio[i], frame.inlier_ratio)
        if frame.state is None or frame.covariance is None or frame.T_cam_model is None:
            assert np.isnan(track.covariance[i]).all()
            assert np.isnan(track.T_cam_model[i]).all()
            assert track.state(i) is None
            continue
        state = track.state(i)
        assert state is not None
        for name in ("r_hill", "v_hill", "com_model", "omega_body", "inertia_ratios"):
            np.testing.assert_array_equal(getattr(state, name), getattr(frame.state, name))
        # Rotations pass through a quaternion: equal to rounding, not to the bit.
        np.testing.assert_allclose(state.R_world_body, frame.state.R_world_body, atol=2e-15)
        np.testing.assert_allclose(track.T_cam_model[i], frame.T_cam_model, atol=2e-15)
        np.testing.assert_array_equal(track.T_cam_model[i, :3, 3], frame.T_cam_model[:3, 3])
        np.testing.assert_array_equal(track.covariance[i], frame.covariance)
        np.testing.assert_array_equal(track.sd[i], np.sqrt(np.diagonal(frame.covariance)))


def test_measurements_round_trip(tmp_path: Path, frames: list[FrameEstimate]) -> None:
    write(tmp_path / "run", frames)
    written = [record for frame in frames for record in frame.records]
    read = read_measurements(tmp_path / "run")
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
    assert np.isnan(read_measurements(tmp_path / "run")[0].T_cam_rect[:3]).all()


def test_evo_reads_the_poses(tmp_path: Path, frames: list[FrameEstimate]) -> None:
    write(tmp_path / "run", frames)
    trajectory = file_interface.read_tum_trajectory_file(str(tmp_path / "run" / "poses.tum"))
    expected = [frame for frame in frames if frame.T_cam_model is not None]
    assert trajectory.num_poses == len(expected) == 5
    for i, frame in enumerate(expected):
        assert frame.T_cam_model is not None
        assert trajectory.timestamps[i] == frame.time_s
        np.testing.assert_allclose(trajectory.poses_se3[i], frame.T_cam_model, atol=1e-14)


def test_columns_are_those_of_the_documented_format(
    tmp_path: Path, frames: list[FrameEstimate]
) -> None:
    write(tmp_path / "run", frames)
    with (tmp_path / "run" / "states.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    frame = frames[3]
    assert frame.state is not None and frame.covariance is not None
    row = rows[3]
    assert float(row["com_y_m"]) == frame.state.com_model[1]
    assert float(row["sd_com_y_m"]) ** 2 == pytest.approx(frame.covariance[7, 7], rel=1e-14)
    assert float(row["sd_theta_x_rad"]) ** 2 == pytest.approx(frame.covariance[9, 9], rel=1e-14)
    assert float(row["sd_w_z_rad_s"]) ** 2 == pytest.approx(frame.covariance[14, 14], rel=1e-14)
    assert float(row["sd_i_yz"]) ** 2 == pytest.approx(frame.covariance[19, 19], rel=1e-14)
    assert float(row["window_nis"]) == frame.window_nis
    assert float(row["inlier_ratio"]) == frame.inlier_ratio
    assert rows[0]["r_x_m"] == rows[0]["nis"] == ""
    assert rows[0]["window_nis"] == rows[0]["inlier_ratio"] == ""


def test_a_run_without_frames_or_estimates_is_still_a_run(tmp_path: Path) -> None:
    write(tmp_path / "none", [])
    write(tmp_path / "unknown", [empty(0), empty(1)])
    assert len(read_track(tmp_path / "none", with_covariance=True)) == 0
    assert not read_track(tmp_path / "unknown", with_covariance=True).has_estimate.any()
    assert read_measurements(tmp_path / "unknown") == ()


def test_memory_does_not_grow_with_the_run(tmp_path: Path) -> None:
    frame = estimate(0, np.random.default_rng(0))
    with ResultWriter(tmp_path / "run") as writer:
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


def test_an_exception_leaves_nothing(tmp_path: Path, frames: list[FrameEstimate]) -> None:
    with (
        pytest.raises(KeyboardInterrupt),
        ResultWriter(tmp_path / "new" / "deep" / "run") as writer,
    ):
        writer.add(frames[3])
        raise KeyboardInterrupt
    assert list(tmp_path.iterdir()) == []


def test_an_earlier_run_survives_until_the_new_one_is_complete(
    tmp_path: Path, frames: list[FrameEstimate]
) -> None:
    folder = tmp_path / "run"
    write(folder, frames)
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    with pytest.raises(InputError, match="overwrite"):
        write(folder, frames[:2])
    with pytest.raises(RuntimeError, match="fault"), ResultWriter(folder, True) as writer:
        writer.add(frames[3])
        raise RuntimeError("fault")
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before
    assert [path.name for path in tmp_path.iterdir()] == ["run"]
    with ResultWriter(folder, overwrite=True) as writer:
        writer.add(frames[3])
        writer.finish_tables()
        assert {path.name: path.read_bytes() for path in folder.iterdir()} == before
    assert len(read_track(folder)) == 1
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
    assert len(read_track(tmp_path)) == 1


def test_additions_appear_with_the_run(tmp_path: Path, frames: list[FrameEstimate]) -> None:
    folder = tmp_path / "run"
    with ResultWriter(folder) as writer:
        writer.add(frames[3])
        staging = writer.finish_tables()
        writer.write_text("note.txt", f"{len(read_track(staging))} frame of 5 °")
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


def test_half_an_estimate_is_refused() -> None:
    frame = estimate(0, np.random.default_rng(0))
    with pytest.raises(ValueError, match="together"):
        replace(frame, T_cam_model=None)


@pytest.mark.parametrize(
    ("name", "line", "column", "text", "told"),
    [
        ("states.csv", 0, 1, "r_X", "expected a column r_x_m"),
        ("states.csv", 4, 0, "", "line 5, time_s"),
        ("states.csv", 4, 2, "abc", "line 5, r_y_m: expected a number, got 'abc'"),
        ("states.csv", 4, 2, "", "line 5: expected all of the state or none"),
        ("states.csv", 4, 7, "5.0", "line 5: expected a unit quaternion"),
        ("states.csv", 4, -1, "1.5", "line 5, n_rectangles"),
        ("states.csv", 4, -1, "1,1", "line 5: expected 48 fields, got 49"),
        ("measurements.csv", 2, 2, "long", "line 3, length_m"),
        ("poses.tum", 0, 0, "99.0", "poses.tum: timestamp"),
        ("poses.tum", 0, 1, "x", "expected rows of numbers"),
    ],
)
def test_a_damaged_field_is_told_in_one_line(
    tmp_path: Path,
    frames: list[FrameEstimate],
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
        read_track(tmp_path / "run")
        read_measurements(tmp_path / "run")
    assert told in str(raised.value)
    assert name in str(raised.value)
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize("column", ["window_nis", "inlier_ratio"])
def test_a_folder_without_the_evidence_of_the_status_is_told(
    tmp_path: Path, frames: list[FrameEstimate], column: str
) -> None:
    """As versions that did not store it have written them."""
    write(tmp_path / "run", frames)
    path = tmp_path / "run" / "states.csv"
    with path.open(newline="") as file:
        rows = list(csv.reader(file))
    position = rows[0].index(column)
    with path.open("w", newline="") as file:
        csv.writer(file).writerows(row[:position] + row[position + 1 :] for row in rows)
    with pytest.raises(InputError) as raised:
        read_track(tmp_path / "run")
    assert str(raised.value).endswith(f"states.csv: header: expected a column {column}")
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize("name", ["states.csv", "poses.tum", "covariances.npz", "measurements.csv"])
@pytest.mark.parametrize("content", [None, b"", b"\xff\xfe broken \x00"])
def test_a_missing_or_broken_file_is_told(
    tmp_path: Path, frames: list[FrameEstimate], name: str, content: bytes | None
) -> None:
    write(tmp_path / "run", frames)
    path = tmp_path / "run" / name
    path.unlink()
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(InputError, match=name):
        read_track(tmp_path / "run", with_covariance=True)
        read_measurements(tmp_path / "run")


def test_covariances_of_another_run_are_refused(
    tmp_path: Path, frames: list[FrameEstimate]
) -> None:
    write(tmp_path / "run", frames)
    write(tmp_path / "other", frames[:4])
    (tmp_path / "other" / "covariances.npz").replace(tmp_path / "run" / "covariances.npz")
    assert read_track(tmp_path / "run").covariance is None
    with pytest.raises(InputError, match=r"covariances.npz: P: expected \(5, 20, 20\)"):
        read_track(tmp_path / "run", with_covariance=True)


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
