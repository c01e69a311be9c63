"""The start of the filter: when signs are clear, which points decide them, what it claims."""

from dataclasses import replace
from itertools import permutations

import numpy as np
import pytest

import pcnav.estimators.principal_axes.arc_start as arc_start
from pcnav.core.spatial import exp_rotation, log_rotation
from pcnav.estimators.features.photogrammetric_frame import photogrammetric_axes
from pcnav.estimators.principal_axes.arc_start import start_from_arc
from pcnav.estimators.principal_axes.estimator import PrincipalAxesEstimator
from pcnav.estimators.principal_axes.feature_states import PA_MOTION_SIZE, PrincipalState
from pcnav.estimators.principal_axes.principal_choice import axes_certainty, signing_triple
from pcnav.estimators.principal_axes.principal_frame import clearest_triple
from pcnav.simulation.stereo import draw_points, observe, with_truth
from studies.hu2024 import paper
from studies.hu2024.following import disturbed_truth, true_state


def state_of(points: np.ndarray) -> PrincipalState:
    ratios = np.array([0.2, 0.5])
    still = np.zeros(3)
    return PrincipalState(np.eye(3), still, ratios, still, still, points)


def covariance_of(state: PrincipalState, axes_sd_rad: float) -> np.ndarray:
    covariance = 1e-8 * np.eye(state.size)
    covariance[:3, :3] = axes_sd_rad**2 * np.eye(3)
    return covariance


def test_significance_is_how_often_an_axis_would_be_reversed() -> None:
    # The first side of the triangle is nearly at right angles to the first axis.
    corners = np.array([[0.0, 0.0, 0.0], [0.15, 1.0, 0.3], [-1.0, 0.5, 0.1]])
    state, sd = state_of(corners), 0.1
    certainty = axes_certainty(state, covariance_of(state, sd), corners)
    given = photogrammetric_axes(corners)
    turned = exp_rotation(sd * np.random.default_rng(1).normal(size=(20_000, 3)))
    cosines = np.einsum("nij,ij->nj", turned[..., :2], given[:, :2])
    nearest = int(np.abs(np.diag(given)[:2]).argmin())
    reversed_share = np.mean(cosines[:, nearest] < 0.0)
    assert 0.05 < reversed_share < 0.2
    # That of a normal variable which is so many deviations from zero.
    drawn = np.random.default_rng(2).normal(size=200_000)
    expected = np.mean(drawn > abs(certainty.sign_significance))
    assert reversed_share == pytest.approx(expected, abs=0.01)
    assert not certainty.is_signed
    assert axes_certainty(state, covariance_of(state, 1e-3), corners).is_signed


def test_the_clearest_triple_is_the_clearest_of_all() -> None:
    points = np.random.default_rng(3).uniform(-1.5, 1.5, (6, 3))

    def margin(triple: tuple[int, ...]) -> float:
        frame = photogrammetric_axes(points[list(triple)])
        return float(np.abs(np.diag(frame))[:2].min())

    def height(triple: tuple[int, ...]) -> float:
        a, b, c = points[list(triple)]
        longest = max(np.linalg.norm(b - a), np.linalg.norm(c - b), np.linalg.norm(a - c))
        return float(np.linalg.norm(np.cross(b - a, c - a)) / longest)

    all_triples = list(permutations(range(6), 3))
    highest = max(map(height, all_triples))
    high = [triple for triple in all_triples if height(triple) >= 0.5 * highest]
    assert margin(clearest_triple(points)) == pytest.approx(max(map(margin, high)))


def test_a_clear_triple_stays_and_an_unclear_one_makes_way() -> None:
    state = state_of(np.random.default_rng(4).uniform(-1.5, 1.5, (6, 3)))
    unclear = min(
        permutations(range(6), 3),
        key=lambda triple: abs(
            axes_certainty(
                state, covariance_of(state, 0.1), state.points[list(triple)]
            ).sign_significance
        ),
    )
    i, j, k = unclear
    assert signing_triple(state, covariance_of(state, 1e-9), (i, j, k)) == (i, j, k)
    assert signing_triple(state, covariance_of(state, 0.1), (i, j, k)) == clearest_triple(
        state.points
    )


