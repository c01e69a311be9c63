"""Statistics of pooled runs against plain ones, and how often their intervals and bounds hold."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from pcnav.batch.metrics import (
    METRICS,
    EvaluationWindow,
    Family,
    Sample,
    Statistic,
    named_metrics,
    of_family,
)
from pcnav.batch.record import RunRecord
from pcnav.batch.statistics import (
    MetricValue,
    Pool,
    Spread,
    cell_of,
    consistency_bounds,
    draws,
    interval,
    maximum,
    mean,
    once,
    percentiles,
    root_mean_square,
    samples_of,
    values_of,
)
from pcnav.core.errors import InputError
from pcnav.evaluation.metrics import PERCENTILES
from tests.batch.made_up import record, records, some_runs

RMS = METRICS["position_rms_m"]


def sample(values) -> Sample:
    values = np.asarray(values, dtype=np.float64)
    return Sample(values, np.ones(len(values)))


def value_of(name: str, of_runs, strata=None) -> MetricValue:
    """A metric of the samples of runs, of one case unless said otherwise."""
    metric = METRICS[name]
    strata = strata or ["case"] * len(of_runs)
    return values_of({metric.quantity.name: of_runs}, strata, [metric])[name]


@given(
    st.lists(
        st.lists(st.floats(-1e3, 1e3, allow_subnormal=False), max_size=7), min_size=1, max_size=5
    ),
    st.integers(0, 2**31),
)
def test_statistics_of_a_draw_are_those_of_its_runs_put_together(values, seed: int) -> None:
    pool = Pool.of([sample(each) for each in values])
    counts = draws(["a"] * len(values), 6, seed)
    drawn = percentiles(pool, counts, PERCENTILES)
    for k, count in enumerate(counts):
        together = np.concatenate([np.tile(v, n) for v, n in zip(values, count, strict=True)])
        if not len(together):
            assert np.isnan(drawn[k]).all()
            assert np.isnan([f(pool, counts)[k] for f in (root_mean_square, mean, maximum)]).all()
            continue
        expected = np.percentile(together, PERCENTILES)
        np.testing.assert_allclose(drawn[k], expected, rtol=1e-9, atol=1e-9)
        rms = np.sqrt(np.mean(together**2))
        assert root_mean_square(pool, counts)[k] == pytest.approx(rms, abs=1e-9)
        assert mean(pool, counts)[k] == pytest.approx(np.mean(together), abs=1e-9)
        assert maximum(pool, counts)[k] == np.max(together)


def test_long_pools_are_cut_into_blocks_without_a_trace(monkeypatch: pytest.MonkeyPatch) -> None:
    generator = np.random.default_rng(0)
    pool = Pool.of([sample(generator.normal(size=30)) for _ in range(4)])
    counts = draws(["a"] * 4, 50)
    whole = percentiles(pool, counts, PERCENTILES)
    monkeypatch.setattr("pcnav.batch.statistics._ENTRIES_AT_ONCE", 500)
    np.testing.assert_array_equal(percentiles(pool, counts, PERCENTILES), whole)


def test_draws_stay_within_their_case_and_repeat_themselves() -> None:
    strata = ["a", "b", "a", "b", "b"]
    counts = draws(strata, 3000)
    np.testing.assert_array_equal(counts, draws(strata, 3000))
    assert (counts[:, [0, 2]].sum(axis=1) == 2).all()
    assert (counts[:, [1, 3, 4]].sum(axis=1) == 3).all()
    # Each run is drawn once in the mean, with the variance of a multinomial draw.
    np.testing.assert_allclose(counts.mean(axis=0), 1.0, atol=0.06)
    np.testing.assert_allclose(counts[:, 1].var(), 3.0 * (1.0 / 3.0) * (2.0 / 3.0), atol=0.06)


def test_draws_spread_as_those_of_scipy() -> None:
    values = np.random.default_rng(5).lognormal(size=12)
    pool = Pool.of([sample([value]) for value in values])
    replicates = mean(pool, draws(["a"] * 12, 20_000))
    theirs = stats.bootstrap((values,), np.mean, n_resamples=20_000, rng=1, method="percentile")
    assert replicates.std() == pytest.approx(theirs.standard_error, rel=0.03)


@pytest.mark.parametrize("runs", [3, 5, 10, 30])
def test_intervals_cover_the_truth_nearly_as_often_as_they_say(runs: int) -> None:
    """Runs of a level of their own, 25 frames each: the RMS over all runs is known."""
    generator = np.random.default_rng(runs)
    trials, spread = 400, 0.3
    truth = np.sqrt(np.exp(2.0 * spread**2))
    counts, strata = draws(["a"] * runs), ["a"] * runs
    covered = 0
    for _ in range(trials):
        level = np.exp(spread * generator.normal(size=runs))
        frames = level[:, None] * generator.normal(size=(runs, 25))
        pool = Pool.of([sample(np.abs(each)) for each in frames])
        seen = root_mean_square(pool, once(runs))[0]
        drawn = root_mean_square(pool, counts)
        low, high = interval(seen, drawn, Spread.of(pool, strata), by_factors=True)
        covered += low <= truth <= high
    assert 0.88 <= covered / trials <= 0.98


def test_the_interval_of_a_mean_is_that_of_students_t() -> None:
    values = np.random.default_rng(6).normal(50.0, 4.0, 8)
    pool = Pool.of([sample([value]) for value in values])
    drawn = mean(pool, draws(["a"] * 8, 50_000))
    found = interval(float(values.mean()), drawn, Spread.of(pool, ["a"] * 8), by_factors=False)
    assert found == pytest.approx(
        stats.ttest_1samp(values, 0.0).confidence_interval(0.95), abs=0.05
    )
    shares = value_of("pose_pct", [sample([100.0]), sample([100.0]), sample([80.0])])
    assert shares.value == pytest.approx(280.0 / 3.0)
    assert 0.0 <= shares.low < 90.0
    assert shares.high == 100.0


def test_intervals_of_several_cases_do_not_mix_them_up() -> None:
    """Two cases whose levels differ by far: what is uncertain is small, though runs differ."""
    generator = np.random.default_rng(3)
    low = [sample(1.0 + 0.01 * generator.normal(size=20)) for _ in range(6)]
    high = [sample(9.0 + 0.01 * generator.normal(size=20)) for _ in range(6)]
    found = value_of(RMS.name, [*low, *high], ["near"] * 6 + ["far"] * 6)
    assert found.value == pytest.approx(np.sqrt((1.0 + 81.0) / 2.0), abs=0.01)
    assert found.high - found.low < 0.05
    alone = value_of(RMS.name, [*low, *high])
    assert alone.high - alone.low > 1.0


def test_there_is_no_interval_where_there_is_nothing_to_tell_it_from() -> None:
    one = value_of(RMS.name, [sample([1.0, 2.0])])
    assert one.value == pytest.approx(np.sqrt(2.5))
    assert np.isnan([one.low, one.high]).all()
    agreeing = value_of(RMS.name, [sample([1.0])] * 5)
    assert np.isnan(agreeing.low)
    assert agreeing.value == 1.0
    most = value_of("position_max_m", [sample([1.0]), sample([2.0])])
    assert most.value == 2.0 and np.isnan(most.high)
    nothing = value_of(RMS.name, [sample([]), sample([])])
    assert not nothing.exists


@pytest.mark.parametrize("correlated", [True, False])
def test_nees_bounds_hold_whatever_the_correlation(correlated: bool) -> None:
    """At most one in 20 right filters fails; exactly so when a run's frames are all alike."""
    generator = np.random.default_rng(11)
    metric, trials, runs = METRICS["nees_r_hill"], 2000, 8
    failed = 0
    for _ in range(trials):
        shape = (runs, 1) if correlated else (runs, 20)
        nees = np.broadcast_to(generator.chisquare(3, shape), (runs, 20)) / 3.0
        samples = [Sample(each, np.full(20, 3.0)) for each in nees]
        pool = Pool.of(samples)
        bounds = consistency_bounds(metric, pool)
        failed += not bounds.lower <= mean(pool, once(runs))[0] <= bounds.upper
    if correlated:
        assert 0.035 <= failed / trials <= 0.065
    else:
        assert failed / trials < 0.01


