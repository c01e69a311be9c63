"""Tests of runs of named cases."""

from pcnav.batch.monte_carlo import Case, batches, run_seed, runs_of

CASES = [Case("calm", 0.5, work=2.0), Case("loud", 4.0, work=3.0)]


def test_batches_hold_the_runs_of_one_case_in_order() -> None:
    runs = runs_of("noise", CASES, 5)
    together = batches(runs, 2)
    assert [run for batch in together for run in batch.runs] == runs
    assert [len(batch.runs) for batch in together] == [2, 2, 1, 2, 2, 1]
    assert all(run.case == batch.case for batch in together for run in batch.runs)
    assert together[0].seeds == (runs[0].seed, runs[1].seed)
    assert [batch.work for batch in together] == [4.0, 4.0, 2.0, 6.0, 6.0, 3.0]
    assert str(batches(runs, 3)[1]).startswith("calm, runs 3 to 4 (from seed")


def test_seeds_are_the_same_on_every_machine_and_differ_by_name_and_index() -> None:
    assert run_seed("cold starts", 0) == 1457920327
    seeds = {run_seed(name, k) for name in ("cold starts", "faults") for k in range(500)}
    assert len(seeds) == 1000
    runs = runs_of("faults", CASES, 3)
    assert [run.seed for run in runs] == [run_seed("faults", k) for k in range(3)] * 2
    assert str(runs[4]) == f"loud, run 1 (seed {runs[1].seed})"
