"""The tracker on rendered sequences, and the direction of the imports under it."""

import logging
import re
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from scipy.stats import chi2

from pcnav.config.depth import FilterTable, Measurements, PerceptionTable
from pcnav.config.pipeline_file import Pipeline, read_pipeline
from pcnav.core.arrays import FloatArray
from pcnav.core.errors import InputError
from pcnav.core.spatial import exp_rotation, log_rotation, rotation_angle
from pcnav.dynamics.blocks import MASS_CENTRE_LAYOUT
from pcnav.dynamics.state import COM_MODEL, INERTIA_RATIOS, STATE_SIZE, NavigationState
from pcnav.estimators.depth.measuring import AGREES
from pcnav.estimators.depth.tracker import Tracker
from pcnav.recordings.sequence import Frame, InitialPrior, SequenceInfo
from pcnav.runs.estimate import Estimate
from pcnav.runs.nis_window import NIS_WINDOW_FRAMES
from pcnav.runs.records import ACCEPTED
from pcnav.runs.status import Status
from pcnav.simulation.motion import TrueMotion, true_motion
from pcnav.simulation.noise import add_sensor_faults
from pcnav.target.rendering import DepthRenderer
from pcnav.target.satellite import Target, load_target

FRAMES = 40
PIPELINE = Pipeline.model_validate(
    {
        "seed": 3,
        "scenario": {"frames": FRAMES, "frame_rate_hz": 2.0},
        "orbit": {
            "mean_motion_rad_s": 0.0011,
            "r_hill_m": [22.0, 0.2, -0.1],
            "v_hill_m_s": [0.004, -0.002, 0.003],
        },
        "body": {
            "attitude_rotvec_deg": [25.0, 40.0, -30.0],
            "omega_body_deg_s": [2.0, -1.4, 2.5],
            "com_model_m": [0.10, 0.12, -0.13],
            "inertia_ratios": [0.577, 0.735, -0.02, 0.06, -0.045],
        },
        "camera": {"horizontal_fov_deg": 30.0},
        "noise": {"range_sigma_m": 0.02},
    }
)
SIGMA_M = PIPELINE.noise.range_sigma_m
INFO = SequenceInfo("boxsat", PIPELINE.orbit.mean_motion_rad_s, SIGMA_M, None)
BLIND = range(20, 24)
"""Frames without returns in the second sequence."""
GAP = range(9, 19)
"""... and in the one with a longer gap, while the rate is not yet known well."""


@dataclass(frozen=True)
class Recording:
    target: Target
    frames: list[Frame]
    motion: TrueMotion


def recorded(target: Target, pipeline: Pipeline, first: int = 0) -> Recording:
    """The frames of a pipeline from the first one asked for, in memory."""
    motion = true_motion(pipeline)
    camera = pipeline.camera.pinhole
    renderer = DepthRenderer(target.mesh, camera)
    frames = []
    for k in range(first, len(motion.truth.time_s)):
        clean = renderer.render(motion.truth.poses[k])
        depth_m = add_sensor_faults(clean, pipeline.noise, pipeline.seed, k)
        frames.append(
            Frame(k, float(motion.truth.time_s[k]), depth_m, camera, motion.T_cam_world[k])
        )
    return Recording(target, frames, motion)


def shortened(pipeline: Pipeline, frames: int) -> Pipeline:
    scenario = pipeline.scenario.model_copy(update={"frames": frames})
    return pipeline.model_copy(update={"scenario": scenario})


@pytest.fixture(scope="module")
def recording(repository: Path) -> Recording:
    return recorded(load_target(repository / "meshes" / "boxsat.obj"), PIPELINE)


def tracker_of(
    target: Target,
    info: SequenceInfo = INFO,
    filtering: FilterTable = PIPELINE.filter,
    perception: PerceptionTable = PIPELINE.perception,
) -> Tracker:
    return Tracker(target, info, perception, filtering, PIPELINE.seed)


def track(
    recording: Recording,
    frames: list[Frame],
    measurements: Measurements | None = None,
) -> list[Estimate]:
    perception = PerceptionTable(measurements=measurements)
    tracker = tracker_of(recording.target, perception=perception)
    return [tracker.step(frame) for frame in frames]


@pytest.fixture(scope="module")
def estimates(recording: Recording) -> list[Estimate]:
    return track(recording, recording.frames)


def emptied(frame: Frame) -> Frame:
    return replace(frame, depth_m=np.zeros_like(frame.depth_m))


