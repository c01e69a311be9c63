"""Two batches side by side: what is found, what is not, and how often chance raises an alarm."""

from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from pcnav.batch.axes import GridRun
from pcnav.batch.compare import (
    Change,
    case_change,
    case_table,
    compare,
    judged,
    mean_change,
    overall_table,
    verdict_lines,
)
from pcnav.batch.metrics import METRICS, Sample
from pcnav.batch.record import write_record
from pcnav.batch.statistics import Pool, once, replicates_of
from pcnav.batch.store import RunStore, new_store
from pcnav.core.errors import InputError
from tests.batch.made_up import records, some_runs

RMS = METRICS["position_rms_m"]


def of_each_run(metric: str, of_runs: np.ndarray) -> np.ndarray:
    """The metric of each of the runs (n, k) of one case."""
    pools = [Pool.of([Sample.known(values)]) for values in of_runs]
    return np.array([replicates_of(pool, once(1), [METRICS[metric]])[0, 0] for pool in pools])


def errors(generator: np.random.Generator, runs: int, frames: int = 10) -> np.ndarray:
    level = np.exp(0.4 * generator.normal(size=(runs, 1)))
    return np.asarray(level * np.abs(generator.normal(size=(runs, frames))))


def changed(generator: np.random.Generator, old: np.ndarray, factor: float) -> np.ndarray:
    """The same runs by another version: each a bit better or worse, all by a factor."""
    return np.asarray(factor * old * np.exp(0.15 * generator.normal(size=(len(old), 1))))


def change_of(metric: str, old: np.ndarray, new: np.ndarray, paired: bool = True) -> Change:
    values = [of_each_run(metric, each) for each in (old, new)]
    change = case_change("case", METRICS[metric], values[0], values[1], paired)
    assert change is not None
    return change


def batch_of_changes(
    generator: np.random.Generator, factor: float, cases: int = 12, runs: int = 5
) -> list[Change]:
    olds = [errors(generator, runs) for _ in range(cases)]
    return [change_of(RMS.name, old, changed(generator, old, factor)) for old in olds]


@pytest.mark.study
@pytest.mark.parametrize("paired", [True, False])
def test_chance_raises_an_alarm_in_no_more_than_one_batch_in_twenty(paired: bool) -> None:
    generator = np.random.default_rng(7)
    trials, alarms = 300, 0
    for _ in range(trials):
        changes = []
        for _ in range(8):
            old = errors(generator, 5)
            new = changed(generator, old, 1.0) if paired else errors(generator, 5)
            changes.append(change_of(RMS.name, old, new, paired))
        verdicts = judged([*changes, mean_change("all", changes)])
        alarms += any(each.verdict != "not sure" for each in verdicts)
    # Better or worse, 5 % in all: more than 24 of 300 have a probability of one in 100.
    assert alarms <= 24


@pytest.mark.parametrize(("factor", "verdict"), [(1.25, "worse"), (0.8, "better")])
def test_a_change_of_all_cases_is_found_in_their_mean(factor: float, verdict: str) -> None:
    generator = np.random.default_rng(8)
    found = []
    for _ in range(20):
        changes = batch_of_changes(generator, factor)
        found.append(judged([*changes, mean_change("all", changes)])[-1].verdict)
    assert found.count(verdict) >= 19


def test_a_deviation_is_that_of_a_paired_test() -> None:
    """Of a number a run has one of, the change of the mean is what a paired t-test takes."""
    generator = np.random.default_rng(9)
    old = generator.normal(80.0, 5.0, (9, 1))
    new = old - generator.normal(1.0, 2.0, (9, 1))
    change = change_of("locked_right_pct", old, new)
    reference = stats.ttest_rel(old[:, 0], new[:, 0])
    assert change.worsening == pytest.approx(np.mean(old - new))
    [verdict] = judged([change])
    bounds = reference.confidence_interval(0.95)
    assert (verdict.low, verdict.high) == pytest.approx((bounds.low, bounds.high))
    # Drawing pairs again tells the same deviation, but for the bootstrap's n in place of n - 1.
    drawn = stats.bootstrap(((old - new)[:, 0],), np.mean, rng=1).standard_error
    assert change.deviation == pytest.approx(drawn * np.sqrt(9 / 8), rel=0.03)
    # Unpaired, most of what differs from run to run would stand in the way.
    apart = change_of("locked_right_pct", old, new, paired=False)
    welch = stats.ttest_ind(old[:, 0], new[:, 0], equal_var=False).confidence_interval(0.95)
    [verdict] = judged([apart])
    assert (verdict.low, verdict.high) == pytest.approx((welch.low, welch.high))


