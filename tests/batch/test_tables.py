"""Tables of made-up batches: what a cell says, and how rows and columns are laid out."""

import re

import numpy as np
import pandas as pd
import pytest

from pcnav.batch.axes import GridCase, GridRun, grid_case
from pcnav.batch.figures import sweeps
from pcnav.batch.grid import grid_runs
from pcnav.batch.metrics import SETTLED, EvaluationWindow, named_metrics
from pcnav.batch.record import RunRecord
from pcnav.batch.tables import (
    TableLayout,
    csv_text,
    pivot,
    row_labels,
    run_table,
    shared_runs,
    text_tables,
)
from tests.batch.made_up import cases, record
from tests.batch.stored_batch import RUNS, rows_of


def read_made(run: GridRun) -> RunRecord:
    return record(run)


def pivoted(
    rows: tuple[str, ...],
    columns: tuple[str, ...],
    metrics: list[str],
    runs: list[GridRun] | None = None,
    window: EvaluationWindow = SETTLED,
) -> tuple[TableLayout, pd.Series]:
    layout = TableLayout("t", "t", rows, columns, named_metrics(metrics))
    return layout, pivot(layout, run_table(runs or RUNS), read_made, window)


def test_cells_pool_the_runs_of_the_cases_they_stand_for() -> None:
    _, cells = pivoted(
        ("range_m",), ("estimator",), ["position_max_m"], window=EvaluationWindow(0.0)
    )
    places = [(r, e) for r in (10.0, 20.0, 40.0) for e in ("pcnav", "open3d_icp")]
    assert list(cells.index) == places
    for place, cell in zip(places, cells, strict=True):
        members = [
            run
            for run in RUNS
            if {("range_m", place[0]), ("estimator", place[1])} <= set(run.case.settings)
        ]
        assert cell.runs == len(members) == 6
        largest = max(np.max(record(run).numbers("position_error_m")) for run in members)
        assert cell.values["position_max_m"].value == largest


def test_csv_holds_every_digit_and_names_its_units() -> None:
    metrics = ["position_rms_m", "nees_all", "rate_p95_deg_s"]
    layout, cells = pivoted(("range_m", "estimator"), (), metrics)
    rows = rows_of(csv_text(layout, cells))
    assert len(rows) == 6
    for row, place, cell in zip(rows, cells.index.tolist(), cells, strict=True):
        assert (row["range_m"], row["estimator"]) == (f"{place[0]:g}", place[1])
        for metric in metrics:
            found = cell.values[metric]
            if not found.exists:
                assert row[metric] == row[f"{metric}_low"] == ""
                continue
            assert float(row[metric]) == found.value
            assert float(row[f"{metric}_high"]) == found.high
    judged = [row["nees_all_judged"] for row in rows if row["estimator"] == "pcnav"]
    assert judged == ["pass"] * 3
    assert float(rows[0]["nees_all_lower_bound"]) < 1.0 < float(rows[0]["nees_all_upper_bound"])


def test_units_go_to_the_header_and_small_errors_are_shown_in_thousandths() -> None:
    metrics = ["position_rms_m", "attitude_median_deg", "inertia_ratio_rms"]
    layout, cells = pivoted(("range_m",), (), metrics)
    [table] = text_tables(layout, cells, SETTLED)
    assert table.header == (
        "distance, m",
        "position, RMS, mm",
        "attitude, median, deg",
        "inertia ratios, RMS",
        "runs",
    )
    value = cells.iloc[0].values["position_rms_m"].value
    assert float(table.rows[0][1].split()[0]) == pytest.approx(1e3 * value, rel=5e-3)
    assert "second half of each run" in table.note


def test_bounds_that_all_rows_share_stand_in_the_header() -> None:
    runs = [run for run in RUNS if ("estimator", "pcnav") in run.case.settings]
    [table] = text_tables(*pivoted(("range_m",), (), ["nees_all", "nis"], runs), SETTLED)
    assert re.fullmatch(r"NEES of all states in 0\.\d+ to 1\.\d+", table.header[1])
    assert all(row[1].endswith("] pass") for row in table.rows)


def test_columns_of_several_axes_are_in_order_and_holes_are_shown() -> None:
    runs = [run for run in RUNS if ("range_m", 20.0) not in run.case.settings or run.index]
    without = [run for run in runs if run.case.name != RUNS[0].case.name]
    layout, cells = pivoted(
        ("range_m",), ("estimator", "range_sigma_m"), ["add_rms_m"], list(reversed(without))
    )
    [table] = text_tables(layout, cells, SETTLED)
    # Words as they come in the batch, numbers rising.
    assert table.header[1:] == (
        *("open3d_icp, 0.01", "open3d_icp, 0.02"),
        *("pcnav, 0.01", "pcnav, 0.02"),
    )
    assert [row[0] for row in table.rows] == ["10", "20", "40"]
    assert [row[3] == "-" for row in table.rows] == [True, False, False]


