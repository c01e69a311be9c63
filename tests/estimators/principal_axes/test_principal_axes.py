"""The estimator on short simulated recordings: start, blackout, faults, choice of axes."""

from dataclasses import replace

import numpy as np
import pytest

from pcnav.config.principal_axes import FeatureMeasurements, Identification, PrincipalAxesTable
from pcnav.config.scenario import OrbitModel
from pcnav.config.sensors import FeaturesTable, StereoTable
from pcnav.core.errors import InputError
from pcnav.core.spatial import exp_rotation, log_rotation
from pcnav.dynamics.blocks import ATTITUDE, POSITION, RATE
from pcnav.dynamics.kepler import KeplerOrbit
from pcnav.dynamics.rigid_body import ratios_from_inertia
from pcnav.dynamics.state import NavigationState
from pcnav.estimators.features.feature_map import build_map, triangulated
from pcnav.estimators.principal_axes.estimator import PrincipalAxesEstimator
from pcnav.filtering.error_state import ErrorStateFilter
from pcnav.runs.status import Status
from pcnav.simulation.stereo import StereoScenario, simulate_tracks
from studies.hu2024.following import true_state
from tests.estimators.reported import motion_of

BLACKOUT = (8.0, 13.0)
TABLE = PrincipalAxesTable(arc_s=7.0)


def scenario(**features) -> StereoScenario:
    changes = {"count": 6, "blackouts_s": (BLACKOUT,), **features}
    return StereoScenario(
        name="test",
        times_s=np.arange(0.0, 16.0, 0.2),
        orbit=KeplerOrbit(1.2e-3),
        orbit_model=OrbitModel.HILL,
        start=NavigationState(
            np.array([12.0, 1.0, -2.0]),
            np.array([0.01, -0.02, 0.01]),
            np.zeros(3),
            exp_rotation(np.array([0.4, -0.2, 1.0])),
            np.array([0.15, 0.2, 0.12]),
            ratios_from_inertia(np.diag([4.0, 8.0, 5.0])),
        ),
        stereo=StereoTable(pixel_sigma_px=0.01),
        features=FeaturesTable(**changes),
    )


def of_inertia(inertia: np.ndarray) -> StereoScenario:
    plain = scenario(blackouts_s=())
    return replace(plain, start=replace(plain.start, inertia_ratios=ratios_from_inertia(inertia)))


def run(tracks, table=TABLE):
    estimator = PrincipalAxesEstimator(tracks.rig, tracks.orbit, table, 0)
    return estimator, [estimator.step(frame) for frame in tracks.frames]


def nees(estimator, made, frame=-1) -> float:
    true = true_state(made, frame, list(estimator.features), estimator.triple)
    error = estimator.state.local(true)
    return float(error @ np.linalg.solve(estimator.covariance, error)) / len(error)


def test_a_run_through_a_blackout():
    made = simulate_tracks(scenario(), np.random.default_rng(1))
    estimator, estimates = run(made.recording)
    status = [estimate.status for estimate in estimates]
    dark = [BLACKOUT[0] <= estimate.time_s < BLACKOUT[1] for estimate in estimates]
    first = next(k for k, s in enumerate(status) if s != Status.ACQUIRING)
    assert estimates[first].time_s < BLACKOUT[0]
    assert all(status[k] == Status.COASTING for k in range(len(dark)) if dark[k])
    assert all(status[k] == Status.LOCKED for k in range(first, len(dark)) if not dark[k])
    true = true_state(made, -1, list(estimator.features), estimator.triple)
    motion = motion_of(estimates[-1])
    assert np.linalg.norm(log_rotation(motion.R_world_body.T @ true.R_world_body)) < 0.01
    np.testing.assert_allclose(motion.r_hill, true.r_hill, atol=5e-3)
    np.testing.assert_allclose(motion.inertia_ratios, [5 / 8, 4 / 8, 0, 0, 0], atol=0.01)
    assert motion.covariance.shape == (17, 17)
    assert nees(estimator, made) < 1.7
    # The axes are the unique ones: the largest moment first.
    assert np.all(estimator.state.ratios > 0.0)


