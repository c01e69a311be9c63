"""``pcnav export``: what public readers, and the rules of the formats, make of what is written."""

import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from evo.tools import file_interface
from oem import OrbitEphemerisMessage
from rosbags.highlevel import AnyReader
from scipy.spatial.transform import Rotation

from pcnav.core.arrays import FloatArray
from pcnav.dynamics.state import NavigationState
from pcnav.runs.export.content import exported
from pcnav.runs.export.pose_covariance import pose_covariances
from pcnav.runs.reader import read_run
from tests.cli.answers import expect_refusal, satellite
from tests.commands import Answer, Pcnav
from tests.made_runs import made_run

EPOCH = "2026-03-01T12:00:00.25"
Written = Callable[..., Path]


@pytest.fixture
def write(pcnav: Pcnav, recorded: Path, tmp_path: Path) -> Written:
    """Export the recorded run to a format; its file."""

    def written(to: str, *more: str) -> Path:
        out = tmp_path / f"x.{to}"
        answer = pcnav("export", recorded / "result", "--to", to, "-o", out, *more)
        assert answer.code == 0, answer
        return out

    return written


@pytest.fixture
def poses(recorded: Path) -> FloatArray:
    """(m, 4, 4) T_cam_model of the frames with an estimate."""
    run = read_run(recorded / "result")
    return run.trajectory.poses[run.has_estimate]


def true_poses(recorded: Path) -> FloatArray:
    """(n, 4, 4) as scene_gt.json has them."""
    entries = json.loads((recorded / "sequence" / "scene_gt.json").read_text()).values()
    T = np.tile(np.eye(4), (len(entries), 1, 1))
    T[:, :3, :3] = [np.reshape(objects[0]["cam_R_m2c"], (3, 3)) for objects in entries]
    T[:, :3, 3] = [np.array(objects[0]["cam_t_m2c"]) / 1000.0 for objects in entries]
    return T


def test_evo_reads_poses_and_truth(write: Written, poses: FloatArray, recorded: Path) -> None:
    tum = file_interface.read_tum_trajectory_file(write("tum"))
    assert np.allclose(tum.poses_se3, poses, atol=1e-12)
    true = file_interface.read_tum_trajectory_file(
        write("tum", "--overwrite").with_name("x.truth.tum")
    )
    assert np.allclose(true.poses_se3, true_poses(recorded), atol=1e-12)
    assert np.allclose(true.timestamps, 0.25 * np.arange(6))
    kitti = write("kitti")
    assert np.allclose(file_interface.read_kitti_poses_file(kitti).poses_se3, poses, atol=1e-12)
    beside = file_interface.read_kitti_poses_file(kitti.with_name("x.truth.kitti"))
    assert np.allclose(beside.poses_se3, true_poses(recorded)[-len(poses) :], atol=1e-12)
    times = kitti.with_name("x.times.kitti").read_text().split()
    assert np.allclose(np.array(times, dtype=float), tum.timestamps)


def test_bop_results_score_by_the_rules_of_the_challenge(
    write: Written, recorded: Path, boxsat_vertices: FloatArray
) -> None:
    lines = write("bop").read_text().splitlines()
    assert lines[0] == "scene_id,im_id,obj_id,score,R,t,time"
    truth, errors_mm = true_poses(recorded), []
    for line in lines[1:]:
        scene, image, target, score, R, t, time = line.split(",")
        assert (scene, target, time) == ("1", "1", "-1")
        assert 0.0 <= float(score) <= 1.0
        R_estimate = np.array(R.split(), dtype=float).reshape(3, 3)
        t_estimate = np.array(t.split(), dtype=float)
        # MSSD of an object without symmetry, in mm as the models of the challenge are.
        vertices, true = 1000.0 * boxsat_vertices, truth[int(image)]
        off = vertices @ R_estimate.T + t_estimate
        off -= vertices @ true[:3, :3].T + 1000.0 * true[:3, 3]
        errors_mm.append(float(np.linalg.norm(off, axis=1).max()))
    assert len(errors_mm) >= 3
    # Right at the strictest threshold of the challenge, 5 % of the diameter.
    diameter_mm = 1000.0 * float(np.linalg.norm(np.ptp(boxsat_vertices, axis=0)))
    assert max(errors_mm) < 0.05 * diameter_mm
    assert max(errors_mm) > 0.1, "the estimate, not the truth"