def test_many_axes_are_told_by_what_is_not_as_usual() -> None:
    def case(**changed: float | str) -> GridCase:
        usual: dict[str, float | str]
        usual = {"satellite": "boxsat", "range_m": 20.0, "tumble_deg_s": 3.0}
        usual |= {"range_sigma_m": 0.02, "outlier_share": 0.0, "estimator": "pcnav"}
        return grid_case(tuple((usual | changed).items()))

    plan = [case(range_m=40.0), case(), case(range_m=10.0, outlier_share=0.05), case(range_m=10.0)]
    axes = ("satellite", "range_m", "tumble_deg_s", "range_sigma_m", "outlier_share", "estimator")
    layout, cells = pivoted(axes, (), ["add_rms_m"], grid_runs(plan, 2, 1))
    labels = row_labels(axes, cells.index)
    # Two of four cases are at 10 m: that is the usual distance here.
    assert labels.header == ("case", "estimator")
    names = [text[0] for text in labels.texts]
    assert names == ["base", "distance 20 m", "distance 40 m", "outliers 0.05"]
    assert "distance 10 m" in labels.note
    [table] = text_tables(layout, cells, SETTLED)
    assert [row[0] for row in table.rows] == names
    by_range = {float(row["range_m"]): row for row in rows_of(csv_text(layout, cells))}
    shown = float(table.rows[2][2].split()[0])
    assert shown == pytest.approx(1e3 * float(by_range[40.0]["add_rms_m"]), rel=5e-3)


def values_in(runs: pd.DataFrame, axis: str) -> set[object]:
    return set(runs[axis])


def test_a_summary_pools_what_its_estimators_have_in_common() -> None:
    plan = cases(satellites=("boxsat",), estimators=("pcnav", "open3d_icp"))
    plan += cases(estimators=("small_gicp",))[:2]
    without = plan[1]
    kept = shared_runs(run_table(grid_runs([case for case in plan if case != without], 2, 1)))
    assert values_in(kept, "estimator") == {"pcnav", "open3d_icp"}
    scenarios = kept.groupby("estimator", observed=True)["scenario"].agg(set)
    assert scenarios["pcnav"] == scenarios["open3d_icp"]
    assert len(scenarios["pcnav"]) == 5


def test_sweeps_vary_one_axis_and_nothing_else() -> None:
    plan = cases(satellites=("boxsat",), sigmas_m=(0.02,))
    plan += cases(satellites=("boxsat",), ranges_m=(20.0,), sigmas_m=(0.01, 0.05))
    # A case off the lines, and an estimator that is at one point alone.
    plan += cases(satellites=("boxsat",), ranges_m=(80.0,), sigmas_m=(0.5,))
    plan += cases(satellites=("boxsat",), ranges_m=(20.0,), sigmas_m=(0.07,), estimators=("x",))
    found = {sweep.axis: sweep for sweep in sweeps(run_table(grid_runs(plan, 2, 1)))}
    assert set(found) == {"range_m", "range_sigma_m"}
    expected = {"range_m": ({10.0, 20.0, 40.0}, "range_sigma_m", {0.02})}
    expected["range_sigma_m"] = ({0.01, 0.02, 0.05}, "range_m", {20.0})
    for axis, (points, other, fixed) in expected.items():
        runs = found[axis].runs
        assert values_in(runs, axis) == points
        assert values_in(runs, other) == fixed
        assert values_in(runs, "estimator") == {"pcnav", "open3d_icp"}
    assert found["range_m"].key == "range_m_boxsat"


def test_sweeps_pool_only_what_was_run_at_every_point() -> None:
    plan = cases(satellites=("boxsat",))
    missing = grid_case(
        (
            ("satellite", "boxsat"),
            ("range_m", 40.0),
            ("range_sigma_m", 0.02),
            ("estimator", "open3d_icp"),
        )
    )
    runs = grid_runs([case for case in plan if case != missing], 1, 1)
    [sweep] = [each for each in sweeps(run_table(runs)) if each.axis == "range_m"]
    # At 0.02 m only one of the estimators has all distances: what is pooled is the other noise.
    assert values_in(sweep.runs, "range_sigma_m") == {0.01}
    assert sweep.pooled == {"range_sigma_m": [0.01]}
