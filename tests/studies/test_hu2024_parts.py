"""The parts of the Hu 2024 study: truth, identification, judging, tables."""

from dataclasses import replace

import numpy as np
import pytest

from pcnav.batch.monte_carlo import Case, batches, runs_of
from pcnav.core.arrays import joined
from pcnav.dynamics import blocks
from pcnav.estimators.principal_axes.feature_states import PA_MOTION_SIZE
from pcnav.simulation.motion import rotate_torque_free
from studies.hu2024 import paper
from studies.hu2024.disturbed import Claimed, disturbed_table
from studies.hu2024.errors import (
    ATTITUDE,
    QUANTITIES,
    Consistency,
    blackout_table,
    error_figures,
    last_table,
)
from studies.hu2024.following import Following, cases, disturbed_truth, judge
from studies.hu2024.identification import (
    REPORT_S,
    Method,
    falls,
    rises_with_noise,
    rmse_figure,
    rmse_of,
    rmse_table,
    run_identification,
)
from studies.hu2024.study import filter_runs, identification_batches


def short(duration_s: float):
    scenario = paper.scenario()
    features = scenario.features.model_copy(update={"blackouts_s": ((13.0, 15.0),)})
    times = scenario.times_s[scenario.times_s < duration_s][::2]
    return replace(scenario, times_s=times, features=features)


def test_settings_are_those_of_print():
    pipeline = paper.pipeline()
    assert pipeline.orbit.r_hill_m == (10.0, 10.0, 10.0)
    assert pipeline.orbit.v_hill_m_s == (-0.3889, -0.4932, -0.8264)
    assert pipeline.body.inertia_ratios == (0.625, 0.5, 0.0, 0.0, 0.0)
    np.testing.assert_allclose(np.deg2rad(pipeline.body.omega_body_deg_s), 0.1)
    assert pipeline.features.count == 6
    assert all(end - start == 20.0 for start, end in paper.blackouts_s())
    assert paper.settings(1.0).angular_acceleration_psd_rad2_s3 == 2.5e-5
    assert len(identification_batches(500)) == 16
    assert [run.case.name for run in filter_runs(500)].count("matched") == 100


def test_a_truth_without_disturbance_is_free():
    scenario = short(10.0)
    truth = disturbed_truth(scenario, None, np.random.default_rng(0))
    start = scenario.start
    R, omega = rotate_torque_free(
        start.R_world_body, start.omega_body, start.inertia, scenario.times_s
    )
    np.testing.assert_allclose(truth[blocks.ATTITUDE], R, atol=1e-8)
    np.testing.assert_allclose(truth[blocks.RATE], omega, atol=1e-9)


def test_a_disturbed_truth_walks_as_far_as_it_should():
    scenario, table = short(2.0), paper.settings(1.0)
    rng = np.random.default_rng(1)
    ends = np.stack([disturbed_truth(scenario, table, rng)[blocks.RATE][-1] for _ in range(300)])
    time = scenario.times_s[-1]
    # The same torque about all axes: moments of 8, 5 and 4.
    expected = np.sqrt(2.5e-5 * time) * np.array([1.0, 8.0 / 5.0, 8.0 / 4.0])
    np.testing.assert_allclose(ends.std(axis=0), expected, rtol=0.15)


def test_identification_of_a_few_runs():
    batch = batches(runs_of("few", [Case("fine", 1e-6)], 3), 3)[0]
    squared = run_identification(batch)
    assert squared[Method.ARC].shape == (3, len(REPORT_S))
    degrees = np.degrees(np.sqrt(squared[Method.ARC]))
    assert degrees[:, -1].max() < 0.05
    assert degrees[:, -1].max() < degrees[:, 0].min()
    printed = np.degrees(np.sqrt(squared[Method.PRINTED]))
    assert np.median(printed[:, -1]) > np.median(degrees[:, -1])


def test_rmse_with_its_tables_and_figures():
    def errors(scale):
        squared = scale**2 * np.linspace(1.0, 0.1, len(REPORT_S)) ** 2
        return {method: np.tile(squared, (4, 1)) for method in Method}

    rmse = rmse_of({"fine": [errors(0.01), errors(0.01)], "coarse": [errors(0.2)]})
    np.testing.assert_allclose(rmse["fine"][Method.ARC][0], np.degrees(0.01))
    assert falls(rmse, Method.ARC)
    assert rises_with_noise(rmse, Method.ARC)
    swapped = {name: rmse[name] for name in ("coarse", "fine")}
    assert not rises_with_noise(swapped, Method.ARC)
    row = rmse_table("fig05", rmse, Method.ARC).rows[1]
    assert (row[0], row[1], row[-2]) == ("coarse", "11.5", "falls")
    assert b"<svg" in rmse_figure("fig05", rmse, Method.ARC).svg


