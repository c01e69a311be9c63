"""Recordings of feature tracks: what is written is read back, and what is wrong is named."""

import tracemalloc
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pcnav.core.camera import R_cam_hill
from pcnav.core.errors import InputError
from pcnav.core.stereo import StereoRig
from pcnav.dynamics.blocks import (
    ATTITUDE,
    CENTRE,
    MASS_CENTRE_LAYOUT,
    POSITION,
    RATE,
    RATIOS,
    VELOCITY,
)
from pcnav.dynamics.kepler import KeplerOrbit
from pcnav.dynamics.trajectory import Trajectory
from pcnav.recordings.opening import open_recording
from pcnav.recordings.stereo_tracks import (
    read_stereo_tracks,
    read_truth_features,
    write_stereo_tracks,
)
from pcnav.recordings.tracks import StereoTracks, TrackFrame
from pcnav.recordings.truth import read_truth

RIG = StereoRig(0.8, 900.0, (511.5, 383.5), (1024, 768), 0.1)
ORBIT = KeplerOrbit(0.001, 0.05, 0.3)
RIG_TOML = """
[rig]
baseline_m = 0.8
focal_px = 900
centre_px = [511.5, 383.5]
size_px = [1024, 768]
pixel_sigma_px = 0.1

[orbit]
mean_motion_rad_s = 0.001
eccentricity = 0.05
true_anomaly_deg = 20.0

[pointing]
boresight_hill = [1.0, 0.0, 0.0]
"""
HEADER = "time_s,feature,u_left,v_left,u_right,v_right\n"
GOOD = "0.0,0,500.0,400.0,450.0,400.0\n0.0,3,510.0,390.0,460.0,390.5\n"


def recording(folder: Path, rows: str, rig: str = RIG_TOML, header: str = HEADER) -> Path:
    """A folder with tracks.csv and rig.toml."""
    folder.mkdir(exist_ok=True)
    (folder / "tracks.csv").write_text(header + rows, encoding="utf-8")
    (folder / "rig.toml").write_text(rig, encoding="utf-8")
    return folder


def made_tracks() -> StereoTracks:
    """Three frames, the middle one empty, seen from an attitude of no particular direction."""
    rng = np.random.default_rng(1)
    frames = []
    for k, features in enumerate(([4, 0, 17], [], [17, 2])):
        R = Rotation.from_rotvec([0.3, -0.2, 0.1 * k]).as_matrix()
        pixels = rng.uniform(10.0, 500.0, (len(features), 4))
        pixels[:, 2] = pixels[:, 0] - 5.0
        frames.append(TrackFrame(0.1 * k, R, np.array(features, dtype=np.intp), pixels))
    return StereoTracks("made", RIG, ORBIT, tuple(frames))


def made_truth(frames: int = 3) -> Trajectory:
    ones = np.ones((frames, 3))
    values = {
        POSITION.name: 10 * ones,
        VELOCITY.name: 0.1 * ones,
        CENTRE.name: 0 * ones,
        ATTITUDE.name: np.tile(np.eye(3), (frames, 1, 1)),
        RATE.name: 0.2 * ones,
        RATIOS.name: np.tile([1.0, 0.8, 0.1, 0, 0], (frames, 1)),
    }
    return Trajectory(0.1 * np.arange(float(frames)), MASS_CENTRE_LAYOUT, values)


@pytest.mark.parametrize("by_file", [False, True])
def test_what_is_written_is_read_back(tmp_path: Path, by_file: bool) -> None:
    tracks = made_tracks()
    points = np.arange(9.0).reshape(3, 3)
    write_stereo_tracks(tmp_path / "made", tracks, made_truth(), points)
    path = tmp_path / "made" / "tracks.csv" if by_file else tmp_path / "made"
    found = open_recording(path)
    assert isinstance(found, StereoTracks)
    assert (found.name, found.rig) == ("made", RIG)
    assert found.orbit.true_anomaly_rad == pytest.approx(ORBIT.true_anomaly_rad, rel=1e-15)
    assert [frame.time_s for frame in found.frames] == [frame.time_s for frame in tracks.frames]
    for read, written in zip(found.frames, tracks.frames, strict=True):
        np.testing.assert_array_equal(read.features, written.features)
        np.testing.assert_array_equal(read.pixels, written.pixels)
        np.testing.assert_allclose(read.R_cam_world, written.R_cam_world, atol=1e-14)
    truth = read_truth(tmp_path / "made")
    assert truth is not None and RATE in truth
    np.testing.assert_array_equal(truth[RATE], made_truth()[RATE])
    features = read_truth_features(tmp_path / "made")
    assert features is not None
    np.testing.assert_array_equal(features[1], points[1])
    assert [path.name for path in tmp_path.iterdir()] == ["made"]


