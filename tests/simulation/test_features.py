"""Simulated feature tracks: what is seen follows from the truth, faults come as often as told."""

from dataclasses import replace

import numpy as np
import pytest

from pcnav.config.pipeline_file import Pipeline
from pcnav.config.scenario import BodyTable, OrbitModel, OrbitTable, ScenarioTable
from pcnav.config.sensors import Boresight, FeaturesTable, StereoTable
from pcnav.core.errors import InputError
from pcnav.dynamics.blocks import ATTITUDE, POSITION, RATE, VELOCITY
from pcnav.dynamics.kepler import propagate_relative
from pcnav.dynamics.orbit import hill_transition
from pcnav.recordings.tracks import StereoTracks
from pcnav.simulation.motion import rotate_torque_free
from pcnav.simulation.simulation import Simulation
from pcnav.simulation.stereo import (
    StereoScenario,
    in_view,
    simulate_tracks,
    stereo_scenario,
)

N = 0.00104


def scenario(
    frames: int = 200,
    rate_hz: float = 2.0,
    orbit: OrbitTable | None = None,
    stereo: StereoTable | None = None,
    **features: object,
) -> StereoScenario:
    """A tumbling target a few metres ahead, variants by the settings of [features]."""
    return stereo_scenario(
        Pipeline(
            scenario=ScenarioTable(frames=frames, frame_rate_hz=rate_hz),
            orbit=orbit or OrbitTable(mean_motion_rad_s=N, r_hill_m=(20.0, 1.0, -2.0)),
            body=BodyTable(
                attitude_rotvec_deg=(20.0, -30.0, 50.0),
                omega_body_deg_s=(5.0, 4.0, 6.0),
                inertia_ratios=(0.7, 0.5, 0.05, -0.02, 0.03),
            ),
            stereo=stereo or StereoTable(pixel_sigma_px=0.05),
            features=FeaturesTable.model_validate(features),
        )
    )


def made(case: StereoScenario, seed: int = 0) -> Simulation[StereoTracks]:
    return simulate_tracks(case, np.random.default_rng(seed))


def places(made: Simulation[StereoTracks], k: int) -> np.ndarray:
    """(N, 3) true points in rig axes, written out frame by frame from the definitions."""
    tracks, truth, points = made.recording, made.truth, made.points
    frame = tracks.frames[k]
    R_hill_world = tracks.orbit.R_hill_world(frame.time_s)
    found = []
    for p_body in points:
        p_world = R_hill_world.T @ truth[POSITION][k] + truth[ATTITUDE][k] @ p_body
        found.append(frame.R_cam_world @ p_world)
    return np.array(found)


@pytest.mark.parametrize("pointing", list(Boresight))
def test_pixels_are_projections_of_the_truth_with_the_stated_noise(pointing: Boresight) -> None:
    case_made = made(scenario(stereo=StereoTable(pixel_sigma_px=0.05, pointing=pointing)))
    tracks = case_made.recording
    rows = []
    for k, frame in enumerate(tracks.frames):
        p_rig = places(case_made, k)
        np.testing.assert_array_equal(frame.features, np.arange(10))
        rows.append(frame.pixels - tracks.rig.project(p_rig))
    residuals = np.concatenate(rows)
    assert residuals.std() == pytest.approx(0.05, rel=0.03)
    np.testing.assert_allclose(residuals.mean(axis=0), 0.0, atol=0.005)
    correlation = np.corrcoef(residuals.T) - np.eye(4)
    assert np.abs(correlation).max() < 0.1


def test_the_rig_holds_the_target_near_the_middle_but_not_at_it() -> None:
    passing = OrbitTable(mean_motion_rad_s=N, r_hill_m=(9, 9, 9), v_hill_m_s=(-0.4, -0.5, -0.8))
    case_made = made(scenario(orbit=passing))
    tracks, truth = case_made.recording, case_made.truth
    offsets = []
    for k, frame in enumerate(tracks.frames):
        R_rig_hill = frame.R_cam_world @ tracks.orbit.R_hill_world(frame.time_s).T
        forward = R_rig_hill @ truth[POSITION][k] / np.linalg.norm(truth[POSITION][k])
        offsets.append(np.rad2deg(np.arccos(forward[2])))
    assert np.ptp(offsets) < 1e-6
    assert 0.02 < offsets[0] < 1.5