@pytest.fixture
def boxsat_vertices() -> FloatArray:
    lines = satellite("boxsat").read_text().splitlines()
    rows = [line.split()[1:4] for line in lines if line.startswith("v ")]
    return np.array(rows, dtype=np.float64)


RATE_RAD_S = 0.05


@pytest.fixture
def on_orbit(recorded: Path, tmp_path: Path) -> Path:
    """The recording, of a chaser on an orbit so low that its turn shows within a second."""
    copy = tmp_path / "on_orbit"
    shutil.copytree(recorded / "sequence", copy)
    text = (copy / "sequence.toml").read_text()
    rate = f"mean_motion_rad_s = {RATE_RAD_S}"
    (copy / "sequence.toml").write_text(text.replace("mean_motion_rad_s = 0.0", rate))
    return copy


def R_rtn_world(time_s: float) -> FloatArray:
    """(3, 3) from world axes to zenith, along-track and orbit normal, by hand.

    At time 0 world is x along-track, y minus normal, z nadir; the orbit turns zenith to x.
    """
    a = RATE_RAD_S * time_s
    along = np.array([np.cos(a), 0.0, np.sin(a)])
    zenith = np.array([np.sin(a), 0.0, -np.cos(a)])
    return np.stack([zenith, along, np.cross(zenith, along)])


def world_poses(recorded: Path) -> FloatArray:
    """(n, 4, 4) T_world_cam."""
    entries = json.loads((recorded / "sequence" / "scene_camera.json").read_text()).values()
    T = np.tile(np.eye(4), (len(entries), 1, 1))
    T[:, :3, :3] = [np.reshape(each["cam_R_w2c"], (3, 3)) for each in entries]
    T[:, :3, 3] = [np.array(each["cam_t_w2c"]) / 1000.0 for each in entries]
    return np.asarray(np.linalg.inv(T))


def test_the_orbit_message_says_where_the_mass_centre_is(
    write: Written, poses: FloatArray, recorded: Path
) -> None:
    message = OrbitEphemerisMessage.open(write("oem", "--epoch", EPOCH))
    (segment,) = message.segments
    assert segment.metadata["CENTER_NAME"] == "CHASER"
    assert (segment.metadata["REF_FRAME"], segment.metadata["TIME_SYSTEM"]) == ("WORLD", "UTC")
    run = read_run(recorded / "result")
    frames = np.flatnonzero(run.has_estimate)
    states = list(segment.states)
    assert len(states) == len(frames)
    cameras, values = world_poses(recorded), run.trajectory.values
    for state, T, k in zip(states, poses, frames, strict=True):
        assert state.epoch.isot == f"2026-03-01T12:00:{0.25 + run.time_s[k]:09.6f}"
        p_world = (cameras[k] @ T @ np.append(values["com_model"][k], 1.0))[:3]
        assert np.allclose(1000.0 * np.array(state.position), p_world, atol=1e-9)
        assert np.allclose(1000.0 * np.array(state.velocity), values["v_hill"][k])


def test_on_an_orbit_the_message_speaks_of_radial_transverse_and_normal(
    write: Written, recorded: Path, on_orbit: Path
) -> None:
    path = write("oem", "--epoch", EPOCH, "--sequence", str(on_orbit))
    (segment,) = OrbitEphemerisMessage.open(path).segments
    assert segment.metadata["REF_FRAME"] == "RTN"
    motion = read_run(recorded / "result", with_covariance=True).trajectory
    frames = np.flatnonzero(motion.has_estimate)
    states, covariances = list(segment.states), list(segment.covariances)
    assert len(states) == len(covariances) == len(frames)
    for state, k in zip(states, frames, strict=True):
        for found, block in ((state.position, "r_hill"), (state.velocity, "v_hill")):
            along, minus_normal, nadir = motion.values[block][k]
            assert np.allclose(1000.0 * np.array(found), [-nadir, along, -minus_normal])
    assert motion.covariance is not None
    P, last = motion.covariance[-1], 1e6 * np.array(covariances[-1].matrix)
    assert np.allclose(np.diagonal(last), np.diagonal(P)[[2, 0, 1, 5, 3, 4]], rtol=1e-9)
    assert np.isclose(last[1, 0], -P[0, 2])
    assert np.isclose(last[5, 1], -P[4, 0])