def test_a_recording_without_truth_has_none(tmp_path: Path) -> None:
    write_stereo_tracks(tmp_path / "made", made_tracks())
    assert read_truth(tmp_path / "made") is None
    assert read_truth_features(tmp_path / "made") is None


def test_a_folder_is_replaced_only_when_told(tmp_path: Path) -> None:
    out = tmp_path / "deep" / "made"
    write_stereo_tracks(out, made_tracks())
    with pytest.raises(InputError, match="overwrite"):
        write_stereo_tracks(out, made_tracks())
    write_stereo_tracks(out, made_tracks(), overwrite=True)
    other = tmp_path / "other"
    other.mkdir()
    (other / "thesis.txt").write_text("all of it")
    with pytest.raises(InputError, match=r"has no tracks\.csv"):
        write_stereo_tracks(other, made_tracks(), overwrite=True)
    assert (other / "thesis.txt").is_file()


def test_a_failed_write_leaves_nothing(tmp_path: Path) -> None:
    unordered = replace(made_truth(), values={})
    with pytest.raises(KeyError):
        write_stereo_tracks(tmp_path / "a" / "made", made_tracks(), unordered)
    assert list(tmp_path.iterdir()) == []


def test_a_rig_fixed_in_hill_axes_turns_with_them(tmp_path: Path) -> None:
    rows = GOOD + "900.0,,,,,\n"
    tracks = read_stereo_tracks(recording(tmp_path / "r", rows))
    forward, down = np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0])
    for frame in tracks.frames:
        R_hill_rig = tracks.orbit.R_hill_world(frame.time_s) @ frame.R_cam_world.T
        np.testing.assert_allclose(R_hill_rig[:, 2], forward, atol=1e-14)
        np.testing.assert_allclose(R_hill_rig[:, 1], down, atol=1e-14)
    assert not np.allclose(tracks.frames[0].R_cam_world, tracks.frames[1].R_cam_world, atol=0.1)
    assert len(tracks.frames[1].features) == 0
    assert tracks.frames[1].pixels.shape == (0, 4)


def test_an_image_looks_where_its_attitude_says() -> None:
    for direction in ([0, 0, 1], [0, 0, -2], [1, 1, 1], [-3, 0.2, 0.5]):
        forward = np.array(direction, dtype=float)
        R = R_cam_hill(forward)
        np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-14)
        assert np.linalg.det(R) == pytest.approx(1.0)
        np.testing.assert_allclose(R[2], forward / np.linalg.norm(forward), atol=1e-14)
        assert R[1, 2] >= 0.0  # image down has no part away from nadir


