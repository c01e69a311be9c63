"""The parts of the Yu 2019 study against closed forms and against what they promise."""

import numpy as np
import pytest

from pcnav.config.depth import Measurements, PerceptionMode, PerceptionTable
from pcnav.config.pipeline_file import Pipeline
from pcnav.config.scenario import BodyTable, OrbitTable, ScenarioTable
from pcnav.core.spatial import exp_rotation, log_rotation, make_transform, transform_points
from pcnav.dynamics.rigid_body import inertia_from_ratios
from pcnav.perception.rectangles import distribution, observe_cloud
from pcnav.simulation.motion import true_motion
from studies.yu2019 import extraction, paper
from studies.yu2019.clouds import (
    CloudSensor,
    Spacing,
    centroid_sd,
    grid_shape,
    rectangle_cloud,
    rotation_sd,
)
from studies.yu2019.extracted import OUTLIERS, ExtractedSensor
from studies.yu2019.filter_run import disturbed_motion, model_of, run_filter
from studies.yu2019.ray_cast import settings_of
from studies.yu2019.single_frame import frame_errors


def scenario(frames: int, omega_deg_s: tuple[float, float, float] = (0.0, 0.0, 1.0)) -> Pipeline:
    return Pipeline(
        seed=3,
        scenario=ScenarioTable(frames=frames, frame_rate_hz=1.0),
        orbit=OrbitTable(mean_motion_rad_s=0.00113),
        body=BodyTable(
            attitude_rotvec_deg=(0.0, -90.0, 0.0),
            omega_body_deg_s=omega_deg_s,
            com_model_m=(-0.1, -0.1, -0.1),
            inertia_ratios=(0.5, 2.0 / 3.0, 0.0, 0.0, 0.0),
        ),
    ).model_copy(update={"noise": Pipeline().noise.model_copy(update={"range_sigma_m": 0.1})})


@pytest.mark.parametrize("n", [625, 1250, 1800, 2500, 5000, 10000])
def test_grid_has_exactly_so_many_cells_of_about_a_square(n: int) -> None:
    across, along = grid_shape(10.0, 18.0, n)
    assert across * along == n
    assert 0.3 < (10.0 / across) / (18.0 / along) < 3.0


@pytest.mark.parametrize("spacing", list(Spacing))
def test_clouds_fill_the_rectangle(spacing: Spacing) -> None:
    cloud = rectangle_cloud(10.0, 18.0, 10000, spacing, np.random.default_rng(1))
    assert cloud.shape == (10000, 3)
    assert np.abs(cloud[:, 0]).max() <= 5.0 and np.abs(cloud[:, 1]).max() <= 9.0
    eigenvalues = distribution(cloud + np.array([0.0, 0.0, 6.5])).eigenvalues
    assert eigenvalues == pytest.approx([100.0 / 12.0, 324.0 / 12.0, 0.0], rel=0.04, abs=1e-9)


@pytest.mark.parametrize("spacing", list(Spacing))
def test_closed_forms_of_the_pose_errors(spacing: Spacing) -> None:
    """500 clouds: a standard deviation is known to 3 %, so 15 % is five of those."""
    width, length, n, sigma = 10.0, 18.0, 200, 0.5
    generator = np.random.default_rng(2)
    T = make_transform(exp_rotation(np.array([0.3, -0.2, 0.4])), np.array([1.0, 2.0, 25.0]))
    shifts, turns = [], []
    for _ in range(500):
        cloud = rectangle_cloud(width, length, n, spacing, generator)
        points = transform_points(T, cloud) + sigma * generator.standard_normal((n, 3))
        found = observe_cloud(points, sigma**2 * np.eye(3)).T_cam_rect
        turn = T[:3, :3].T @ found[:3, :3]
        turn = turn @ np.diag(np.sign(np.diag(turn)))  # the case nearest to the truth
        shifts.append(T[:3, :3].T @ (found[:3, 3] - T[:3, 3]))
        turns.append(log_rotation(turn))
    args = (width, length, n, sigma, spacing)
    assert np.std(shifts, axis=0) == pytest.approx(centroid_sd(*args), rel=0.15)
    assert np.std(turns, axis=0) == pytest.approx(rotation_sd(*args), rel=0.15)


def test_no_size_of_rectangle_explains_the_printed_errors_by_independent_draws() -> None:
    for length in np.geomspace(0.1, 100.0, 60):
        args = (length / 1.8, length, 1800, 0.1, Spacing.INDEPENDENT)
        assert 3.0 * max(centroid_sd(*args)) > 0.01 or 3.0 * max(rotation_sd(*args)) > np.deg2rad(2)
    even = (10.0, 18.0, 1800, 0.1, Spacing.EVEN)
    assert 3.0 * max(centroid_sd(*even)) < 0.01
    assert np.rad2deg(3.0 * max(rotation_sd(*even))) < 0.16


def test_extraction_finds_the_plane_and_the_printed_draws_look_like_ours() -> None:
    found = {each.printed.outliers: each for each in extraction.extractions(10, 5)}
    assert all(each.as_printed for each in found.values())
    # All points that are no outliers are found, and with the loose threshold many that are.
    assert np.all(found[0].counts == 2500) and np.all(found[0].loose == 2500)
    assert 1250.0 <= found[1250].counts.mean() < 1254.0 and found[1250].loose.mean() > 1300.0
    moments = [extraction.compare_moments(each) for each in extraction.moment_runs(10, 5)]
    random = extraction.random_numbers(moments)
    assert len(random) == 38
    assert sum(number.inside for number in random) >= 31