def test_the_attitude_message_carries_the_frame_into_the_body(
    write: Written, poses: FloatArray, recorded: Path, on_orbit: Path
) -> None:
    text = write("aem", "--epoch", EPOCH, "--sequence", str(on_orbit)).read_text()
    pairs = dict(line.split(" = ") for line in text.splitlines() if " = " in line)
    assert text.startswith("CCSDS_AEM_VERS = 1.0\n")
    assert (pairs["REF_FRAME_A"], pairs["REF_FRAME_B"]) == ("RTN", "SC_BODY_1")
    assert (pairs["ATTITUDE_DIR"], pairs["QUATERNION_TYPE"]) == ("A2B", "LAST")
    data = text.split("DATA_START\n")[1].split("DATA_STOP")[0].splitlines()
    run, cameras = read_run(recorded / "result"), world_poses(recorded)
    frames = np.flatnonzero(run.has_estimate)
    assert [line.split()[0] for line in (data[0], data[-1])] == [
        pairs["START_TIME"],
        pairs["STOP_TIME"],
    ]
    for line, T, k in zip(data, poses, frames, strict=True):
        q1, q2, q3, qc = (float(word) for word in line.split()[1:])
        # The matrix of 504.0-B-1 from a quaternion, which takes components in A to those in B.
        M = np.array(
            [
                [q1**2 - q2**2 - q3**2 + qc**2, 2 * (q1 * q2 + q3 * qc), 2 * (q1 * q3 - q2 * qc)],
                [
                    2 * (q1 * q2 - q3 * qc),
                    -(q1**2) + q2**2 - q3**2 + qc**2,
                    2 * (q2 * q3 + q1 * qc),
                ],
                [
                    2 * (q1 * q3 + q2 * qc),
                    2 * (q2 * q3 - q1 * qc),
                    -(q1**2) - q2**2 + q3**2 + qc**2,
                ],
            ]
        )
        R_world_body = cameras[k][:3, :3] @ T[:3, :3]
        R_rtn_body = R_rtn_world(run.time_s[k]) @ R_world_body
        assert np.allclose(M, R_rtn_body.T, atol=1e-9)


def test_a_bag_of_poses_transforms_and_markers(
    write: Written, poses: FloatArray, recorded: Path
) -> None:
    bag = write("mcap", "--epoch", EPOCH)
    found: dict[str, list[tuple[int, Any]]] = {}
    with AnyReader([bag]) as reader:
        for connection, time_ns, raw in reader.messages():
            message = reader.deserialize(raw, connection.msgtype)
            found.setdefault(connection.topic, []).append((time_ns, message))
    run = read_run(recorded / "result")
    times_s = run.time_s[run.has_estimate]
    assert len(found["/pcnav/pose"]) == len(poses)
    for (time_ns, message), T, time_s in zip(found["/pcnav/pose"], poses, times_s, strict=True):
        assert message.header.frame_id == "camera"
        assert time_ns == 1772366400_250000000 + round(1e9 * time_s)
        pose = message.pose.pose
        assert np.allclose([pose.position.x, pose.position.y, pose.position.z], T[:3, 3])
        q = pose.orientation
        assert np.allclose(Rotation.from_quat([q.x, q.y, q.z, q.w]).as_matrix(), T[:3, :3])
        spread = np.reshape(message.pose.covariance, (6, 6))
        assert np.linalg.eigvalsh(spread)[0] > 0.0
    parents = {(t.header.frame_id, t.child_frame_id) for _, m in found["/tf"] for t in m.transforms}
    assert parents == {("world", "camera"), ("camera", "target")}
    assert len(found["/pcnav/truth"]) == len(found["/pcnav/status"]) == 6
    (marker,) = found["/pcnav/markers"][0][1].markers
    assert (marker.type, marker.header.frame_id) == (5, "target")
    assert len(marker.points) >= 24