def index_of(recording: Recording, estimate: Estimate) -> int:
    """The frame of the recording."""
    return int(np.searchsorted(recording.motion.truth.time_s, estimate.time_s))


def state_of(estimate: Estimate) -> NavigationState:
    """What was estimated."""
    return NavigationState(*(estimate[block] for block in MASS_CENTRE_LAYOUT.blocks))


def note(estimate: Estimate, name: str) -> float:
    """A number of the tracker's own."""
    value = estimate.notes[name]
    assert isinstance(value, float | int)
    return value


def pose_errors(recording: Recording, estimates: list[Estimate]) -> FloatArray:
    """(n, 2) position (m) and angle (rad) of the frames with an estimate."""
    rows = []
    for estimate in estimates:
        if estimate.T_cam_target is not None:
            truth = recording.motion.truth.poses[index_of(recording, estimate)]
            shift = np.linalg.norm(truth[:3, 3] - estimate.T_cam_target[:3, 3])
            turn = rotation_angle(truth[:3, :3].T @ estimate.T_cam_target[:3, :3])
            rows.append([shift, turn])
    return np.array(rows)


def test_locks_within_five_frames_without_a_prior_and_stays(
    estimates: list[Estimate],
) -> None:
    words = [estimate.status for estimate in estimates]
    first = words.index(Status.LOCKED)
    assert 2 <= first < 5
    assert set(words[:first]) == {Status.ACQUIRING}
    assert set(words[first:]) == {Status.LOCKED}
    for estimate in estimates[:first]:
        assert not estimate.values and estimate.covariance is None
        assert estimate.T_cam_target is None and estimate.notes["n_rectangles"] == 0


@pytest.mark.parametrize("measurements", [Measurements.RECTANGLES, Measurements.BOTH])
def test_other_measurements_lock_and_track_as_well(
    recording: Recording, estimates: list[Estimate], measurements: Measurements
) -> None:
    """Refined ones are the default: what is true of it holds of the others, but for the noise."""
    others = track(recording, recording.frames[:20], measurements)
    words = [estimate.status for estimate in others]
    first = words.index(Status.LOCKED)
    assert first < 5
    assert words == [Status.ACQUIRING] * first + [Status.LOCKED] * (20 - first)
    errors = pose_errors(recording, others)
    assert np.max(errors[5:, 0]) < 3e-3
    assert np.max(errors[5:, 1]) < np.deg2rad(0.1)
    for estimate in others[first:]:
        assert note(estimate, "n_rectangles") >= 2
        assert note(estimate, "inlier_ratio") > 0.95
    # Both are refined ones, filtered alike, and faces of the planes that RANSAC found as a check.
    one, other = others[-1].covariance, estimates[19].covariance
    assert one is not None and other is not None
    assert np.array_equal(one, other) == (measurements is Measurements.BOTH)
    records = [record for estimate in others for record in estimate.records]
    checks = [record for record in records if record.outcome.startswith("check: ")]
    assert bool(checks) == (measurements is Measurements.BOTH)
    if checks:
        assert sum(record.outcome == AGREES for record in checks) > 0.5 * len(checks)


def test_pose_is_better_than_a_millimetre_and_hundredths_of_a_degree(
    recording: Recording, estimates: list[Estimate]
) -> None:
    errors = pose_errors(recording, estimates)
    assert len(errors) >= FRAMES - 4
    median = np.median(errors[10:], axis=0)
    assert median[0] < 1e-3
    assert median[1] < np.deg2rad(0.03)
    assert np.max(errors[10:, 0]) < 3e-3
    assert np.max(errors[10:, 1]) < np.deg2rad(0.1)


def test_motion_and_mass_centre_come_out(recording: Recording, estimates: list[Estimate]) -> None:
    state, truth = state_of(estimates[-1]), recording.motion.state(-1)
    assert np.linalg.norm(state.omega_body - truth.omega_body) < np.deg2rad(0.05)
    assert np.linalg.norm(state.v_hill - truth.v_hill) < 5e-3
    before = np.linalg.norm(recording.target.com_model - truth.com_model)
    assert np.linalg.norm(state.com_model - truth.com_model) < 0.5 * before


