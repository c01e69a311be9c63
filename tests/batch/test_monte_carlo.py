"""Tests of Monte Carlo runs of named cases."""

from itertools import chain

import numpy as np
import pytest

from pcnav.batch.cluster import Workers
from pcnav.batch.engine import RunError
from pcnav.batch.monte_carlo import (
    Case,
    Run,
    RunBatch,
    batches,
    monte_carlo,
    run_seed,
    runs_of,
    work_of,
)

HERE, TWO = Workers(jobs=1), Workers(jobs=2)
CASES = [Case("calm", 0.5, work=2.0), Case("loud", 4.0, work=3.0)]


def noise(run: Run[float]) -> float:
    return float(run.case.settings * np.random.default_rng(run.seed).standard_normal())


def noises(batch: RunBatch[float]) -> list[float]:
    return [noise(run) for run in batch.runs]


def fails_once(run: Run[float]) -> int:
    if run.index == 1 and run.case.name == "loud":
        raise ValueError("too loud")
    return run.index


def test_results_are_grouped_by_case_in_the_order_of_the_runs() -> None:
    runs = runs_of("noise", CASES, 3)
    found = monte_carlo(noise, runs, HERE)
    assert list(found) == ["calm", "loud"]
    assert found["calm"] == [noise(run) for run in runs[:3]]
    # All cases meet the same draws.
    np.testing.assert_allclose(np.array(found["loud"]) / np.array(found["calm"]), 8.0)


def test_other_processes_and_batches_of_runs_give_the_same() -> None:
    runs = runs_of("noise", CASES, 5)
    alone = monte_carlo(noise, runs, HERE)
    assert monte_carlo(noise, runs, TWO) == alone
    together = batches(runs, 2)
    assert [len(batch.runs) for batch in together] == [2, 2, 1, 2, 2, 1]
    assert together[0].seeds == (runs[0].seed, runs[1].seed)
    joined = monte_carlo(noises, together, HERE)
    assert {name: list(chain(*parts)) for name, parts in joined.items()} == alone


def test_work_done_adds_up_to_the_work_of_all_items() -> None:
    runs, done = runs_of("noise", CASES, 3), list[float]()
    monte_carlo(noise, runs, HERE, done.append)
    assert done == [2.0] * 3 + [3.0] * 3
    assert sum(done) == work_of(runs) == work_of(batches(runs, 2)) == 15.0


def test_seeds_are_the_same_on_every_machine_and_differ_by_name_and_index() -> None:
    assert run_seed("cold starts", 0) == 1457920327
    seeds = {run_seed(name, k) for name in ("cold starts", "faults") for k in range(500)}
    assert len(seeds) == 1000
    runs = runs_of("faults", CASES, 3)
    assert [run.seed for run in runs] == [run_seed("faults", k) for k in range(3)] * 2
    assert str(runs[4]) == f"loud, run 1 (seed {runs[1].seed})"


def test_a_run_that_fails_is_named_and_ends_all() -> None:
    done = list[float]()
    with pytest.raises(
        RunError, match=r"^loud, run 1 \(seed \d+\): ValueError: too loud"
    ) as caught:
        monte_carlo(fails_once, runs_of("noise", CASES, 3), HERE, done.append)
    assert len(done) == 4
    assert "fails_once" in "".join(caught.value.__notes__)
    assert str(batches(runs_of("noise", CASES, 5), 3)[1]).startswith("calm, runs 3 to 4 (from seed")
