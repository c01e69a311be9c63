"""Runs over processes: order, seeds, threads, and failures that say which run it was."""

import math
import os

import pytest

from pcnav.studies.batch import Run, RunError, run_all, run_seed, runs_of


def test_seeds_are_the_same_on_every_machine_and_differ_by_name_and_index() -> None:
    assert run_seed("cold starts", 0) == 1457920327
    seeds = {run_seed(name, k) for name in ("cold starts", "faults") for k in range(500)}
    assert len(seeds) == 1000


def test_cases_meet_the_same_truths() -> None:
    runs = runs_of("faults", ("none", "outliers"), 3)
    assert [run.case for run in runs] == ["none"] * 3 + ["outliers"] * 3
    assert [run.seed for run in runs[:3]] == [run.seed for run in runs[3:]]
    assert len({run.seed for run in runs}) == 3
    assert str(runs[4]) == f"outliers, run 1 (seed {runs[1].seed})"


def test_results_keep_the_order_of_the_items_and_each_is_counted() -> None:
    counted: list[int] = []
    squares = [float(k * k) for k in range(6)]
    assert run_all(math.sqrt, squares, 1, lambda: counted.append(1)) == [0, 1, 2, 3, 4, 5]
    assert len(counted) == 6
    assert run_all(math.sqrt, [], None) == []


def test_a_failing_run_is_named_and_ends_the_batch() -> None:
    def fail_on_the_second(run: Run) -> int:
        if run.index == 1:
            raise ValueError("no such pose")
        return run.index

    runs, counted = runs_of("faults", ("none",), 3), []
    with pytest.raises(
        RunError, match=r"none, run 1 \(seed \d+\): ValueError: no such p"
    ) as caught:
        run_all(fail_on_the_second, runs, 1, lambda: counted.append(1))
    assert len(counted) == 1
    assert "fail_on_the_second" in "".join(caught.value.__notes__)


def test_processes_work_on_one_thread_each_and_name_a_failing_run(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # What another process is to call must be importable there, which a test module is not.
    monkeypatch.setenv("OMP_NUM_THREADS", "7")
    monkeypatch.delenv("MKL_NUM_THREADS", raising=False)
    names = ["OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS"]
    assert run_all(os.getenv, names, 2) == ["1", "1", "1"]
    assert os.environ["OMP_NUM_THREADS"] == "7" and "MKL_NUM_THREADS" not in os.environ
    with pytest.raises(RunError, match=r"^-1\.0: ValueError"):
        run_all(math.sqrt, [4.0, -1.0], 2)