def test_covariance_covers_the_error(recording: Recording, estimates: list[Estimate]) -> None:
    nees = []
    for estimate in estimates:
        if estimate.covariance is None:
            continue
        P = estimate.covariance
        assert np.array_equal(P, P.T)
        assert np.linalg.eigvalsh(P)[0] > 0.0
        truth = recording.motion.state(index_of(recording, estimate))
        error = state_of(estimate).ratio_error(truth)
        nees.append(error @ np.linalg.solve(P, error))
    # One run: successive errors are far from independent, so only gross overconfidence shows.
    assert np.median(nees) < 3.0 * STATE_SIZE


def test_innovations_are_as_large_as_stated(estimates: list[Estimate]) -> None:
    nis = np.array([estimate.nis for estimate in estimates])
    dof = np.array([estimate.nis_dof for estimate in estimates])
    used = np.isfinite(nis)
    assert used.sum() > 30
    assert np.all(dof[used] >= 3)
    ratio = nis[used].sum() / dof[used].sum()
    low, high = chi2.ppf([1e-6, 1 - 1e-6], dof[used].sum()) / dof[used].sum()
    assert 0.5 * low < ratio < 2.0 * high
    for estimate in estimates:
        accepted = sum(record.outcome == ACCEPTED for record in estimate.records)
        assert accepted == note(estimate, "n_rectangles")


def test_two_runs_are_the_same_bit_for_bit(recording: Recording, estimates: list[Estimate]) -> None:
    again = track(recording, recording.frames[:15])
    for one, other in zip(estimates, again, strict=False):
        assert one.status == other.status
        assert (one.T_cam_target is None) == (other.T_cam_target is None)
        if one.T_cam_target is not None and one.covariance is not None:
            np.testing.assert_array_equal(one.T_cam_target, other.T_cam_target)
            np.testing.assert_array_equal(one.covariance, other.covariance)


def test_frames_without_returns_are_coasted_through(recording: Recording) -> None:
    frames = [emptied(f) if f.index in BLIND else f for f in recording.frames[:30]]
    estimates = track(recording, frames)
    words = [estimate.status for estimate in estimates]
    assert [words[k] for k in BLIND] == [Status.COASTING] * len(BLIND)
    assert words[BLIND.stop :] == [Status.LOCKED] * (30 - BLIND.stop)
    errors = pose_errors(recording, estimates[BLIND.start :])
    assert np.max(errors[:, 0]) < 30e-3
    assert np.max(errors[:, 1]) < np.deg2rad(1.0)
    trace = [np.trace(e.covariance) for e in estimates[19:24] if e.covariance is not None]
    assert len(trace) == 5 and np.all(np.diff(trace) > 0.0)


@pytest.mark.parametrize("measurements", [None, Measurements.RECTANGLES])
def test_a_track_goes_on_after_a_gap_with_what_it_had_learnt(
    recording: Recording, measurements: Measurements | None
) -> None:
    frames = [emptied(f) if f.index in GAP else f for f in recording.frames[:26]]
    estimates = track(recording, frames, measurements)
    words = [estimate.status for estimate in estimates]
    assert [words[k] for k in GAP] == [Status.COASTING] * len(GAP)
    assert words[GAP.start - 1] == Status.LOCKED
    assert words[GAP.stop :] == [Status.LOCKED] * (26 - GAP.stop)
    errors = pose_errors(recording, estimates[GAP.stop :])
    assert np.max(errors[:, 0]) < 3e-3
    assert np.max(errors[:, 1]) < np.deg2rad(0.1)
    sd = np.array([np.sqrt(np.diag(e.covariance)) for e in estimates if e.covariance is not None])
    from_before_the_gap = sd[GAP.start - 1 - len(estimates) :]
    com, ratios = from_before_the_gap[:, COM_MODEL], from_before_the_gap[:, INERTIA_RATIOS]
    for block in (com, ratios):
        before = block[0]
        # The mass does not change while nobody looks, and a gap makes nobody forget it. The ratios'
        # deviations are those of the parameters where the estimate is, which may move a little.
        np.testing.assert_allclose(block[1 : 1 + len(GAP)], np.tile(before, (len(GAP), 1)))
        assert np.all(block[1 + len(GAP) :] < 1.1 * before)
    # What is seen over the longer arc tells more.
    assert np.all(com[-1] < 0.7 * com[0])