def test_the_pose_covariance_is_that_of_small_changes_of_the_state(recorded: Path) -> None:
    content, missing = exported(recorded / "result")
    assert not missing
    k, motion = len(content.run) - 1, content.run.trajectory
    covariances, P = pose_covariances(content), motion.covariance
    assert covariances is not None
    assert P is not None
    assert content.recording is not None
    state, T_cam_world = NavigationState.of(motion, k), content.recording.T_cam_world[k]
    a = content.recording.info.mean_motion_rad_s * motion.time_s[k]
    R_hill_world = Rotation.from_rotvec([0.0, a, 0.0]).as_matrix()
    at, step = state.T_cam_model(T_cam_world, R_hill_world), 1e-6
    columns = []
    for direction in np.eye(15):
        # The inertia does not move the pose.
        error = np.append(step * direction, np.zeros(5))
        moved = replace(state).retract(error).T_cam_model(T_cam_world, R_hill_world)
        turn = Rotation.from_matrix(moved[:3, :3] @ at[:3, :3].T).as_rotvec()
        columns.append(np.concatenate([moved[:3, 3] - at[:3, 3], turn]) / step)
    J = np.column_stack(columns)
    expected = J @ P[k][:15, :15] @ J.T
    scale = np.sqrt(np.outer(np.diagonal(expected), np.diagonal(expected)))
    assert np.abs((covariances[k] - expected) / scale).max() < 1e-4


def test_npz_and_csv_hold_what_the_run_and_the_recording_say(
    write: Written, recorded: Path
) -> None:
    run = read_run(recorded / "result", with_covariance=True)
    with np.load(write("npz")) as arrays:
        for name, values in run.trajectory.values.items():
            assert np.array_equal(arrays[name], values, equal_nan=True)
        assert run.trajectory.covariance is not None
        assert np.array_equal(arrays["covariance"], run.trajectory.covariance, equal_nan=True)
        assert np.allclose(arrays["true_T_cam_model"], true_poses(recorded), atol=1e-12)
        assert tuple(arrays["status"]) == run.status
        assert len(arrays["layout"]) == arrays["sd"].shape[1]
    rows = [line.split(",") for line in write("csv").read_text().splitlines()]
    assert [row[3] for row in rows[1:]] == list(run.status)
    last = dict(zip(rows[0], rows[-1], strict=True))
    assert float(last["x_m"]) == run.trajectory.poses[-1][0, 3]
    assert 0.0 < float(last["sd_z_m"]) < 0.05
    assert [rows[1][k] for k in (4, 10, 11, 16)] == [""] * 4


def test_poses_without_a_recording_are_written_and_what_is_missing_is_said(
    pcnav: Pcnav, recorded: Path, tmp_path: Path
) -> None:
    result, out = tmp_path / "result", tmp_path / "x.tum"
    shutil.copytree(recorded / "result", result)
    settings = (result / "pipeline.toml").read_text()
    gone = settings.replace('sequence = "../sequence"', 'sequence = "../gone"')
    (result / "pipeline.toml").write_text(gone)
    answer = pcnav("export", result, "--to", "tum", "-o", out)
    assert answer.code == 0
    assert "gone: no truth" in answer.err
    assert "quaternion scalar last" in answer.err
    assert not out.with_name("x.truth.tum").exists()
    expect_refusal(pcnav("export", result, "--to", "oem", "-o", out), "recording", "--sequence")
    found = pcnav("export", result, "--to", "bop", "--sequence", recorded / "sequence")
    assert found.code == 0
    assert result.with_name("result.csv").read_text().count("\n") > 3


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--to", "tom"), ("--to", "expected one of tum", "got tom")),
        (("--to", "oem"), ("epoch", "expected --epoch")),
        (("--to", "aem", "--epoch", "noon"), ("--epoch", "2026-03-01T12:00:00", "got noon")),
        (("--to", "mcap", "--epoch", "1914-07-28"), ("time_s", "times from 0 on")),
    ],
)
def test_what_cannot_be_exported_is_refused(
    pcnav: Pcnav, recorded: Path, tmp_path: Path, arguments: tuple[str, ...], words: tuple[str, ...]
) -> None:
    answer: Answer = pcnav("export", recorded / "result", "-o", tmp_path / "x", *arguments)
    expect_refusal(answer, *words)
    assert not list(tmp_path.iterdir())


def test_files_are_kept_and_runs_without_poses_told(pcnav: Pcnav, tmp_path: Path) -> None:
    made_run("attitude_inertia", 8).stored(tmp_path / "turns")
    made_run("depth", 8).stored(tmp_path / "poses")
    answer = pcnav("export", tmp_path / "turns", "--to", "tum")
    expect_refusal(answer, tmp_path / "turns", "expected a run with poses")
    assert pcnav("export", tmp_path / "poses", "--to", "tum").code == 0
    expect_refusal(pcnav("export", tmp_path / "poses", "--to", "tum"), "poses.tum", "new file")
    expect_refusal(pcnav("export", tmp_path / "nothing", "--to", "tum"), "states.csv")
