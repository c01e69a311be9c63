"""Writing sequences and reading them and their truth back."""

import json
import tomllib
from collections.abc import Iterator
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pcnav.core.camera import PinholeCamera
from pcnav.core.distortion import Distortion, DistortionModel
from pcnav.core.errors import InputError
from pcnav.core.spatial import make_transform
from pcnav.dynamics.blocks import (
    ATTITUDE,
    CENTRE,
    MASS_CENTRE_LAYOUT,
    POSITION,
    RATE,
    RATIOS,
    VELOCITY,
)
from pcnav.dynamics.trajectory import Trajectory
from pcnav.recordings.bop import read_bop
from pcnav.recordings.calibration import NOT_STATED, Calibration
from pcnav.recordings.depth_form import DepthForm, DepthIs
from pcnav.recordings.sequence import Frame, InitialPrior, SequenceInfo
from pcnav.recordings.sequence_file import read_sequence_file, write_sequence_file
from pcnav.recordings.truth import read_truth
from pcnav.recordings.writer import write_sequence

CAMERA = PinholeCamera.from_field_of_view(12, 9, 0.4)
STEP_M = 0.001


def rotation(seed: int) -> np.ndarray:
    return Rotation.random(rng=np.random.default_rng(seed)).as_matrix()


def example_frame(k: int) -> Frame:
    rng = np.random.default_rng(k)
    depth_m = (np.rint(rng.uniform(5.0, 30.0, (9, 12)) / STEP_M) * STEP_M).astype(np.float32)
    depth_m[0] = 0.0
    T_cam_world = make_transform(rotation(k), rng.standard_normal(3))
    return Frame(k, k / 3.0, depth_m, CAMERA, T_cam_world)


def example_truth(frames: int = 4) -> Trajectory:
    rng = np.random.default_rng(100)
    r, v, com, omega = rng.standard_normal((4, frames, 3))
    values = {
        POSITION.name: r,
        VELOCITY.name: v,
        CENTRE.name: com,
        ATTITUDE.name: np.stack([rotation(50 + k) for k in range(frames)]),
        RATE.name: omega,
        RATIOS.name: rng.standard_normal((frames, 5)),
    }
    poses = [
        make_transform(rotation(200 + k), np.array([0.1 * k, -0.2, 20.0])) for k in range(frames)
    ]
    times_s = np.arange(frames) / 3.0
    return Trajectory(times_s, MASS_CENTRE_LAYOUT, values, T_cam_target=np.stack(poses))


def info() -> SequenceInfo:
    return SequenceInfo('näme "quoted"', 0.0011, 0.02, None)


def write(path: Path, frames: int = 4, overwrite: bool = False) -> None:
    made = (example_frame(k) for k in range(frames))
    write_sequence(path, info(), STEP_M, made, example_truth(frames), overwrite)


def test_round_trip(tmp_path: Path) -> None:
    mesh = tmp_path / "meshes" / "sat.ply"
    mesh.parent.mkdir()
    mesh.touch()
    prior = InitialPrior(com_model_m=(0.1, 0.2, -0.3), com_sd_m=(0.05,) * 3)
    stated = SequenceInfo('näme "quoted" \\', 0.0011, 0.02, mesh, prior)
    path = tmp_path / "out" / "deep" / "seq"

    def frames() -> Iterator[Frame]:
        for k in range(4):
            assert not path.exists()
            yield example_frame(k)

    write_sequence(path, stated, STEP_M, frames())
    sequence = read_bop(path)
    assert sequence.info.name == stated.name
    assert sequence.info.target_mesh == sequence.path / mesh.name
    assert sequence.info.target_mesh.read_bytes() == mesh.read_bytes()
    assert sequence.info.mean_motion_rad_s == 0.0011
    assert sequence.info.initial is not None
    np.testing.assert_array_equal(sequence.info.initial.com_model_m, [0.1, 0.2, -0.3])
    assert sequence.info.initial.inertia_ratios is None
    assert len(sequence) == 4
    for k, frame in enumerate(sequence):
        original = example_frame(k)
        assert (frame.index, frame.time_s, frame.camera) == (k, original.time_s, CAMERA)
        np.testing.assert_allclose(frame.depth_m, original.depth_m, rtol=2e-7)
        np.testing.assert_allclose(frame.T_cam_world, original.T_cam_world, atol=1e-14)
    assert read_truth(path) is None
    assert sorted(p.name for p in path.parent.iterdir()) == ["seq"]