def test_explained_is_the_share_of_the_frame_that_the_pose_shows(
    recording: Recording, estimates: list[Estimate]
) -> None:
    renderer = DepthRenderer(recording.target.mesh, recording.frames[0].camera)
    checked = 0
    for frame, estimate in zip(recording.frames, estimates, strict=True):
        if estimate.T_cam_target is None:
            assert np.isnan(note(estimate, "inlier_ratio"))
            continue
        shown = renderer.render(estimate.T_cam_target).depth_m
        either = (shown > 0.0) | (frame.depth_m > 0.0)
        close = np.abs(shown - frame.depth_m) < 4.0 * SIGMA_M
        # A pixel at the rim without a return counts for neither there.
        assert note(estimate, "inlier_ratio") == pytest.approx(np.mean(close[either]), abs=0.02)
        assert 0.97 < note(estimate, "inlier_ratio") <= 1.0
        checked += 1
    assert checked > 30


def test_window_nis_is_that_of_the_last_frames(recording: Recording) -> None:
    frames = [emptied(f) if f.index in BLIND else f for f in recording.frames[:30]]
    estimates = track(recording, frames)
    updates: list[tuple[float, int]] = []
    for estimate in estimates:
        if np.isfinite(estimate.nis):
            updates.append((estimate.nis, estimate.nis_dof))
        last = updates[-NIS_WINDOW_FRAMES:]
        expected = sum(nis for nis, _ in last) / sum(dof for _, dof in last) if last else np.nan
        assert estimate.window_nis == pytest.approx(expected, rel=1e-9, nan_ok=True)
    assert np.isnan([note(estimates[k], "inlier_ratio") for k in BLIND]).all()
    assert len(updates) > 20
    assert 0.5 < (estimates[-1].window_nis or 0.0) < 1.5


def test_a_symmetric_target_is_called_ambiguous_and_its_group_told(
    repository: Path, caplog: pytest.LogCaptureFixture
) -> None:
    pipeline = shortened(read_pipeline(repository / "pipelines" / "twinwing.toml"), 8)
    twinwing = recorded(load_target(repository / "meshes" / "twinwing.obj"), pipeline)
    info = SequenceInfo(
        "twinwing", pipeline.orbit.mean_motion_rad_s, pipeline.noise.range_sigma_m, None
    )
    caplog.set_level(logging.INFO, logger="pcnav")
    tracker = tracker_of(twinwing.target, info)
    words = [tracker.step(frame).status for frame in twinwing.frames]
    first = words.index(Status.AMBIGUOUS)
    assert first < 5
    assert words == [Status.ACQUIRING] * first + [Status.AMBIGUOUS] * (8 - first)
    (line,) = [r.getMessage() for r in caplog.records if "->" in r.getMessage()]
    change = f"frame {first}: acquiring -> ambiguous, symmetry group C2 about z"
    assert re.fullmatch(change + r" \(inlier ratio \d+ %, .*\)", line)


def test_a_target_without_symmetry_has_no_group_to_tell(
    recording: Recording, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO, logger="pcnav")
    track(recording, recording.frames[:5])
    (line,) = [r.getMessage() for r in caplog.records if "->" in r.getMessage()]
    assert "acquiring -> locked (" in line


def test_a_sequence_that_starts_empty_is_acquired_later(recording: Recording) -> None:
    frames = [emptied(f) if f.index < 4 else f for f in recording.frames[:10]]
    words = [estimate.status for estimate in track(recording, frames)]
    assert words[:6] == [Status.ACQUIRING] * 6
    assert words[-1] == Status.LOCKED


JUMP = 8
"""Frame at which the third sequence jumps to quite another attitude, 56 degrees away."""


@pytest.fixture(scope="module")
def jumped(recording: Recording) -> list[tuple[Estimate, float]]:
    """Estimates of a sequence whose target jumps, each with its error in attitude (rad)."""
    shown = [*range(24, 24 + JUMP), *range(30)]
    frames = [
        replace(recording.frames[k], index=index, time_s=0.5 * index)
        for index, k in enumerate(shown)
    ]
    rows = []
    for estimate, k in zip(track(recording, frames), shown, strict=True):
        error = np.nan
        if estimate.T_cam_target is not None:
            truth = recording.motion.truth.poses[k]
            error = float(rotation_angle(truth[:3, :3].T @ estimate.T_cam_target[:3, :3]))
        rows.append((estimate, error))
    return rows


def test_a_target_that_jumps_is_lost_and_found_again(
    jumped: list[tuple[Estimate, float]],
) -> None:
    words = [estimate.status for estimate, _ in jumped]
    assert words[JUMP - 1] == Status.LOCKED
    assert Status.COASTING in words[JUMP:]
    lost = words.index(Status.LOST)
    again = words.index(Status.LOCKED, lost)
    assert again - lost < 6
    assert set(words[again:]) == {Status.LOCKED}
    assert max(error for _, error in jumped[again:]) < np.deg2rad(0.5)