def disturbed(seed: int, share: float, arc_s: float):
    """Simulated tracks under a share of the printed disturbance, and the settings that say so."""
    scenario = paper.scenario()
    scenario = replace(scenario, times_s=scenario.times_s[scenario.times_s <= arc_s + 1e-6])
    table = paper.settings(share)
    on_points, on_motion, on_tracks = np.random.default_rng(seed).spawn(3)
    points = draw_points(scenario.features, on_points)
    truth = disturbed_truth(scenario, table, on_motion)
    return with_truth(observe(scenario, truth, points, on_tracks), truth, points), table


def started(seed: int, share: float, arc_s: float):
    """Start and truth at its end, in the axes that it names."""
    made, table = disturbed(seed, share, arc_s)
    tracks, rng = made.recording, np.random.default_rng(seed)
    start = start_from_arc(tracks.frames, tracks.rig, tracks.orbit, table, rng)
    assert start is not None
    return start, true_state(made, len(tracks.frames) - 1, list(start.features), start.triple)


def off_deg(state: PrincipalState, true: PrincipalState) -> float:
    turn = log_rotation(state.R_world_body.T @ true.R_world_body)
    return float(np.degrees(np.linalg.norm(turn)))


def test_axes_are_signed_by_what_they_are_in_the_end(monkeypatch: pytest.MonkeyPatch) -> None:
    """A hundredth of the printed torque: the axes that the start begins with lie far off."""
    start, true = started(29, 0.01, 10.0)
    assert off_deg(start.state, true) < 60.0
    monkeypatch.setattr(
        arc_start, "_signed", lambda state, covariance, triple: (state, covariance, triple)
    )
    start, true = started(29, 0.01, 10.0)
    assert off_deg(start.state, true) > 120.0


def test_the_covariance_of_a_start_does_not_hang_on_the_last_digit() -> None:
    scenario, table = paper.scenario(), paper.pipeline().principal_axes
    scenario = replace(scenario, times_s=scenario.times_s[scenario.times_s <= 10.0 + 1e-6])
    on_points, on_motion, on_tracks = np.random.default_rng(2).spawn(3)
    points = draw_points(scenario.features, on_points)
    truth = disturbed_truth(scenario, None, on_motion)
    tracks = observe(scenario, truth, points, on_tracks)
    found = []
    for k in range(2):
        last = 2.0**-52 * np.random.default_rng(k).choice([-1.0, 1.0], (6, 4)) * k
        frames = [
            replace(f, pixels=f.pixels * (1.0 + last[: len(f.pixels)])) for f in tracks.frames
        ]
        rng = np.random.default_rng(0)
        start = start_from_arc(frames, tracks.rig, tracks.orbit, table, rng)
        assert start is not None
        found.append(np.sqrt(np.diag(start.covariance)))
    # The gain of a filter lost one part in a hundred.
    np.testing.assert_allclose(found[0], found[1], rtol=1.5e-3)
    assert found[0].shape == (PA_MOTION_SIZE + 18,)


def test_the_filter_claims_no_more_of_the_mass_centre_than_all_frames_smoothed_at_once() -> None:
    """Linearised where pixels are predicted, every frame would seem to tell a little of it."""
    made, table = disturbed(2, 1.0, 20.0)
    tracks = made.recording
    estimator = PrincipalAxesEstimator(tracks.rig, tracks.orbit, table, 2)
    for frame in tracks.frames:
        estimator.step(frame)
    assert estimator.covariance is not None
    whole, _ = started(2, 1.0, 20.0)
    mean = np.tile(np.eye(3), 6) / 6.0
    filtered, smoothed = (
        np.sqrt(np.trace(mean @ P[PA_MOTION_SIZE:, PA_MOTION_SIZE:] @ mean.T))
        for P in (estimator.covariance, whole.covariance)
    )
    assert 0.9 < filtered / smoothed < 1.15