def test_a_fixed_rig_loses_what_leaves_its_images_or_is_behind() -> None:
    stereo = StereoTable(pointing=Boresight.HILL)
    leaving = OrbitTable(r_hill_m=(10, 0, 0), v_hill_m_s=(-0.3, 0.0, 0.0))
    case_made = made(scenario(orbit=leaving, stereo=stereo))
    tracks = case_made.recording
    for k, frame in enumerate(tracks.frames):
        p_rig = places(case_made, k)
        seen = np.isin(np.arange(10), frame.features)
        np.testing.assert_array_equal(seen, in_view(tracks.rig, p_rig))
        assert not seen[p_rig[:, 2] < 0.0].any()
        if seen.any():
            pixels = tracks.rig.project(p_rig[seen])
            assert (pixels > -0.5).all()
            assert (pixels < 1023.5).all()
    counts = [len(frame.features) for frame in tracks.frames]
    assert counts[0] == 10
    assert counts[-1] == 0


def test_in_view_needs_both_images() -> None:
    rig = StereoTable().rig
    edge = 10.0 * 512.0 / 1000.0
    points = np.array([[0.0, 0.0, 10.0], [edge - 0.01, 0.0, 10.0], [-edge + 0.5, 0.0, 10.0]])
    np.testing.assert_array_equal(in_view(rig, points), [True, True, False])
    np.testing.assert_array_equal(in_view(rig, -points), [False, False, False])


def test_the_true_motion_is_that_of_the_dynamics() -> None:
    case = scenario(frames=50)
    truth = made(case).truth
    start = np.concatenate([case.start.r_hill, case.start.v_hill])
    np.testing.assert_allclose(
        np.concatenate([truth[POSITION][-1], truth[VELOCITY][-1]]),
        hill_transition(N, 24.5) @ start,
        rtol=1e-9,
    )
    momentum = np.einsum("nij,nj->ni", truth[ATTITUDE] @ case.start.inertia, truth[RATE])
    np.testing.assert_allclose(momentum, np.tile(momentum[0], (50, 1)), rtol=1e-10, atol=1e-12)
    ellipse = OrbitTable(
        model=OrbitModel.KEPLER, mean_motion_rad_s=N, eccentricity=0.3, true_anomaly_deg=50.0
    )
    case = scenario(frames=50, orbit=ellipse)
    truth = made(case).truth
    exact = propagate_relative(case.orbit, case.start.r_hill, case.start.v_hill, case.times_s)
    np.testing.assert_allclose(truth[POSITION], exact[:, :3], rtol=1e-12)


def test_disturbances_spread_as_their_densities_say() -> None:
    psd, turn_psd, t, runs = 1e-6, 1e-9, 10.0, 150
    case = scenario(
        frames=21, acceleration_psd_m2_s3=psd, angular_acceleration_psd_rad2_s3=turn_psd
    )
    calm = made(scenario(frames=21)).truth
    ends = [made(case, seed).truth for seed in range(runs)]
    v = np.array([end[VELOCITY][-1] - calm[VELOCITY][-1] for end in ends])
    r = np.array([end[POSITION][-1] - calm[POSITION][-1] for end in ends])
    assert v.std() == pytest.approx(np.sqrt(psd * t), rel=0.12)
    assert r.std() == pytest.approx(np.sqrt(psd * t**3 / 3.0), rel=0.12)
    # The rate drifts and Euler's equation carries the drift: close to the white-noise value.
    w = np.array([end[RATE][-1] - calm[RATE][-1] for end in ends])
    assert w.std() == pytest.approx(np.sqrt(turn_psd * t), rel=0.25)


def test_the_disturbed_integrator_without_disturbance_is_the_exact_one() -> None:
    case = scenario(frames=41, angular_acceleration_psd_rad2_s3=1e-29)
    truth = made(case).truth
    R, omega = rotate_torque_free(
        case.start.R_world_body, case.start.omega_body, case.start.inertia, case.times_s
    )
    np.testing.assert_allclose(truth[ATTITUDE], R, atol=1e-9)
    np.testing.assert_allclose(truth[RATE], omega, atol=1e-10)


def test_blackouts_hide_everything_for_their_time() -> None:
    tracks = made(scenario(blackouts_s=[[10.0, 20.0], [50.0, 55.5]])).recording
    for frame in tracks.frames:
        dark = 10.0 <= frame.time_s < 20.0 or 50.0 <= frame.time_s < 55.5
        assert len(frame.features) == (0 if dark else 10)