def test_a_wrong_attitude_is_not_called_locked(
    jumped: list[tuple[Estimate, float]],
) -> None:
    wrong = [estimate.status for estimate, error in jumped if error > np.deg2rad(5.0)]
    assert len(wrong) >= 2
    assert Status.LOCKED not in wrong


# A wrong lock: the attitude tracked is another one than the target's, which turns as it did.


def turned(pipeline: Pipeline, axis: tuple[float, float, float]) -> Pipeline:
    """The same motion of a target that is turned by half a turn about an axis of its body."""
    turn = exp_rotation(np.pi * np.array(axis) / np.linalg.norm(axis))
    attitude = exp_rotation(np.deg2rad(pipeline.body.attitude_rotvec_deg)) @ turn
    change = {
        "attitude_rotvec_deg": tuple(np.rad2deg(log_rotation(attitude)).tolist()),
        "omega_body_deg_s": tuple((turn.T @ pipeline.body.omega_body_deg_s).tolist()),
    }
    body = pipeline.body.model_copy(update=change)
    return pipeline.model_copy(update={"body": body})


SWITCH = 12
"""Frame at which the target of a sequence is exchanged for the turned one."""


def switched(
    target: Target, pipeline: Pipeline, axis: tuple[float, float, float]
) -> list[tuple[Estimate, float]]:
    """Estimates before and after the switch, each with its error in attitude (rad)."""
    before = recorded(target, shortened(pipeline, SWITCH))
    after = recorded(target, turned(pipeline, axis), SWITCH)
    shown = [(source, frame) for source in (before, after) for frame in source.frames]
    tracker = tracker_of(target)
    rows = []
    for source, frame in shown:
        estimate = tracker.step(frame)
        error = np.nan
        if estimate.T_cam_target is not None:
            truth = source.motion.truth.poses[frame.index]
            error = float(rotation_angle(truth[:3, :3].T @ estimate.T_cam_target[:3, :3]))
        rows.append((estimate, error))
    return rows


def check_the_lock_is_mended(rows: list[tuple[Estimate, float]], most_wrong: int) -> None:
    """Locked, wrong, lost and locked again rightly; few frames called locked while wrong."""
    words = [estimate.status for estimate, _ in rows]
    assert words[SWITCH - 1] == Status.LOCKED
    assert rows[SWITCH - 1][1] < np.deg2rad(0.1)
    assert rows[SWITCH][1] > np.deg2rad(170.0)
    lost = words.index(Status.LOST)
    again = words.index(Status.LOCKED, lost)
    assert again - lost < 6
    assert set(words[again:]) == {Status.LOCKED} and len(words) - again > 3
    assert max(error for _, error in rows[again:]) < np.deg2rad(0.5)
    wrong = [estimate.status for estimate, error in rows if error > np.deg2rad(5.0)]
    assert wrong.count(Status.LOCKED) <= most_wrong


def test_a_wrong_lock_that_explains_little_is_never_called_locked(recording: Recording) -> None:
    rows = switched(recording.target, shortened(PIPELINE, 30), (1.0, -2.0, 0.5))
    check_the_lock_is_mended(rows, most_wrong=0)
    assert note(rows[SWITCH][0], "inlier_ratio") < 0.2


def box_with_a_tower(folder: Path, height_m: float) -> Target:
    """A box that only a small tower on one side tells from itself turned by half a turn."""
    box = trimesh.creation.box((2.4, 1.8, 1.4))
    tower = trimesh.creation.box((0.8, 0.6, height_m))
    tower.apply_translation((0.5, 0.3, 0.7 + 0.5 * height_m))
    path = folder / "tower.obj"
    trimesh.util.concatenate([box, tower]).export(path)
    return load_target(path)


def test_a_track_that_sees_only_other_things_is_given_up_after_ten_frames(
    recording: Recording,
) -> None:
    wall = np.zeros_like(recording.frames[0].depth_m)
    wall[:40, :40] = 60.0
    frames = recording.frames[:8] + [
        replace(frame, depth_m=wall) for frame in recording.frames[8:20]
    ]
    words = [estimate.status for estimate in track(recording, frames)]
    assert words[7] == Status.LOCKED
    assert words[8:] == [*[Status.COASTING] * 10, Status.LOST, Status.ACQUIRING]


