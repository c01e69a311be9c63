"""One run: its frames, what each estimator makes of them, and the numbers kept of it."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pcnav.batch.axes import GridRun, grid_case
from pcnav.batch.grid import GridBasis
from pcnav.batch.monte_carlo import Run
from pcnav.batch.one_run import OneRun, given_to, run_pipeline
from pcnav.batch.record import Column, RunRecord
from pcnav.config.depth import Measurements, PerceptionMode
from pcnav.config.pipeline_file import Pipeline, read_pipeline
from pcnav.config.shipped import shipped_pipeline
from pcnav.core.arrays import FloatArray
from pcnav.core.errors import InputError
from pcnav.dynamics.blocks import MASS_CENTRE_LAYOUT
from pcnav.dynamics.state import COM_MODEL, INERTIA_RATIOS, OMEGA_BODY, R_HILL, V_HILL
from pcnav.estimators.depth.tracker import Tracker
from pcnav.estimators.interface import FirstPose, Given
from pcnav.estimators.peers.icp import START_SHIFT_FRACTION, START_TURN_DEG
from pcnav.estimators.registry import ESTIMATORS
from pcnav.evaluation.bound import SceneBound, compared
from pcnav.evaluation.consistency import squared_normalised_errors
from pcnav.evaluation.errors import errors
from pcnav.evaluation.metrics import QUANTITIES, UNIT_SUFFIX
from pcnav.pipeline import run as run_sequence
from pcnav.recordings.opening import open_sequence
from pcnav.recordings.truth import read_truth
from pcnav.runs.reader import read_run
from pcnav.simulation.depth import Scene
from pcnav.simulation.simulate import simulate
from pcnav.target.satellite import Target

FRAMES = 7
BASIS = GridBasis("small.toml", Path(), FRAMES, None, None, None)
AXES: dict[str, str | float | int] = {
    "satellite": "boxsat",
    "range_m": 18.0,
    "tumble_deg_s": 4.0,
    "frame_rate_hz": 2.0,
    "resolution_px": 96,
    "range_sigma_m": 0.01,
    "outlier_share": 0.0,
    "estimator": "pcnav",
}
MODES = {
    "pcnav": (PerceptionMode.AREA_WEIGHTED, Measurements.REFINED),
    "pcnav_both": (PerceptionMode.AREA_WEIGHTED, Measurements.BOTH),
    "pcnav_rectangles": (PerceptionMode.AREA_WEIGHTED, Measurements.RECTANGLES),
    "pcnav_paper": (PerceptionMode.PAPER, Measurements.RECTANGLES),
}
PEERS = [name for name, each in ESTIMATORS.items() if each.first_pose is not FirstPose.NOTHING]


def a_run(seed: int = 3, **axes: str | float | int) -> GridRun:
    return Run(grid_case(tuple((AXES | axes).items())), 0, seed)


def depth_pipeline(**axes: str | float | int) -> tuple[Pipeline, Target]:
    pipeline, target = run_pipeline(BASIS, a_run(3, **axes))
    assert target is not None
    return pipeline, target


def needs_extra(name: str) -> None:
    if ESTIMATORS[name].library is not None:
        pytest.importorskip("small_gicp", reason="small_gicp comes with the extra `peers`")


def number(columns: Mapping[str, Column], name: str) -> FloatArray:
    """(n,) one column."""
    frames = len(columns["time_s"])
    return np.asarray(columns.get(name, np.full(frames, np.nan)), dtype=np.float64)


def numbers(columns: Mapping[str, Column], *names: str) -> FloatArray:
    """(n, k) of some columns."""
    return np.column_stack([number(columns, name) for name in names])


def poses(record: RunRecord, whose: str) -> tuple[FloatArray, Rotation]:
    rows = [f"{whose}_{name}" for name in ("tx_m", "ty_m", "tz_m", "qx", "qy", "qz", "qw")]
    values = numbers(record.columns, *rows)
    return values[:, :3], Rotation.from_quat(values[:, 3:])


@pytest.fixture(scope="module")
def simulated(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Pipeline, Target]:
    """The sequence that `pcnav simulate` writes of the run."""
    pipeline, target = depth_pipeline(outlier_share=0.02)
    folder = tmp_path_factory.mktemp("run") / "sequence"
    Scene.showing(target, pipeline).write(folder)
    return folder, pipeline, target


def test_frames_are_those_of_a_simulated_sequence(
    simulated: tuple[Path, Pipeline, Target],
) -> None:
    folder, pipeline, target = simulated
    scene = Scene.of(pipeline, target.mesh)
    stored = open_sequence(folder)
    assert stored.info.range_sigma_m == scene.info.range_sigma_m == 0.01
    assert stored.info.mean_motion_rad_s == scene.info.mean_motion_rad_s
    frames = list(scene)
    assert len(frames) == len(stored) == FRAMES
    for ours, theirs in zip(frames, stored, strict=True):
        assert ours.depth_m.dtype == theirs.depth_m.dtype
        np.testing.assert_array_equal(ours.depth_m, theirs.depth_m)
        assert (ours.time_s, ours.camera) == (theirs.time_s, theirs.camera)
        np.testing.assert_array_equal(ours.T_cam_world, theirs.T_cam_world)


def test_runs_of_a_batch_say_nothing(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level("INFO", logger="pcnav")
    record = OneRun(BASIS)(a_run())
    assert "locked" in record.columns["status"]
    assert caplog.messages == []


def test_a_depth_that_no_sequence_can_store_is_refused() -> None:
    with pytest.raises(InputError, match=r"expected depths up to 65.535 m .*, got 7"):
        OneRun(BASIS)(a_run(range_m=70.0))


def test_the_case_fixes_what_it_names_and_the_seed_draws_the_rest() -> None:
    pipelines = [run_pipeline(BASIS, a_run(seed))[0] for seed in (3, 4)]
    for pipeline in pipelines:
        # The middle of the target lies at the stated depth; its mass centre is near it.
        assert pipeline.orbit.r_hill_m[0] == pytest.approx(18.0, abs=1.0)
        assert np.linalg.norm(pipeline.body.omega_body_deg_s) == pytest.approx(4.0)
        assert (pipeline.scenario.frames, pipeline.scenario.frame_rate_hz) == (FRAMES, 2.0)
        assert (pipeline.camera.width_px, pipeline.noise.range_sigma_m) == (96, 0.01)
    first, second = pipelines
    assert first.body.attitude_rotvec_deg != second.body.attitude_rotvec_deg
    assert first.body.omega_body_deg_s != second.body.omega_body_deg_s
    assert run_pipeline(BASIS, a_run(estimator="kiss_icp"))[0] == first
    longer = replace(BASIS, frames=None, duration_s=10.0)
    assert run_pipeline(longer, a_run())[0].scenario.frames == 20
    # Without these axes distance and rate are those of the pipeline: 25 m, and 2.8 deg/s.
    axes = tuple((name, AXES[name]) for name in ("satellite", "estimator"))
    bare = run_pipeline(BASIS, Run(grid_case(axes), 0, 3))[0]
    assert bare.orbit.r_hill_m[0] == pytest.approx(25.0, abs=1.0)
    assert np.linalg.norm(bare.body.omega_body_deg_s) == pytest.approx(2.79, abs=0.01)


def test_a_run_says_what_pcnav_run_says(
    simulated: tuple[Path, Pipeline, Target], tmp_path: Path
) -> None:
    """Simulated into a folder, run with `pcnav run` and evaluated there: the same numbers."""
    folder, pipeline, target = simulated
    summary = run_sequence(folder, tmp_path / "result", pipeline)
    track = read_run(summary.folder, with_covariance=True)
    truth, P = read_truth(folder), track.trajectory.covariance
    assert truth is not None and P is not None
    found = errors(track, truth, symmetry_transforms=target.symmetry_transforms)
    layout = MASS_CENTRE_LAYOUT
    state = np.hstack([found[block] for block in layout.blocks])
    parts = {block.name: layout.slice_of(block) for block in layout.blocks}
    parts["all"] = slice(0, layout.size)

    record = OneRun(BASIS)(a_run(outlier_share=0.02))
    columns = record.columns
    assert columns["status"] == list(track.status)
    assert record.failure is None
    assert record.values["frames"] == record.frames == FRAMES
    layout = MASS_CENTRE_LAYOUT
    parts = {block.name: layout.slice_of(block) for block in layout.blocks}
    parts["all"] = slice(0, layout.size)
    expected = {
        "position_sym_error_m": np.linalg.norm(found.p_cam_m, axis=1),
        "attitude_sym_error_deg": np.rad2deg(np.linalg.norm(found.theta_model_rad, axis=1)),
        "velocity_error_m_s": np.linalg.norm(state[:, V_HILL], axis=1),
        "rate_error_deg_s": np.rad2deg(np.linalg.norm(state[:, OMEGA_BODY], axis=1)),
        "com_error_m": np.linalg.norm(state[:, COM_MODEL], axis=1),
        "inertia_ratio_error": np.linalg.norm(state[:, INERTIA_RATIOS], axis=1),
        "nis": track.nis,
        "nis_dof": track.nis_dof,
        **{
            f"nees_{name}": squared_normalised_errors(state[:, block], P[:, block, block])
            for name, block in parts.items()
        },
    }
    # The true poses go through text in millimetres and lose a last digit there.
    for name, values in expected.items():
        np.testing.assert_allclose(
            number(columns, name), values, rtol=1e-5, atol=1e-9, err_msg=name
        )
    np.testing.assert_array_equal(columns["position_error_m"], columns["position_sym_error_m"])
    assert np.isfinite(expected["nees_all"][-1])
    assert record.values["time_to_lock_s"] == 1.0
    assert record.values["share_locked_right"] == pytest.approx((FRAMES - 2) / FRAMES)
    assert record.values["share_unlocked"] == pytest.approx(2 / FRAMES)


def test_the_bound_is_that_of_the_frames_on_disk(simulated: tuple[Path, Pipeline, Target]) -> None:
    folder, pipeline, target = simulated
    scene = Scene.of(pipeline, target.mesh)
    scene_bound = SceneBound(scene, target, compared(scene, target))
    bound = np.stack([scene_bound.step(frame) for frame in open_sequence(folder)])
    columns = OneRun(BASIS)(a_run(outlier_share=0.02)).columns
    deviation: FloatArray = np.sqrt(np.diagonal(bound, axis1=1, axis2=2))

    def size(block: slice) -> FloatArray:
        return np.asarray(np.linalg.norm(deviation[:, block], axis=1))

    for name, expected in (
        ("crb_com_m", size(COM_MODEL)),
        ("crb_inertia_ratio", size(INERTIA_RATIOS)),
        ("crb_rate_deg_s", np.rad2deg(size(OMEGA_BODY))),
    ):
        np.testing.assert_allclose(number(columns, name), expected, rtol=1e-6, err_msg=name)
    # The pose knows where the model is far better than where in it the mass centre lies.
    assert np.all(numbers(columns, "crb_position_m")[:, 0] < 0.2 * size(R_HILL))


@pytest.mark.parametrize("name", [name for name in MODES if name != "pcnav"])
def test_modes_are_those_of_the_tracker(
    simulated: tuple[Path, Pipeline, Target], name: str
) -> None:
    folder, pipeline, target = simulated
    mode, measurements = MODES[name]
    table = pipeline.perception.model_copy(update={"mode": mode, "measurements": measurements})
    sequence = open_sequence(folder)
    tracker = Tracker(target, sequence.info, table, pipeline.filter, pipeline.seed)
    record = OneRun(BASIS)(a_run(outlier_share=0.02, estimator=str(name)))
    p_cam, _ = poses(record, "true")
    for k, frame in enumerate(sequence):
        estimate = tracker.step(frame)
        assert record.columns["status"][k] == estimate.status
        error_m = record.numbers("position_error_m")[k]
        if estimate.T_cam_target is None:
            assert np.isnan(float(error_m))
        else:
            expected = np.linalg.norm(estimate.T_cam_target[:3, 3] - p_cam[k])
            assert error_m == pytest.approx(expected, rel=1e-5, abs=1e-9)


@pytest.mark.parametrize("name", [*PEERS, "pcnav_single_frame"])
def test_peers_have_errors_of_poses_alone(name: str) -> None:
    """Their errors, computed anew by SciPy from the poses stored; nothing else has a value."""
    needs_extra(name)
    record = OneRun(BASIS)(a_run(estimator=str(name)))
    columns, values = record.columns, record.values
    assert columns["status"] == ["locked"] * FRAMES
    (p_true, R_true), (p, R) = poses(record, "true"), poses(record, "est")
    shift_m = np.linalg.norm(p - p_true, axis=1)
    turn_deg = np.rad2deg((R.inv() * R_true).magnitude())
    np.testing.assert_allclose(number(columns, "position_error_m"), shift_m, rtol=1e-9)
    np.testing.assert_allclose(number(columns, "attitude_error_deg"), turn_deg, rtol=1e-6)
    assert values["ate_rmse_m"] == pytest.approx(np.sqrt(np.mean(shift_m**2)))
    step = R[:-1].inv() * R[1:]
    step_true = R_true[:-1].inv() * R_true[1:]
    rotation_deg = np.rad2deg((step_true.inv() * step).magnitude())
    assert values["rpe_rotation_rmse_deg"] == pytest.approx(np.sqrt(np.mean(rotation_deg**2)))
    assert values["share_locked_right"] == 1.0
    assert (values["time_to_lock_s"], values["frames_lost"]) == (0.0, 0.0)
    add, add_s = numbers(columns, "add_m", "add_s_m").T
    assert np.all(add_s <= add)
    assert np.all(add <= shift_m + np.deg2rad(turn_deg) * 6.0 + 1e-9)
    silent = ("velocity_error_m_s", "com_error_m", "nees_all", "nees_r_hill", "nis")
    assert np.isnan(numbers(columns, *silent)).all()
    # Who is given the true pose is not bound by what the frames tell.
    bounded = np.isfinite(numbers(columns, "crb_position_m"))
    assert bounded.all() if name != "kiss_icp" else not bounded.any()


@pytest.mark.parametrize("name", PEERS)
def test_peers_follow_a_motion_without_noise(name: str) -> None:
    """From a start 5 deg and 10 cm off, or exactly right, to the accuracy of points 10 cm apart."""
    needs_extra(name)
    # The robust one takes for outliers what is off by a few times the noise that it is told: the
    # way to a pose 10 cm off is longer than that of the rounding.
    sigma_m = 0.01 if name == "open3d_icp_tukey" else 0.0
    run = a_run(estimator=str(name), range_sigma_m=sigma_m, resolution_px=128, tumble_deg_s=3.0)
    columns = OneRun(BASIS)(run).columns
    errors = numbers(columns, "position_error_m", "attitude_error_deg")
    limits = (0.08, 1.2) if name == "kiss_icp" else (0.012, 0.3)
    assert np.all(errors[2:] < limits), errors


def test_the_start_that_peers_are_given_is_as_far_off_as_said() -> None:
    pipeline, target = depth_pipeline()
    scene = Scene.of(pipeline, target.mesh)
    true = scene.motion.truth.poses[0]
    given = {name: given_to(ESTIMATORS[name], scene, pipeline, target) for name in (*MODES, *PEERS)}
    for name, each in given.items():
        start = each.T_cam_model_first
        if name not in PEERS:
            assert start is None
            with pytest.raises(ValueError, match="T_cam_model_first"):
                _ = each.first_pose
        elif name == "kiss_icp":
            np.testing.assert_array_equal(start, true)
        else:
            assert start is not None
            turn = Rotation.from_matrix(start[:3, :3].T @ true[:3, :3]).magnitude()
            assert np.rad2deg(turn) == pytest.approx(START_TURN_DEG)
            shift_m = np.linalg.norm(start[:3, 3] - true[:3, 3])
            assert shift_m == pytest.approx(START_SHIFT_FRACTION * target.diameter_m)


@pytest.mark.parametrize("name", [PEERS[0], PEERS[2], PEERS[-1]])
def test_peers_bridge_a_frame_without_returns(name: str) -> None:
    needs_extra(name)
    pipeline, target = depth_pipeline(range_sigma_m=0.0)
    scene = Scene.of(pipeline, target.mesh)
    true = scene.truth.poses
    given = Given(pipeline, scene.info, target, true[0])
    estimator = ESTIMATORS[name].make(given)
    for frame in scene:
        seen = frame.index != 4
        shown = frame if seen else replace(frame, depth_m=np.zeros_like(frame.depth_m))
        answer = estimator.step(shown)
        assert answer.status == ("locked" if seen else "lost")
        assert (answer.T_cam_target is not None) == seen
        if answer.T_cam_target is not None and frame.index > 4:
            assert np.linalg.norm(answer.T_cam_target[:3, 3] - true[frame.index][:3, 3]) < 0.1


@pytest.mark.parametrize("name", ["pcnav", "open3d_icp", *PEERS[2:]])
def test_the_same_run_gives_the_same_bits(name: str) -> None:
    needs_extra(name)
    first, second = (OneRun(BASIS)(a_run(estimator=str(name))) for _ in range(2))
    assert first.columns.keys() == second.columns.keys()
    for column in set(first.columns) - {"frame_ms"}:
        np.testing.assert_array_equal(first.columns[column], second.columns[column])
    costs = {"ms_per_frame", "peak_memory_mb"}
    for value in set(first.values) - costs:
        np.testing.assert_equal(first.values[value], second.values[value])
    assert all(first.values[cost] > 0.0 for cost in costs)
    assert first.values["ms_per_frame"] == pytest.approx(
        np.mean(numbers(first.columns, "frame_ms"))
    )


OTHER_KINDS = {
    "principal_axes": ("hu2024", 110, "features.count", 8),
    "inertia_bank": ("segal2011", 6, "stereo.pixel_sigma_px", 0.2),
    "image_motion": ("applsci2022", 12, "image_camera.pixel_sigma_px", 0.2),
    "attitude_inertia": ("deng2024", 12, "attitude_inertia.attitude_sd_deg", 0.3),
}
"""By estimator a shipped pipeline, frames, a key of it and a value."""
SETTLED = {"principal_axes": 0.02}
"""Estimators that make more of rounding: pixels that differ in their last bit change errors in
principal axes by 0.1 % and a NEES by 0.7 %, in memory as well."""


@pytest.mark.parametrize("name", OTHER_KINDS)
def test_runs_of_every_kind_say_what_pcnav_run_says(name: str, tmp_path: Path) -> None:
    pipeline_name, frames, key, value = OTHER_KINDS[name]
    path = shipped_pipeline(pipeline_name)
    assert path is not None
    basis = GridBasis("g.toml", Path(), frames, None, pipeline_name, read_pipeline(path))
    run = Run(grid_case(((key, value), ("estimator", name))), 0, 5)
    record = OneRun(basis)(run)
    pipeline, _ = run_pipeline(basis, run)
    table, field = key.split(".")
    assert getattr(getattr(pipeline, table), field) == value
    assert (pipeline.seed, pipeline.scenario.frames) == (5, frames)
    simulate(pipeline).write(tmp_path / "recording")
    metrics = run_sequence(tmp_path / "recording", tmp_path / "result", pipeline).metrics
    assert record.failure is None and record.frames == metrics.frames
    by_key = {each.key: each for each in metrics.quantities}
    for quantity in QUANTITIES:
        column = f"{quantity.name}_error{UNIT_SUFFIX[quantity.unit]}"
        if quantity.key in by_key and quantity.name:
            errors = record.numbers(column)[np.isfinite(record.numbers(column))]
            rms = np.sqrt(np.mean(errors**2))
            expected = by_key[quantity.key].whole.rms
            assert rms == pytest.approx(expected, rel=SETTLED.get(name, 1e-6)), column
    assert by_key
    for block in metrics.nees:
        degrees = record.values[f"nees_{block.name}_dof"]
        squared = record.numbers(f"nees_{block.name}")
        total = np.nansum(squared)
        assert np.isfinite(squared).sum() == block.frames
        if block.frames:
            mean = total / (degrees * block.frames)
            rel = SETTLED.get(name, 1e-5)
            assert mean == pytest.approx(block.mean_per_degree, rel=rel), block.name
    assert "add_m" not in record.columns and "crb_position_m" not in record.columns


@pytest.mark.parametrize("pattern", ["raster", "rosette"])
def test_scans_are_followed_and_bounded_by_nothing(pattern: str) -> None:
    basis = GridBasis("small.toml", Path(), 4, None, None, None)
    scan: dict[str, str | float | int] = {"scan.pattern": pattern, "scan.duration_s": 0.5}
    record = OneRun(basis)(a_run(3, **scan))
    assert record.values["share_locked_right"] == 0.5
    # The bound knows frames as images alone.
    assert "crb_attitude_deg" not in record.columns