def test_normals_hide_what_faces_away() -> None:
    points = [(1.0, 0.0, 0.0), (-1.0, 0.0, 0.0), (0.0, 1.0, 0.5), (0.3, 0.2, -1.0)]
    normals = [(1.0, 0.0, 0.0), (-1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, -1.0)]
    case = scenario(
        points_m=points, normals_body=normals, hidden_by_normals=True, max_view_angle_deg=75.0
    )
    case_made = made(case)
    tracks, truth = case_made.recording, case_made.truth
    counts = np.zeros(4)
    for k, frame in enumerate(tracks.frames):
        p_rig = places(case_made, k)
        R_rig_body = frame.R_cam_world @ truth[ATTITUDE][k]
        for i in range(4):
            n_rig = R_rig_body @ np.array(normals[i])
            angle = np.arccos(-n_rig @ p_rig[i] / np.linalg.norm(p_rig[i]))
            assert (i in frame.features) == (angle < np.deg2rad(75.0))
        counts[frame.features] += 1
    assert ((counts > 20) & (counts < 180)).all()
    both = scenario(points_m=points, hidden_by_normals=True, blackouts_s=[[0.0, 30.0]])
    assert not any(len(frame.features) for frame in made(both).recording.frames[:60])


def test_tracks_are_lost_and_found_at_the_rates_told() -> None:
    tracks = made(scenario(frames=4000, count=20, mean_tracked_s=30.0, mean_lost_s=10.0)).recording
    alive = np.zeros((4000, 20), dtype=bool)
    for k, frame in enumerate(tracks.frames):
        alive[k, frame.features] = True
    assert alive[0].all()
    assert alive[400:].mean() == pytest.approx(0.75, abs=0.03)
    lost = (alive[:-1] & ~alive[1:]).sum() / alive[:-1].sum()
    assert lost == pytest.approx(0.5 / 30.0, rel=0.1)


def test_wrong_matches_come_as_often_as_told_and_change_nothing_else() -> None:
    both = made(scenario()), made(scenario(wrong_match_fraction=0.2))
    right, wrong = (each.recording for each in both)
    np.testing.assert_array_equal(both[0].points, both[1].points)
    changed, of_others = [], 0
    for a, b in zip(right.frames, wrong.frames, strict=True):
        np.testing.assert_array_equal(a.features, b.features)
        different = (a.pixels != b.pixels).all(axis=1)
        np.testing.assert_array_equal(a.pixels[~different], b.pixels[~different])
        assert (right.rig.disparity(b.pixels) > 0.0).all()
        changed.append(different)
        of_others += sum((a.pixels == row).all(axis=1).any() for row in b.pixels[different])
    total = np.concatenate(changed)
    assert total.mean() == pytest.approx(0.2, abs=0.03)
    assert of_others / total.sum() == pytest.approx(0.5, abs=0.08)


def test_a_seed_makes_the_same_tracks_again_and_another_others() -> None:
    case = scenario(frames=20, mean_tracked_s=5.0, wrong_match_fraction=0.1)
    one, again, other = (made(case, seed).recording for seed in (1, 1, 2))
    for a, b in zip(one.frames, again.frames, strict=True):
        np.testing.assert_array_equal(a.pixels, b.pixels)
    assert not np.array_equal(one.frames[0].pixels, other.frames[0].pixels)


def test_variants_are_made_by_replacing() -> None:
    case = scenario(frames=3)
    late = replace(case, times_s=np.array([100.0, 101.0]))
    seen = made(late)
    tracks, truth = seen.recording, seen.truth
    np.testing.assert_array_equal(truth[POSITION][0], case.start.r_hill)
    assert [frame.time_s for frame in tracks.frames] == [100.0, 101.0]


def test_points_are_given_from_the_mass_centre() -> None:
    shifted = Pipeline(body=BodyTable(com_model_m=(0.1, 0, 0)))
    with pytest.raises(InputError, match=r"my\.toml: body\.com_model_m"):
        stereo_scenario(shifted, "my.toml")


@pytest.mark.parametrize(
    "features",
    [
        {"blackouts_s": [[5.0, 5.0]]},
        {"normals_body": [[1, 0, 0]]},
        {"points_m": [[1, 0, 0]], "normals_body": [[0, 0, 0]]},
        {"count": 0},
        {"wrong_match_fraction": 1.5},
    ],
)
def test_settings_that_cannot_be_are_refused(features: dict[str, object]) -> None:
    with pytest.raises(ValueError, match="validation error"):
        FeaturesTable.model_validate(features)