def test_a_longer_gap_in_the_rows_is_the_same_as_frames_without_features():
    tracks = simulate_tracks(scenario(), np.random.default_rng(2)).recording
    shown = replace(tracks, frames=tuple(f for f in tracks.frames if len(f.features)))
    (whole, _), (gappy, _) = run(tracks), run(shown)
    np.testing.assert_allclose(whole.state.local(gappy.state), 0.0, atol=1e-5)


def test_wrong_matches_stay_out():
    changed = scenario(count=10, wrong_match_fraction=0.1)
    made = simulate_tracks(changed, np.random.default_rng(3))
    clean = simulate_tracks(scenario(count=10), np.random.default_rng(3)).recording
    estimator, estimates = run(made.recording)
    used = wrong_used = 0
    for frame, right, estimate in zip(made.recording.frames, clean.frames, estimates, strict=True):
        off = np.abs(frame.pixels - right.pixels).max(axis=1) > 0.1 if len(frame.features) else []
        wrong = set(frame.features[off].tolist()) if len(frame.features) else set()
        if estimate.nis_dof:
            used += len(estimate.features.used)
            wrong_used += len(wrong & set(estimate.features.used))
    assert used > 100
    assert wrong_used <= 1
    assert nees(estimator, made) < 1.8


def test_features_that_come_and_go():
    changed = scenario(count=12, hidden_by_normals=True, blackouts_s=())
    made = simulate_tracks(changed, np.random.default_rng(4))
    estimator, estimates = run(made.recording, TABLE.model_copy(update={"max_features": 10}))
    assert estimates[-1].status == Status.LOCKED
    assert len(estimator.features) == 10
    assert nees(estimator, made) < 1.7


def test_axes_as_they_come_change_with_a_blackout():
    found = set()
    for seed in range(3):
        made = simulate_tracks(scenario(), np.random.default_rng(seed))
        estimator, estimates = run(made.recording, TABLE.model_copy(update={"unique_frame": False}))
        motion = motion_of(estimates[-1])
        true = true_state(made, -1, list(estimator.features), estimator.triple)
        # In other axes, yet the same motion.
        np.testing.assert_allclose(motion.r_hill, true.r_hill, atol=5e-3)
        np.testing.assert_allclose(
            motion.R_world_body @ motion.omega_body, true.R_world_body @ true.omega_body, atol=1e-3
        )
        turn = true.R_world_body.T @ motion.R_world_body
        np.testing.assert_allclose(np.sort(np.abs(turn).max(axis=0)), 1.0, atol=1e-3)
        found.add(tuple(np.round(turn).ravel()))
    assert tuple(np.eye(3).ravel()) not in found or len(found) > 1


def test_the_printed_measurements_claim_too_much():
    made = simulate_tracks(scenario(), np.random.default_rng(5))
    table = TABLE.model_copy(update={"measurements": FeatureMeasurements.PRINTED})
    once, twice = run(made.recording)[0], run(made.recording, table)[0]
    assert nees(twice, made) > 3.0 * nees(once, made)


@pytest.mark.parametrize("method", list(Identification))
def test_every_identification_leads_to_the_same_start(method):
    made = simulate_tracks(scenario(blackouts_s=()), np.random.default_rng(6))
    estimator, _ = run(made.recording, TABLE.model_copy(update={"identification": method}))
    assert nees(estimator, made) < 1.8


def test_equal_moments_are_ambiguous():
    changed = of_inertia(np.diag([4.0, 6.0, 4.0]))
    made = simulate_tracks(changed, np.random.default_rng(7))
    _, estimates = run(made.recording, TABLE.model_copy(update={"max_arc_s": 10.0}))
    assert estimates[-1].status == Status.AMBIGUOUS
    assert estimates[-1].notes["moment_gap_over_sd"] < 3.0
    # What does not depend on the axes is found all the same.
    np.testing.assert_allclose(motion_of(estimates[-1]).r_hill, made.truth[POSITION][-1], atol=0.01)
    spin = motion_of(estimates[-1]).R_world_body @ motion_of(estimates[-1]).omega_body
    np.testing.assert_allclose(spin, made.truth[ATTITUDE][-1] @ made.truth[RATE][-1], atol=1e-3)