def test_how_well_the_camera_is_known_comes_back(tmp_path: Path) -> None:
    stated = Calibration(0.002, 0.5, mount_attitude_sd_rad=0.01, time_offset_sd_s=0.003)
    write_sequence(
        tmp_path / "seq", replace(info(), calibration=stated), STEP_M, map(example_frame, range(2))
    )
    found = read_bop(tmp_path / "seq").info.calibration
    assert found is not None
    assert asdict(found) == pytest.approx(asdict(stated), rel=1e-12)
    write(tmp_path / "silent", 2)
    assert read_bop(tmp_path / "silent").info.calibration is None
    file = tmp_path / "silent" / "sequence.toml"
    file.write_text(file.read_text(encoding="utf-8") + "\n[calibration]\nfocal_sd = 0.0\n")
    partly = read_bop(tmp_path / "silent").info.calibration
    # What is not stated is as of a recording that says nothing.
    assert partly == replace(NOT_STATED, focal_sd=0.0)


def test_files_are_a_plain_bop_scene(tmp_path: Path) -> None:
    write(tmp_path / "seq", frames=3)
    cameras = json.loads((tmp_path / "seq" / "scene_camera.json").read_text())
    poses = json.loads((tmp_path / "seq" / "scene_gt.json").read_text())
    assert list(cameras) == list(poses) == ["0", "1", "2"]
    frame = example_frame(2)
    assert cameras["2"]["cam_K"] == CAMERA.matrix.ravel().tolist()
    assert cameras["2"]["depth_scale"] == 1.0
    np.testing.assert_allclose(cameras["2"]["cam_t_w2c"], 1000.0 * frame.T_cam_world[:3, 3])
    np.testing.assert_allclose(np.reshape(cameras["2"]["cam_R_w2c"], (3, 3)), rotation(2))
    assert poses["2"][0]["obj_id"] == 1
    np.testing.assert_allclose(poses["2"][0]["cam_t_m2c"], [200.0, -200.0, 20000.0])
    tables = tomllib.loads((tmp_path / "seq" / "sequence.toml").read_text(encoding="utf-8"))
    assert tables["sequence"]["name"] == info().name
    header = (tmp_path / "seq" / "truth.csv").read_text().splitlines()[0]
    assert header == (
        "time_s,r_x_m,r_y_m,r_z_m,v_x_m_s,v_y_m_s,v_z_m_s,q_x,q_y,q_z,q_w,"
        "w_x_rad_s,w_y_rad_s,w_z_rad_s,com_x_m,com_y_m,com_z_m,i_yy,i_zz,i_xy,i_xz,i_yz"
    )


def test_sensor_round_trip(tmp_path: Path) -> None:
    stated = SequenceInfo(
        *("näme", 0.0, None, None),
        camera_position_sd_m=0.002,
        camera_attitude_sd_rad=0.001,
        row_readout_s=0.01,
    )
    form = DepthForm(65535, DepthIs.RANGE, DistortionModel.OPENCV, (0.1, 0.2, 0.0, 0.0, -0.1))
    write_sequence_file(tmp_path / "sequence.toml", stated, form)
    read, form_read = read_sequence_file(tmp_path / "sequence.toml")
    assert form_read == form
    assert read.range_sigma_m is None
    assert (read.camera_position_sd_m, read.row_readout_s) == (0.002, 0.01)
    assert read.camera_attitude_sd_rad == pytest.approx(0.001, rel=1e-14)


def test_unseen_pixels_are_strided_with_their_frame() -> None:
    unseen = np.zeros((9, 12), dtype=bool)
    unseen[4, 6] = unseen[1, 1] = True
    frame = replace(example_frame(0), unseen=unseen).strided(2)
    assert frame.unseen is not None
    assert frame.unseen.shape == frame.depth_m.shape == (5, 6)
    assert np.argwhere(frame.unseen).tolist() == [[2, 3]]


def test_truth_round_trip(tmp_path: Path) -> None:
    write(tmp_path / "seq")
    truth = read_truth(tmp_path / "seq")
    assert truth is not None
    assert truth.T_cam_target is not None
    expected = example_truth()
    np.testing.assert_array_equal(truth.time_s, expected.time_s)
    for block in (POSITION, VELOCITY, CENTRE, RATE, RATIOS):
        np.testing.assert_array_equal(truth[block], expected[block])
    np.testing.assert_allclose(truth[ATTITUDE], expected[ATTITUDE], atol=1e-14)
    np.testing.assert_allclose(truth.T_cam_target, expected.poses, atol=1e-13)