def test_nis_bounds_are_those_of_all_innovations() -> None:
    generator = np.random.default_rng(12)
    metric, trials, failed = METRICS["nis"], 2000, 0
    for _ in range(trials):
        dof = generator.integers(1, 9, (4, 25)).astype(np.float64)
        nis = generator.chisquare(dof)
        pool = Pool.of([Sample(*each) for each in zip(nis / dof, dof, strict=True)])
        bounds = consistency_bounds(metric, pool)
        found = mean(pool, once(4))[0]
        assert found == pytest.approx(nis.sum() / dof.sum())
        failed += not bounds.lower <= found <= bounds.upper
    assert 0.035 <= failed / trials <= 0.065


@pytest.mark.parametrize(
    ("factor", "verdict"), [(1.0, "pass"), (9.0, "fail: above"), (0.1, "fail: below")]
)
def test_a_filter_that_misjudges_itself_is_found(factor: float, verdict: str) -> None:
    runs = some_runs(20, satellites=("boxsat",), ranges_m=(10.0,), estimators=("pcnav",))[:20]

    def scaled(each: RunRecord) -> RunRecord:
        columns = dict(each.columns)
        columns["nees_all"] = factor * np.asarray(columns["nees_all"], dtype=np.float64)
        return RunRecord(each.run, columns, each.values, None, each.versions, each.command)

    found = cell_of(map(scaled, records(runs)), [METRICS["nees_all"]], EvaluationWindow())
    assert found.values["nees_all"].verdict == verdict