def test_recorded_attitudes_are_interpolated(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    folder = recording(tmp_path / "r", GOOD + "1.0,0,500.0,400.0,450.0,400.0\n")
    half = Rotation.from_rotvec([0.0, 0.0, 0.2])
    whole = Rotation.from_rotvec([0.0, 0.0, 0.4])
    lines = ["time_s,q_x,q_y,q_z,q_w", "-1.0,0,0,0,1"]
    lines.append(",".join(["3.0", *map(repr, whole.as_quat().tolist())]))
    # The second name is that of the last release.
    for name in ("camera_attitude.csv", "attitude.csv"):
        (folder / name).write_text("\n".join(lines), encoding="utf-8")
        with caplog.at_level("WARNING", "pcnav"):
            tracks = read_stereo_tracks(folder)
        np.testing.assert_allclose(tracks.frames[1].R_cam_world, half.as_matrix().T, atol=1e-12)
        assert ("the old name is read" in caplog.text) == (name == "attitude.csv")
        (folder / name).unlink()


BAD_ROWS = [
    ("", "tracks.csv: rows"),
    (GOOD + "0.1,1,500,400,450,nan\n", "line 4, v_right: expected a finite number"),
    (GOOD + "0.1,1,500,inf,450,400\n", "line 4, v_left: expected a finite number"),
    (GOOD + "0.1,1,500,400,450,\n", "line 4, v_right: expected a finite number"),
    (GOOD + "0.1,1,500,400,500,400\n", "line 4, u_right: expected a positive disparity"),
    (GOOD + "0.1,1,500,400,510,400\n", "line 4, u_right: expected a positive disparity"),
    (GOOD + "0.0,0,500,400,450,400\n", "line 4, feature: expected each feature once"),
    (GOOD + "-0.5,1,500,400,450,400\n", "line 4, time_s: expected times in order"),
    (GOOD + "0.1,1.5,500,400,450,400\n", "line 4, feature: expected a whole number"),
    (GOOD + "0.1,-1,500,400,450,400\n", "line 4, feature: expected a whole number"),
    (GOOD + "0.1,,500,400,450,400\n", "line 4, feature: expected a whole number"),
    (GOOD + "0.0,,,,,\n", "feature: expected no other row at a time without features"),
    (GOOD + "0.1,,,,,\n0.1,,,,,\n", "feature: expected no other row at a time without"),
    (GOOD + "nan,1,500,400,450,400\n", "line 4, time_s: expected a finite number"),
    (GOOD + "0.1,one,500,400,450,400\n", "line 4, feature: expected a number, got 'one'"),
    (GOOD + "0.1,1,500,400,450\n", "line 4: expected 6 fields, got 5"),
]


@pytest.mark.parametrize(("rows", "message"), BAD_ROWS)
def test_bad_rows_are_named_in_one_line(tmp_path: Path, rows: str, message: str) -> None:
    with pytest.raises(InputError) as caught:
        read_stereo_tracks(recording(tmp_path / "r", rows))
    assert message in str(caught.value)
    assert "tracks.csv" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_missing_columns_and_files_are_named(tmp_path: Path) -> None:
    short = "time_s,feature,u_left,v_left,u_right\n"
    with pytest.raises(InputError, match="header: expected a column v_right"):
        read_stereo_tracks(recording(tmp_path / "a", "", header=short))
    with pytest.raises(InputError, match=r"expected a folder with tracks\.csv"):
        read_stereo_tracks(tmp_path / "absent")
    folder = recording(tmp_path / "b", GOOD)
    (folder / "rig.toml").unlink()
    with pytest.raises(InputError, match=r"rig\.toml: file: expected a readable TOML file"):
        read_stereo_tracks(folder)


@pytest.mark.parametrize(
    ("old", "new", "field"),
    [
        ("baseline_m = 0.8", "baseline_m = 0.0", "rig.baseline_m"),
        ("focal_px = 900", "focal_px = nan", "rig.focal_px"),
        ("focal_px = 900\n", "", "rig.focal_px"),
        ("size_px = [1024, 768]", "size_px = [1024]", "rig.size_px"),
        ("pixel_sigma_px = 0.1", "pixel_sigma_px = -1.0", "rig.pixel_sigma_px"),
        ("eccentricity = 0.05", "eccentricity = 1.0", "orbit.eccentricity"),
        ("mean_motion_rad_s = 0.001", "mean_motion = 0.001", "orbit.mean_motion"),
        ("[1.0, 0.0, 0.0]", "[0.0, 0.0, 0.0]", "pointing.boresight_hill"),
        ("[pointing]\nboresight_hill = [1.0, 0.0, 0.0]", "", "pointing"),
        ("[rig]", "[rig", "file"),
    ],
)
def test_a_bad_rig_is_named_in_one_line(tmp_path: Path, old: str, new: str, field: str) -> None:
    assert old in RIG_TOML
    with pytest.raises(InputError) as caught:
        read_stereo_tracks(recording(tmp_path / "r", GOOD, RIG_TOML.replace(old, new)))
    assert caught.value.field.startswith(field)
    assert caught.value.file.name == "rig.toml"


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        ("", "rows: expected at least one row"),
        ("0.0,0,0,0,1\n0.0,0,0,0,1\n", "line 3, time_s: expected times that increase"),
        ("0.0,0,0,0,2\n", "line 2, q_x to q_w: expected a unit quaternion"),
        ("0.0,0,0,nan,1\n", "line 2, q_x to q_w: expected all four"),
        ("0.1,0,0,0,1\n", "time_s: expected times that cover"),
    ],
)
def test_bad_attitudes_are_named(tmp_path: Path, rows: str, message: str) -> None:
    folder = recording(tmp_path / "r", GOOD)
    text = "time_s,q_x,q_y,q_z,q_w\n" + rows
    (folder / "camera_attitude.csv").write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=r"camera_attitude\.csv") as caught:
        read_stereo_tracks(folder)
    assert message in str(caught.value)


@pytest.mark.parametrize(
    ("rows", "word"), [("0,1,2,nan\n", "finite"), ("0,1,2,3\n0,1,2,3\n", "once")]
)
def test_bad_true_features_are_named(tmp_path: Path, rows: str, word: str) -> None:
    (tmp_path / "truth_features.csv").write_text("feature,x_m,y_m,z_m\n" + rows)
    with pytest.raises(InputError, match=word):
        read_truth_features(tmp_path)


def test_memory_stays_within_a_few_times_the_numbers(tmp_path: Path) -> None:
    n = 20_000
    rows = "".join(f"{0.1 * (k // 10):.1f},{k % 10},500.5,400.25,450.125,400.5\n" for k in range(n))
    folder = recording(tmp_path / "r", rows)
    tracemalloc.start()
    tracks = read_stereo_tracks(folder)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert len(tracks.frames) == n // 10
    assert peak < 8 * n * 6 * 8  # eight times the numbers themselves