def test_partial_truth(tmp_path: Path) -> None:
    write(tmp_path / "seq")
    (tmp_path / "seq" / "truth.csv").rename(tmp_path / "truth.csv")
    poses_only = read_truth(tmp_path / "seq")
    assert poses_only is not None
    assert POSITION not in poses_only
    assert poses_only.T_cam_target is not None
    assert poses_only.T_cam_target.shape == (4, 4, 4)
    # A scene whose second frame shows nothing has truth at the other times.
    file = tmp_path / "seq" / "scene_gt.json"
    content = json.loads(file.read_text())
    content["1"] = []
    content["2"][0]["obj_id"] = 7
    content["3"].append({**content["3"][0], "obj_id": 5})
    file.write_text(json.dumps(content))
    some = read_truth(tmp_path / "seq")
    assert some is not None
    np.testing.assert_array_equal(some.time_s, np.array([0, 2, 3]) / 3.0)
    content["3"][0]["obj_id"] = 5
    file.write_text(json.dumps(content))
    # Twice object 5: none of them is told, and the truth is optional.
    some = read_truth(tmp_path / "seq")
    assert some is not None
    np.testing.assert_array_equal(some.time_s, np.array([0, 2]) / 3.0)
    file.unlink()
    (tmp_path / "truth.csv").rename(tmp_path / "seq" / "truth.csv")
    states_only = read_truth(tmp_path / "seq")
    assert states_only is not None
    assert states_only.T_cam_target is None
    assert POSITION in states_only


@pytest.mark.parametrize("own_time", [False, True])
@pytest.mark.parametrize("has_poses", [False, True])
def test_truth_of_frames_whose_stamps_repeat(
    tmp_path: Path, own_time: bool, has_poses: bool
) -> None:
    """A camera that stamps frame 2 as frame 1; the truth knows better, or does not."""
    write(tmp_path / "seq")
    expected = read_truth(tmp_path / "seq")
    assert expected is not None
    cameras = tmp_path / "seq" / "scene_camera.json"
    content = json.loads(cameras.read_text())
    content["2"]["timestamp_s"] = content["1"]["timestamp_s"]
    cameras.write_text(json.dumps(content))
    file = tmp_path / "seq" / "truth.csv"
    rows = file.read_text().splitlines()
    if not own_time:
        rows[3] = ",".join([rows[2].split(",")[0], *rows[3].split(",")[1:]])
    file.write_text("\n".join(rows))
    if not has_poses:
        (tmp_path / "seq" / "scene_gt.json").unlink()
    truth = read_truth(tmp_path / "seq")
    assert truth is not None
    assert len(read_bop(tmp_path / "seq")) == 3
    kept = [0, 1, 3] if has_poses or not own_time else [0, 1, 2, 3]
    np.testing.assert_allclose(truth.time_s, expected.time_s[kept])
    np.testing.assert_array_equal(truth[POSITION], expected[POSITION][kept])
    if has_poses:
        assert expected.T_cam_target is not None
        np.testing.assert_array_equal(truth.T_cam_target, expected.T_cam_target[kept])


@pytest.mark.parametrize(
    ("line", "column", "value", "words"),
    [
        (2, 3, "nan", "finite"),
        (3, 5, "fast", "a number, got 'fast'"),
        (1, 7, "3.0", "unit quaternion"),
        (2, 0, "0.0", "times that increase"),
        (4, 0, "9.0", "times of the frames"),
        (0, 1, "r_m", "a column r_x_m"),
    ],
)
def test_truth_faults(tmp_path: Path, line: int, column: int, value: str, words: str) -> None:
    write(tmp_path / "seq")
    file = tmp_path / "seq" / "truth.csv"
    rows = [row.split(",") for row in file.read_text().splitlines()]
    rows[line][column] = value
    file.write_text("\n".join(",".join(row) for row in rows))
    with pytest.raises(InputError, match=words) as caught:
        read_truth(tmp_path / "seq")
    assert caught.value.file == file


