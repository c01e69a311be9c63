"""Cases and their runs: names, seeds and keys."""

import itertools

from pcnav.batch.case import BatchRun, Case, batch_runs, batch_seed


def test_a_seed_depends_on_the_batch_not_on_the_order_of_axes() -> None:
    case = Case((("range_m", 10.0), ("satellite", "boxsat"), ("estimator", "pcnav")))
    turned = Case((("estimator", "kiss_icp"), ("satellite", "boxsat"), ("range_m", 10)))
    assert batch_seed(1, case, 0) == batch_seed(1, turned, 0)
    assert len({batch_seed(seed, case, index) for seed in (0, 1) for index in (0, 1)}) == 4
    # The same on every machine and in every version: results of a batch can be added to.
    assert batch_seed(1, case, 0) == 58248975


def test_keys_are_unique_and_name_files() -> None:
    pairs = itertools.product((15.0, 20.5), ("pcnav", "kiss_icp"))
    cases = [Case((("range_m", range_m), ("estimator", name))) for range_m, name in pairs]
    runs = batch_runs(cases, 3, seed=5)
    keys = {run.key for run in runs}
    assert len(keys) == len(runs)
    assert all(set(key) <= set("abcdefghijklmnopqrstuvwxyz0123456789.-") for key in keys)
    long = BatchRun(Case((("satellite", "/a/b" * 80 + ".obj"), ("estimator", "pcnav"))), 0, 1)
    assert len(long.key) < 90
    close = batch_runs([Case((("range_m", value),)) for value in (0.1, 0.1 + 1e-9)], 1, 0)
    assert close[0].key != close[1].key