def test_every_metric_is_the_plain_statistic_of_its_frames() -> None:
    """Of a real record, frame by frame, computed here in one line each."""
    made = list(records(some_runs(3, satellites=("boxsat",), estimators=("pcnav",))[:3]))
    found = cell_of(made, list(METRICS.values()), EvaluationWindow())
    half = slice(20, None)  # 40 frames: 19.5 s long, the second half begins after 9.75 s

    def together(name: str) -> np.ndarray:
        return np.concatenate([np.asarray(r.columns[name], dtype=float)[half] for r in made])

    position = together("position_error_m")
    expected = {
        "position_rms_m": np.sqrt(np.mean(position**2)),
        "position_max_m": position.max(),
        "add_s_p90_m": np.percentile(together("add_s_m"), 90),
        "attitude_median_deg": np.median(together("attitude_error_deg")),
        "inertia_ratio_p99": np.percentile(together("inertia_ratio_error"), 99),
        "nees_inertia_ratios": together("nees_inertia_ratios").mean() / 5.0,
        "nis": together("nis").sum() / together("nis_dof").sum(),
        "position_over_crb": np.sqrt(np.mean((position / together("crb_position_m")) ** 2)),
        "ate_rmse_m": np.sqrt(np.mean([r.values["ate_rmse_m"] ** 2 for r in made])),
        "locked_right_pct": 95.0,
        "never_locked_pct": 0.0,
        "time_to_lock_s": 1.0,
        "pose_pct": 100.0,
        "ms_per_frame": np.mean([r.values["ms_per_frame"] for r in made]),
    }
    for name, value in expected.items():
        assert found.values[name].value == pytest.approx(value, rel=1e-12), name
    assert not found.values["rate_over_crb"].exists


def test_runs_that_never_lock_and_frames_without_a_pose_are_counted() -> None:
    made = record(some_runs(1)[0])
    columns = dict(made.columns)
    position = np.asarray(columns["position_error_m"]).copy()
    position[20:30] = np.nan
    columns["position_error_m"] = position
    columns["attitude_error_deg"] = position
    values = dict(made.values) | {"time_to_lock_s": np.nan}
    never = RunRecord(made.run, columns, values, None, made.versions, made.command)
    wanted = named_metrics(["never_locked_pct", "pose_pct", "time_to_lock_s", "position_rms_m"])
    found = cell_of([made, never], wanted, EvaluationWindow()).values
    assert found["never_locked_pct"].value == 50.0
    assert found["pose_pct"].value == 75.0


def test_failed_runs_are_counted_and_have_no_errors() -> None:
    runs = some_runs(4)[:4]
    found = cell_of(records(runs, failures={runs[1].key: "broken"}), [RMS], EvaluationWindow())
    assert (found.runs, found.failed) == (4, 1)
    none = cell_of(records(runs, failures={r.key: "x" for r in runs}), [RMS], EvaluationWindow())
    assert (none.runs, none.failed) == (4, 4)
    assert not none.values[RMS.name].exists


@pytest.mark.parametrize(("from_s", "frames"), [(None, 20), (0.0, 40), (15.0, 10), (100.0, 0)])
def test_the_window_takes_the_frames_it_says(from_s: float | None, frames: int) -> None:
    window = EvaluationWindow(from_s)
    assert len(samples_of(record(some_runs(1)[0]), [RMS], window)["position"].values) == frames
    text = window.text
    assert text == "second half of each run" or str(from_s).removesuffix(".0") in text or not from_s


def test_names_of_metrics_end_in_their_unit_and_are_told_when_one_is_wrong() -> None:
    endings = {"m": "_m", "deg": "_deg", "m/s": "_m_s", "deg/s": "_deg_s", "%": "_pct"}
    for metric in METRICS.values():
        if metric.unit in endings and metric.quantity.family is Family.ERRORS:
            assert metric.name.endswith(endings[metric.unit]), metric.name
    assert {m.statistic for m in of_family(Family.ERRORS)} == set(Statistic) - {Statistic.MEAN}
    # The percentiles of tables are those of a single run's metrics.
    assert tuple(s.percent for s in Statistic if s.percent) == PERCENTILES
    with pytest.raises(InputError, match="attitude_STAT_deg") as refused:
        named_metrics(["attitude_rms"])
    assert "\n" not in str(refused.value)
    assert "nees_all" in str(refused.value)
    with pytest.raises(InputError, match="each once"):
        named_metrics(["nis", "nis"])