def test_existing_folder_is_kept_unless_told(tmp_path: Path) -> None:
    path = tmp_path / "seq"
    write(path, frames=3)
    with pytest.raises(InputError, match="--overwrite"):
        write(path)
    assert len(read_bop(path)) == 3
    write(path, frames=2, overwrite=True)
    assert len(read_bop(path)) == 2
    # The old frames are gone, and so are the temporary folders.
    assert len(list((path / "depth").iterdir())) == 2
    assert [p.name for p in tmp_path.iterdir()] == ["seq"]


def test_only_sequences_are_ever_replaced(tmp_path: Path) -> None:
    precious = tmp_path / "home"
    precious.mkdir()
    (precious / "thesis.txt").write_text("kept")
    with pytest.raises(InputError, match=r"has no scene_camera\.json"):
        write(precious, overwrite=True)
    assert (precious / "thesis.txt").read_text() == "kept"
    file = tmp_path / "file"
    file.touch()
    with pytest.raises(InputError, match="this is a file"):
        write(file, overwrite=True)
    with pytest.raises(InputError, match="place that can be written"):
        write(file / "seq")
    (tmp_path / "empty").mkdir()
    write(tmp_path / "empty")
    assert len(read_bop(tmp_path / "empty")) == 4


def test_nothing_is_left_after_an_exception(tmp_path: Path) -> None:
    path = tmp_path / "new" / "seq"
    for error in (RuntimeError, KeyboardInterrupt):
        with pytest.raises(error):
            write_sequence(path, info(), STEP_M, interrupted(error))
        assert list(tmp_path.iterdir()) == []
    with pytest.raises(ValueError, match="no frame"):
        write_sequence(path, info(), STEP_M, [])
    assert list(tmp_path.iterdir()) == []
    # A failed replacement leaves the old sequence whole.
    write(path, frames=3)
    with pytest.raises(RuntimeError):
        write_sequence(path, info(), STEP_M, interrupted(RuntimeError), overwrite=True)
    assert len(read_bop(path)) == 3
    assert [p.name for p in path.parent.iterdir()] == ["seq"]


def interrupted(error: type[BaseException]) -> Iterator[Frame]:
    yield example_frame(0)
    raise error


def test_misuse_and_depth_out_of_range(tmp_path: Path) -> None:
    far = example_frame(0)
    far.depth_m[4, 4] = 66.0
    with pytest.raises(InputError, match=r"between 0 and 65\.535 m .* got 66 m in frame 0"):
        write_sequence(tmp_path / "a", info(), STEP_M, [far])
    with pytest.raises(ValueError, match="frame 0 after frame 1"):
        write_sequence(tmp_path / "a", info(), STEP_M, [example_frame(1), example_frame(0)])
    with pytest.raises(ValueError, match="zip"):
        write_sequence(tmp_path / "a", info(), STEP_M, [example_frame(0)], example_truth(2))


def test_a_lens_travels_with_the_frames(tmp_path: Path) -> None:
    lens = Distortion(DistortionModel.OPENCV, (-0.2, 0.05, 0.001, 0.0, 0.01))
    frames = [replace(example_frame(k), camera=replace(CAMERA, distortion=lens)) for k in range(2)]
    write_sequence(tmp_path / "bent", info(), STEP_M, frames)
    for read, written in zip(read_bop(tmp_path / "bent"), frames, strict=True):
        assert read.camera == written.camera
        assert read.unseen is None
        np.testing.assert_allclose(read.depth_m, written.depth_m, rtol=1e-6)
    with pytest.raises(ValueError, match="several lenses"):
        write_sequence(tmp_path / "two", info(), STEP_M, [frames[0], example_frame(1)])


def test_pixels_that_no_lens_model_describes_are_unseen(tmp_path: Path) -> None:
    lens = Distortion(DistortionModel.OPENCV, (-0.3, 0.0, 0.0, 0.0, 0.0))
    camera = replace(CAMERA, fx=8.0, fy=8.0, distortion=lens)
    write_sequence(tmp_path / "wide", info(), STEP_M, [replace(example_frame(0), camera=camera)])
    (frame,) = read_bop(tmp_path / "wide")
    # The polynomial folds at 0.703 focal lengths.
    v, u = np.indices((9, 12))
    outside = np.hypot(u - camera.cx, v - camera.cy) > 0.703 * 8.0
    assert frame.unseen is not None
    np.testing.assert_array_equal(frame.unseen, outside)
    assert not frame.depth_m[outside].any()
    assert frame.depth_m[~outside].any()