@pytest.fixture(scope="module")
def runs():
    return {
        name: joined(
            [judge(replace(cases()[name].settings, every=5), short(18.0), seed) for seed in (1, 2)],
            alike=("time_s",),
        )
        for name in ("unique axes", "free axes", "matched")
    }


def test_errors_of_both_filters(runs):
    unique, free = runs["unique axes"], runs["free axes"]
    assert unique.error.shape == (2, len(unique.time_s), PA_MOTION_SIZE)
    assert np.isnan(unique.error[:, 0]).all()
    assert np.isfinite(unique.error[:, -1]).all()
    assert not unique.lost.any()
    assert ATTITUDE.share_inside(unique) == 1.0
    assert ATTITUDE.share_inside(free) < 0.9
    # Only the names of the axes were lost.
    for quantity in QUANTITIES:
        assert quantity.share_inside(free, label_free=True) == 1.0
    np.testing.assert_allclose(unique.label_free, unique.error, atol=1e-12)
    # The motion is the same in any axes.
    np.testing.assert_allclose(unique.error[0, -1, 8:], free.error[0, -1, 8:], atol=0.02)


def test_consistency_of_matched_runs(runs):
    consistent = Consistency.of(runs["matched"])
    assert 0.5 < np.nanmean(consistent.whole.mean) < 1.6
    assert consistent.whole[0].verdict == "-"
    whole, motion = consistent.at(18.0)
    assert whole.values == motion.values == 2


def test_a_start_and_a_gap_under_a_strong_torque_are_what_they_say():
    """A tenth of the printed disturbance: an arc fitted without one has a misfit of 40 and more."""
    scenario = short(17.0)
    features = scenario.features.model_copy(update={"blackouts_s": ((11.0, 15.0),)})
    case = Following(paper.settings(0.1), disturbed=True, every=3)
    run = judge(case, replace(scenario, features=features), 0)
    per_degree = run.nees[0] / run.size[0]
    assert np.isfinite(per_degree[run.time_s > 10.0]).all()
    assert np.nanmean(per_degree[run.time_s < 11.0]) < 2.0
    assert np.nanmean(per_degree[run.time_s > 15.0]) < 2.0


def test_what_is_claimed_counts_what_is_locked_alone(runs):
    (found,) = [Claimed.of("some", runs["matched"])]
    locked = runs["matched"].locked
    assert 0.0 < found.share_locked == np.mean(locked) < 1.0
    assert found.half_turns == 0
    per_degree = (runs["matched"].nees / runs["matched"].size)[locked]
    assert found.mean_nees == pytest.approx(per_degree.mean())
    turned = replace(runs["matched"], error=runs["matched"].error + np.pi * np.eye(14)[0])
    assert Claimed.of("some", turned).half_turns == 2
    silent = Claimed.of("none", replace(runs["matched"], locked=np.zeros_like(locked)))
    assert silent.half_turns == 0
    row = disturbed_table([silent]).rows[0]
    assert row[2] == "0%"
    assert row[-4:-1] == ("-", "-", "-")


def test_tables_of_the_filter(runs, monkeypatch):
    monkeypatch.setattr(paper, "LAST_S", 2.0)
    monkeypatch.setattr(paper, "blackouts_s", lambda: ((13.0, 15.0),))
    figures = error_figures(runs["unique axes"], runs["free axes"])
    assert {figure.key for figure in figures} == {f"fig{k:02d}" for k in range(6, 12)}
    table = last_table("matched", runs["matched"])
    assert table.header == ("error norm", "RMS", "largest")
    assert {row[0] for row in table.rows} >= {*(q.label for q in QUANTITIES), "points, m"}
    assert len(blackout_table(runs["unique axes"]).rows) == 1


def test_wrong_matches_are_counted():
    case = replace(cases()["wrong matches"].settings, every=20)
    rejected_right, used_wrong, right, wrong = judge(case, short(13.0), 3).matches[0]
    assert wrong > 0
    assert right > 5 * wrong
    assert used_wrong <= 0.02 * wrong
    assert rejected_right <= 0.01 * right