def test_each_metric_has_its_own_way_to_get_worse() -> None:
    generator = np.random.default_rng(10)
    cases = (
        ("position_rms_m", 1.0, 2.0),
        ("locked_right_pct", 90.0, 80.0),
        ("locked_wrong_pct", 1.0, 5.0),
        ("nees_all", 1.0, 0.5),
        ("nees_all", 1.5, 3.0),
    )
    for name, before, after in cases:
        noise = 1.0 + 0.01 * generator.normal(size=(6, 4))
        there = change_of(name, noise * before, noise * after)
        back = change_of(name, noise * after, noise * before)
        verdicts = [each.verdict for each in judged([there, back])]
        assert verdicts == ["worse", "better"], name


def test_a_change_too_small_to_matter_is_no_regression_however_sure() -> None:
    old = errors(np.random.default_rng(1), 8)
    for factor, verdict in ((1.005, "not sure"), (1.02, "worse")):
        assert judged([change_of(RMS.name, old, factor * old)])[0].verdict == verdict


def test_intervals_widen_with_the_number_of_numbers_that_differ() -> None:
    changes = batch_of_changes(np.random.default_rng(2), 1.0)
    few, many = judged(changes[:1])[0], judged(changes)[0]
    assert many.high - many.low > few.high - few.low
    # Numbers that no run changed cannot raise an alarm and cost nothing.
    old = errors(np.random.default_rng(3), 5)
    same = change_of(RMS.name, old, old)
    assert judged([same])[0].verdict == "same"
    assert judged([changes[0], same, same])[0] == few


def store(folder: Path, runs: list[GridRun], grid: str = "grid", **made) -> RunStore:
    found = new_store(folder, grid, runs)
    for each in records(runs, **made):
        write_record(found.runs_folder, each)
    return found


def test_batches_are_compared_run_by_run(tmp_path: Path) -> None:
    runs = some_runs(4, satellites=("boxsat",), sigmas_m=(0.01,))
    old = store(tmp_path / "old", runs)
    same = compare(old, store(tmp_path / "same", runs))
    assert {each.verdict for each in (*same.overall, *same.cases)} == {"same"}
    assert not same.is_regression
    worse = compare(old, store(tmp_path / "worse", runs, factor=1.3))
    assert worse.is_regression
    assert {each.metric.name for each in worse.regressions} == {"position_sym_rms_m"}
    assert all(each.paired for each in worse.cases)
    # Every case and both means: a factor that is the same in all runs leaves no doubt.
    assert len(worse.regressions) == 6 + 2
    assert not compare(store(tmp_path / "again", runs, factor=1.3), old).is_regression


def test_other_seeds_are_compared_without_pairs(tmp_path: Path) -> None:
    few = {"satellites": ("boxsat",), "sigmas_m": (0.01,)}
    old = store(tmp_path / "old", some_runs(5, 1, **few))
    new = compare(old, store(tmp_path / "new", some_runs(5, 2, **few), "other"))
    assert not any(each.paired for each in new.cases)
    assert not new.is_regression
    assert not new.same_grid
    far = compare(old, store(tmp_path / "far", some_runs(5, 2, **few), "other", factor=4.0))
    assert {each.metric.name for each in far.regressions} == {"position_sym_rms_m"}


def test_a_run_that_fails_now_is_a_regression_and_cases_apart_are_told(tmp_path: Path) -> None:
    runs = some_runs(3, satellites=("boxsat",))
    old = store(tmp_path / "old", runs)
    failing = store(tmp_path / "new", runs[:-3], failures={runs[4].key: "no plane found"})
    found = compare(old, failing)
    assert found.is_regression
    assert not found.regressions
    assert found.newly_failed == (runs[4],)
    assert (found.only_old, found.only_new, found.repaired) == (1, 0, 0)
    assert any(str(runs[4]) in line for line in verdict_lines(found))
    assert any("1 cases only in the old" in line for line in verdict_lines(found))
    back = compare(failing, old)
    assert not back.is_regression
    assert back.repaired == 1


def test_batches_with_nothing_in_common_are_refused(tmp_path: Path) -> None:
    old = store(tmp_path / "old", some_runs(2, satellites=("boxsat",)))
    new = store(tmp_path / "new", some_runs(2, satellites=("twinwing",)))
    with pytest.raises(InputError, match="expected a case"):
        compare(old, new)
    with pytest.raises(InputError, match="--metrics: nothing"):
        compare(old, old, ["nothing"])


def test_tables_of_a_comparison_say_what_changed_by_how_much(tmp_path: Path) -> None:
    runs = some_runs(3, satellites=("boxsat",), sigmas_m=(0.01,))
    old = store(tmp_path / "old", runs)
    found = compare(old, store(tmp_path / "new", runs, factor=2.0), ["position_rms_m", "pose_pct"])
    overall, cases = overall_table(found), case_table(found, only_sure=True)
    assert len(overall.rows) == 2
    assert len(cases.rows) == 6
    assert all("+100.0 %" in row for row in (*overall.rows, *cases.rows))
    assert all(row[-1] == "worse" for row in cases.rows)
    assert "8 numbers" in overall.note
    assert verdict_lines(found)[0].startswith("16 numbers compared: 8 worse, 0 better")