def test_the_ambiguity_flips_frames_unless_solved() -> None:
    motion = true_motion(scenario(360))  # LAPACK's sign changes once or twice in a turn
    errors = frame_errors(motion, CloudSensor(motion, 0.1, Spacing.EVEN, 4))
    assert not errors.flipped.any()
    assert 0 < np.count_nonzero(errors.raw_flipped) < 360
    # A wrong case is one by 180 degrees, to the noise.
    angles = np.rad2deg(np.linalg.norm(errors.raw_attitude_rad[errors.raw_flipped], axis=1))
    assert angles == pytest.approx(180.0, abs=1.0)
    assert np.abs(errors.position_m).max() < 0.012


def test_the_rectangle_is_found_among_another_face_and_outliers() -> None:
    motion = true_motion(scenario(60))
    rms = []
    for outliers in (0, OUTLIERS):
        sensor = ExtractedSensor(CloudSensor(motion, 0.1, Spacing.EVEN, 4), outliers, 4)
        errors = frame_errors(motion, sensor)
        assert errors.missed == 0
        assert not errors.flipped.any()
        rms.append(np.sqrt(np.mean(errors.position_m**2, axis=0)))
    # Without outliers it is the noise alone: the one point in 16,000 beyond the threshold is rare.
    assert rms[0] == pytest.approx(0.1 / np.sqrt(1800.0), rel=0.35)
    # Of 100 outliers in 13 m some 6 are within the plane's thickness: uniform draws on the sheet.
    within = OUTLIERS * 0.8 / paper.BOX_DEPTH_M
    across = np.sqrt(within * 0.5 * (10.0**2 + 18.0**2) / 12.0) / 1800.0
    assert rms[1][:2] == pytest.approx(np.hypot(across, rms[0][:2]), rel=0.35)


def test_no_other_plane_is_taken_for_the_rectangle(monkeypatch: pytest.MonkeyPatch) -> None:
    motion = true_motion(scenario(3))
    clouds = CloudSensor(motion, 0.1, Spacing.EVEN, 4)
    strays = np.random.default_rng(5).uniform(-8.0, 8.0, (paper.CLOUD_POINTS, 3))
    place = clouds.true_T_cam_rect(0)[:3, 3]
    monkeypatch.setattr(clouds, "points", lambda _: strays + place)
    assert ExtractedSensor(clouds, 0, 4).observe(0) is None


def test_filter_through_ransac_converges_likewise() -> None:
    pipeline = scenario(120, (0.5, -0.8, 1.0))
    motion, model = true_motion(pipeline), model_of(pipeline)
    alone = run_filter(motion, pipeline, model, 3)
    found = run_filter(motion, pipeline, model, 3, outliers=0)
    assert (found.missed, found.flips) == (0, 0)
    assert np.linalg.norm(found.errors[-1, 6:9]) < 0.05
    np.testing.assert_allclose(found.sd[-1], alone.sd[-1], rtol=0.1)


def test_filter_converges_in_a_tumble_and_keeps_its_cases() -> None:
    pipeline = scenario(240, (0.5, -0.8, 1.0))
    nees = []
    for seed in range(2, 7):
        run = run_filter(true_motion(pipeline), pipeline, model_of(pipeline), seed)
        assert run.flips == 0
        assert np.linalg.norm(run.errors[0, 6:9]) == pytest.approx(0.1 * np.sqrt(3.0))
        assert np.linalg.norm(run.errors[-1, 6:9]) < 0.02
        assert (run.sd[-1, 15:] < 0.1 * paper.PRIOR_SD[15:]).all()
        nees.append(np.nanmean(run.nees["all"][-50:]))
    # A filter alone, without fits of the whole arc, errs by more now and then.
    assert 0.2 < np.median(nees) < 4.0


def test_pure_spin_leaves_three_ratios_unknown() -> None:
    pipeline = scenario(240)
    run = run_filter(true_motion(pipeline), pipeline, model_of(pipeline), 7)
    share = run.sd[-1, 15:] / paper.PRIOR_SD[15:]
    assert (share[:3] > 0.15).all(), "Iyy, Izz, Ixy"
    assert (share[3:] < 0.05).all(), "Ixz, Iyz"


@pytest.mark.parametrize("measurements", [None, Measurements.REFINED])
def test_whole_satellites_are_measured_by_rectangles_in_both_modes(
    measurements: Measurements | None,
) -> None:
    own = PerceptionTable(measurements=measurements, minimum_plane_points=55)
    pipeline = scenario(1).model_copy(update={"perception": own})
    for mode in PerceptionMode:
        settings = settings_of(pipeline, mode)
        assert settings.mode is mode
        assert settings.measured_by is Measurements.RECTANGLES
        assert settings.minimum_plane_points == 55
        # What a pipeline file may say, too.
        assert PerceptionTable.model_validate(settings.model_dump()) == settings


def test_disturbances_have_the_strength_the_filter_assumes() -> None:
    """Without a torque the angular momentum is kept; with it, it walks as the density says."""
    pipeline = scenario(100)
    density = 1e-9
    filtering = pipeline.filter.model_copy(
        update={"angular_acceleration_psd_rad2_s3": density, "acceleration_psd_m2_s3": density}
    )
    pipeline = pipeline.model_copy(update={"filter": filtering})
    inertia = inertia_from_ratios(np.array(pipeline.body.inertia_ratios))
    steps = []
    for seed in range(3):
        motion = disturbed_motion(pipeline, model_of(pipeline), seed)
        states = [motion.state(k) for k in range(len(motion))]
        momentum = [s.R_world_body @ inertia @ s.omega_body for s in states]
        body = [
            np.linalg.solve(inertia, s.R_world_body.T @ (after - before))
            for s, before, after in zip(states[1:], momentum, momentum[1:], strict=False)
        ]
        steps += body
    assert np.std(steps, axis=0) == pytest.approx(np.sqrt(density), rel=0.2)