def test_a_sheet_is_followed():
    # Its largest moment is the sum of the others: the limit of what a body can have.
    changed = of_inertia(np.diag([3.0, 8.0, 5.0]))
    made = simulate_tracks(changed, np.random.default_rng(12))
    estimator, estimates = run(made.recording)
    assert estimates[-1].status == Status.LOCKED
    assert nees(estimator, made) < 1.8


def test_another_target_is_lost_not_followed():
    tracks = simulate_tracks(scenario(), np.random.default_rng(8)).recording
    start = replace(scenario().start, r_hill=np.array([9.0, 0.0, 0.0]))
    moved = simulate_tracks(replace(scenario(), start=start), np.random.default_rng(9)).recording
    frames = tracks.frames[:40] + moved.frames[70:]
    _, estimates = run(replace(tracks, frames=frames))
    assert Status.LOST in [estimate.status for estimate in estimates]


def test_numbers_that_break_down_are_a_loss_and_no_end(monkeypatch):
    tracks = simulate_tracks(scenario(), np.random.default_rng(8)).recording
    update = ErrorStateFilter.update
    seen = [k for k, frame in enumerate(tracks.frames) if len(frame.features)]
    k = seen[-4]
    breaks_at = tracks.frames[k].time_s

    def broken(self, measurements, *rest, **named):
        if now[0] == breaks_at:
            raise np.linalg.LinAlgError("Singular matrix")
        return update(self, measurements, *rest, **named)

    monkeypatch.setattr(ErrorStateFilter, "update", broken)
    estimator, words, now = PrincipalAxesEstimator(tracks.rig, tracks.orbit, TABLE), [], [0.0]
    for frame in tracks.frames[: k + 3]:
        now[0] = frame.time_s
        words.append(estimator.step(frame).status)
    assert words[k:] == [Status.LOST, Status.ACQUIRING, Status.ACQUIRING]


def test_a_map_needs_agreement():
    tracks = simulate_tracks(scenario(), np.random.default_rng(10)).recording
    seen = [triangulated(frame, tracks.rig) for frame in tracks.frames[:20]]
    rng = np.random.default_rng(0)
    assert build_map(seen, rng) is not None
    two = [
        replace(s, features=s.features[:2], p_world=s.p_world[:2], noise=s.noise[:2]) for s in seen
    ]
    assert build_map(two, rng) is None
    # Points that move independently are no body.
    loose = [replace(s, p_world=s.p_world + rng.normal(size=s.p_world.shape)) for s in seen]
    assert build_map(loose, rng) is None


def test_bad_frames_are_told_apart():
    tracks = simulate_tracks(scenario(), np.random.default_rng(11)).recording
    estimator = PrincipalAxesEstimator(tracks.rig, tracks.orbit, TABLE)
    first, second = tracks.frames[:2]
    estimator.step(second)
    with pytest.raises(InputError, match="times in order"):
        estimator.step(first)
    doubled = replace(tracks.frames[2], features=np.zeros_like(tracks.frames[2].features))
    with pytest.raises(InputError, match="every feature once"):
        estimator.step(doubled)
    with pytest.raises(ValueError, match="max_arc_s"):
        PrincipalAxesTable(arc_s=20.0, max_arc_s=10.0)


def test_an_eccentric_orbit():
    orbit = KeplerOrbit(1.2e-3, 0.3, 0.5)
    changed = replace(scenario(), orbit=orbit, orbit_model=OrbitModel.KEPLER)
    made = simulate_tracks(changed, np.random.default_rng(13))
    estimator, estimates = run(made.recording)
    assert estimates[-1].status == Status.LOCKED
    assert nees(estimator, made) < 1.8