@pytest.mark.parametrize(
    ("height_m", "axis", "inlier_ratio"),
    [(0.5, (1.0, 0.0, 0.0), (0.5, 0.9)), (0.3, (0.0, 0.0, 1.0), (0.8, 0.97))],
)
def test_a_wrong_lock_that_explains_most_of_the_frame_is_found_out(
    tmp_path: Path,
    height_m: float,
    axis: tuple[float, float, float],
    inlier_ratio: tuple[float, float],
) -> None:
    almost_symmetric = box_with_a_tower(tmp_path, height_m)
    assert len(almost_symmetric.symmetry_transforms) == 1
    own = {
        "com_model_m": tuple(almost_symmetric.com_model.tolist()),
        "inertia_ratios": tuple(almost_symmetric.inertia_ratios.tolist()),
    }
    body = PIPELINE.body.model_copy(update=own)
    pipeline = shortened(PIPELINE.model_copy(update={"body": body}), 30)
    rows = switched(almost_symmetric, pipeline, axis)
    assert inlier_ratio[0] < note(rows[SWITCH][0], "inlier_ratio") < inlier_ratio[1]
    # The first fresh look opens the question, the second one answers it.
    check_the_lock_is_mended(rows, most_wrong=0)
    words = [estimate.status for estimate, _ in rows]
    assert words.index(Status.LOST) <= SWITCH + 3


def test_a_speck_before_the_target_comes_into_view_is_no_fault_of_units(
    recording: Recording,
) -> None:
    speck = np.zeros_like(recording.frames[0].depth_m)
    speck[100:102, 100:102] = 20.0
    tracker = tracker_of(recording.target)
    estimate = tracker.step(replace(recording.frames[0], depth_m=speck))
    assert estimate.status == Status.ACQUIRING


def test_a_mesh_in_millimetres_is_told(recording: Recording) -> None:
    mesh: trimesh.Trimesh = recording.target.mesh.copy()
    mesh.apply_scale(1000.0)
    rectangles = tuple(
        replace(r, length_m=1000.0 * r.length_m, width_m=1000.0 * r.width_m)
        for r in recording.target.rectangles
    )
    wrong = replace(recording.target, mesh=mesh, rectangles=rectangles)
    with pytest.raises(InputError, match=r"units.*metres") as caught:
        tracker_of(wrong).step(recording.frames[0])
    assert caught.value.file == recording.target.mesh_path
    assert "\n" not in str(caught.value)


def test_prior_is_that_of_the_file_then_the_sequence_then_the_target(recording: Recording) -> None:
    prior = InitialPrior(
        com_model_m=tuple(recording.motion.state(0).com_model.tolist()),
        com_sd_m=(1e-3,) * 3,
        inertia_ratios=tuple(recording.motion.state(0).inertia_ratios.tolist()),
        inertia_ratios_sd=(1e-3,) * 5,
    )
    stated = replace(INFO, initial=prior)
    for info, filtering, com_sd, ratio_sd in (
        (INFO, FilterTable(), 0.15, 0.1),
        (stated, FilterTable(), 1e-3, 1e-3),
        (stated, FilterTable(com_sd_m=0.02, inertia_ratio_sd=0.03), 0.02, 0.03),
    ):
        tracker = tracker_of(recording.target, info, filtering)
        steps = (tracker.step(frame) for frame in recording.frames[:6])
        first = next(estimate for estimate in steps if estimate.covariance is not None)
        assert first.covariance is not None
        sd = np.sqrt(np.diag(first.covariance))
        # A few frames tell little of the mass properties: their prior still stands.
        assert np.all(sd[COM_MODEL] <= com_sd * 1.001)
        assert np.max(sd[COM_MODEL]) > 0.5 * com_sd
        # The covariance of the ratios is that of the filter's parameters, taken where the estimate
        # is now.
        assert np.all(sd[INERTIA_RATIOS] <= ratio_sd * 1.05)
        assert np.max(sd[INERTIA_RATIOS]) > 0.5 * ratio_sd


def test_range_noise_of_the_perception_table_replaces_the_sequence_s(recording: Recording) -> None:
    deviations = []
    for table in (PerceptionTable(), PerceptionTable(range_sigma_m=0.04)):
        tracker = Tracker(recording.target, INFO, table, FilterTable(), 0)
        estimate = tracker.step(recording.frames[0])
        deviations.append(estimate.records[0].sd[2])
    assert deviations[1] == pytest.approx(2.0 * deviations[0], rel=0.2)
