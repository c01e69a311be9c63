"""Tables of made-up batches: what a cell says, what is written, what the command line answers."""

import csv
import io
import os
import re
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from pcnav import cli
from pcnav.batch.axes import GridCase, GridRun, grid_case
from pcnav.batch.figures import sweeps
from pcnav.batch.grid import grid_runs
from pcnav.batch.metrics import SETTLED, EvaluationWindow, named_metrics
from pcnav.batch.record import RunRecord, write_record
from pcnav.batch.standard_tables import Wanted, asked_layout
from pcnav.batch.statistics import MetricValue
from pcnav.batch.store import RunStore, new_store
from pcnav.batch.tables import (
    TableLayout,
    csv_text,
    pivot,
    row_labels,
    run_table,
    shared_runs,
    text_tables,
    value_text,
)
from pcnav.batch.tabulate import kept_records, tabulate
from pcnav.core.errors import InputError
from pcnav.files.text_table import TextTable
from tests.batch.made_up import cases, record, records, some_runs

Pcnav = Callable[..., tuple[int, str, str]]
RUNS = some_runs(3, satellites=("boxsat",))
FAILURE = "InputError: x_1 & 50 % of <frames> are empty"
MESSAGES = {RUNS[4].key: FAILURE}


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> RunStore:
    """Three distances, two noise levels, two estimators, three runs; one of them failed."""
    return stored(tmp_path_factory.mktemp("batch") / "made", RUNS, failures=MESSAGES)


def stored(folder: Path, runs: list[GridRun], **made) -> RunStore:
    found = new_store(folder, '[batch]\nname = "made up"\n', runs)
    for each in records(runs, **made):
        write_record(found.runs_folder, each)
    return found


@pytest.fixture(scope="module")
def tables(store: RunStore, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The standard tables of it."""
    out = tmp_path_factory.mktemp("tables") / "out"
    tabulate(store, out)
    return out


@pytest.fixture
def pcnav(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Iterator[Pcnav]:
    """Call the entry point with arguments, in this process: exit code, stdout, stderr."""
    before = signal.getsignal(signal.SIGTERM)

    def call(*arguments: str | Path) -> tuple[int, str, str]:
        capsys.readouterr()
        monkeypatch.setattr(sys, "argv", ["pcnav", *map(str, arguments)])
        with pytest.raises(SystemExit) as ended:
            cli.main()
        out, err = capsys.readouterr()
        return int(ended.value.code or 0), out, err

    yield call
    signal.signal(signal.SIGTERM, before)


def read_made(run: GridRun) -> RunRecord:
    return record(run)


def rows_of(text: str) -> list[dict[str, str]]:
    return list(csv.DictReader(io.StringIO(text)))


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


def test_the_standard_tables_are_all_there(tables: Path, store: RunStore) -> None:
    keys = ("summary", "errors", "model", "states", "locking", "consistency", "bound", "cost")
    for key in keys:
        for suffix in (".csv", ".md", ".tex"):
            assert (tables / key).with_suffix(suffix).stat().st_size > 200, key + suffix
    statistics = rows_of((tables / "statistics.csv").read_text())
    assert len(statistics) == 12
    assert "position_p99_m_high" in statistics[0]
    assert sum(int(row["runs_failed"]) for row in statistics) == 1
    # Only a filter has covariances: rows of others would be empty.
    assert {row["estimator"] for row in rows_of((tables / "consistency.csv").read_text())} == {
        "pcnav"
    }
    failures = rows_of((tables / "failures.csv").read_text())
    assert [(row["run"], row["message"]) for row in failures] == [(str(RUNS[4]), FAILURE)]
    assert failures[0]["repeat"] == store.record(RUNS[4].key).command


def test_one_document_holds_all_tables_with_what_they_were_made_by(tables: Path) -> None:
    document = (tables / "index.md").read_text()
    for part in ("summary", "errors", "locking", "consistency"):
        for line in (tables / f"{part}.md").read_text().splitlines():
            assert not line.startswith("|") or line in document
    assert "36 runs of 12 cases, 1 of them failed. Tabulated on 20" in document
    assert "## The grid as run" in document and 'name = "made up"' in document


def test_an_interval_that_tells_nothing_is_called_wide() -> None:
    assert value_text(MetricValue(2.0, 1.0, 4.0)) == "2.00 [1.00, 4.00]"
    assert value_text(MetricValue(2.0, 1e-3, 4e3)) == "2.00 [wide]"
    # A shift has ends of both signs.
    assert value_text(MetricValue(2.0, -1.0, 5.0)) == "2.00 [-1.00, 5.00]"


def test_no_timing_is_in_any_table_but_that_of_the_cost(tables: Path) -> None:
    for path in tables.glob("*.csv"):
        header = path.read_text().splitlines()[0]
        assert ("_ms" in header or "memory" in header) == (path.stem == "cost"), path.name


def test_tables_are_the_same_to_the_bit_whatever_the_timings(
    tables: Path, store: RunStore, tmp_path: Path
) -> None:
    again = new_store(tmp_path / "ordered", "x", RUNS)
    for run in RUNS:
        made = store.record(run.key)
        columns = {k: v for k, v in made.columns.items() if k != "frame_ms"}
        values = dict(made.values) | {"ms_per_frame": 1.0, "peak_memory_mb": 1.0}
        other = RunRecord(run, columns, values, made.failure, made.versions, made.command)
        write_record(again.runs_folder, other)
    tabulate(again, tmp_path / "out")
    for path in sorted(tables.glob("*.*")):
        if path.stem not in ("cost", "index"):
            assert path.read_bytes() == (tmp_path / "out" / path.name).read_bytes(), path.name
    for path in (tables / "figures").iterdir():
        assert path.read_bytes() == (tmp_path / "out" / "figures" / path.name).read_bytes()


def test_tables_of_runs_without_poses_tell_the_mass_centre_and_leave_out_the_model(
    tmp_path: Path,
) -> None:
    runs = some_runs(2, satellites=("boxsat",), estimators=("pcnav",))
    store = new_store(tmp_path / "tracks", "x", runs)
    for made in records(runs):
        columns = dict(made.columns) | {"r_hill_error_m": made.columns["position_error_m"]}
        for name in ("position_error_m", "position_sym_error_m", "add_m", "add_s_m"):
            del columns[name]
        values = {name: x for name, x in made.values.items() if "rmse" not in name}
        write_record(store.runs_folder, replace(made, columns=columns, values=values))
    tabulate(store)
    tables = store.folder / "tables"
    assert not (tables / "model.md").exists()
    header = (tables / "summary.md").read_text().splitlines()[2]
    assert "mass centre in hill, median" in header and "position" not in header
    assert "r_hill_rms_m" in (tables / "errors.csv").read_text()
    assert "Error against distance" in (tables / "index.html").read_text()


class _Page(HTMLParser):
    """What a page loads from elsewhere, the text it shows, and tags that do not close."""

    def __init__(self) -> None:
        super().__init__()
        self.links: list[str] = []
        self.text: list[str] = []
        self.open: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.links += [value or "" for name, value in attrs if name in ("src", "href")]
        if tag not in ("meta", "br", "img"):
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.text.append(data)


def test_the_page_carries_all_it_shows(tables: Path, store: RunStore) -> None:
    page = _Page()
    page.feed((tables / "index.html").read_text())
    assert not page.open
    assert len(page.links) == 2
    assert all(link.startswith("data:image/svg+xml;base64,") for link in page.links)
    text = " ".join(page.text)
    for told in (
        FAILURE,
        store.record(RUNS[4].key).command,
        "36",
        "Error against distance: boxsat",
        "Error against range noise: boxsat",
        'name = "made up"',
        "Open3D point-to-plane",
        "the first pose, off by 5 deg",
        "second half of each run",
    ):
        assert told in text, told


def test_records_are_kept_as_far_as_memory_is_given(store: RunStore) -> None:
    read = kept_records(store, max_bytes=20_000)
    first = read(RUNS[0])
    assert read(RUNS[0]) is first
    for run in RUNS:
        read(run)
    # Not all of them fit, the latest do.
    assert read(RUNS[-1]) is read(RUNS[-1])
    assert read(RUNS[0]) is not first


@pytest.mark.parametrize("rows", [3, 60])
def test_latex_compiles(tmp_path: Path, rows: int, tables: Path) -> None:
    if shutil.which("pdflatex") is None:
        pytest.skip("pdflatex is not installed")
    strange = r'a_b & 50 % of <it> [x] #1 $y {z} ~ ^ \n "q" | 100'
    body = tuple((strange, f"[{k}]") for k in range(rows))
    own = TextTable("strange_table", strange, ("what, m", strange), body, strange).to_latex()
    texts = [path.read_text() for path in sorted(tables.glob("*.tex"))] if rows < 40 else []
    document = (
        "\\documentclass{article}\n\\usepackage{booktabs,longtable}\n"
        "\\usepackage[a3paper,landscape]{geometry}\n\\begin{document}\\tiny\n"
        + "\n".join([own, *texts])
        + "\n\\end{document}\n"
    )
    (tmp_path / "all.tex").write_text(document)
    command = ["pdflatex", "-interaction=nonstopmode", "-halt-on-error", "all.tex"]
    done = subprocess.run(
        command, cwd=tmp_path, capture_output=True, text=True, timeout=120, check=False
    )
    assert done.returncode == 0, done.stdout[-2000:]
    assert ("longtable" in own) == (rows > 40)


def test_latex_escapes_what_it_would_read_as_its_own(tables: Path) -> None:
    table = TextTable("t", "100 % & more", ("a_b",), (("[1] #2",),))
    text = table.to_latex()
    for escaped in (r"100 \% \& more", r"{a\_b} \\", r"{[1] \#2} \\"):
        assert escaped in text
    for path in tables.glob("*.tex"):
        body = path.read_text()
        assert body.count("\\begin{tabular}") == body.count("\\end{tabular}") >= 1
        cells = {line.count(" & ") for line in re.findall(r"^\{.*\\\\$", body, re.MULTILINE)}
        assert len(cells) == 1, path.name


def test_a_pivot_is_what_was_asked_for() -> None:
    runs = run_table(RUNS)
    layout = asked_layout(Wanted(("range_m",), ("estimator",), ("add_s_p95_m",)), runs)
    assert (layout.rows, layout.columns) == (("range_m",), ("estimator",))
    assert asked_layout(Wanted(metrics=("nis",)), runs).rows == ("range_m", "range_sigma_m")
    assert asked_layout(Wanted(rows=("estimator",)), runs).columns == ()
    for wanted, message in (
        (Wanted(rows=("range",)), "--rows: range: expected some of: satellite, range_m"),
        (Wanted(columns=("x",)), "--columns: x: expected some of"),
        (Wanted(("estimator",), ("estimator",)), "not among the rows"),
        (Wanted(("range_m", "range_m")), "each axis once"),
        (Wanted(metrics=("speed",)), "--metrics: speed"),
        (Wanted(metrics=()), "one or more"),
    ):
        with pytest.raises(InputError, match=re.escape(message)):
            asked_layout(wanted, runs)


def test_the_command_tabulates_again_without_running(
    pcnav: Pcnav, store: RunStore, tmp_path: Path
) -> None:
    before = {path: path.stat().st_mtime_ns for path in store.runs_folder.iterdir()}
    code, out, err = pcnav(
        *("table", store.folder, "-o", tmp_path / "t", "--from", "5"),
        *("--rows", "range_m, range_sigma_m", "--columns", "estimator"),
        *("--metrics", "attitude_rms_deg,position_p95_m"),
    )
    assert (code, err) == (0, "")
    assert "attitude, RMS, deg" in out and "position, 95 %, mm" in out
    assert FAILURE in out
    assert "Errors over the frames from 5 s after the first on." in out
    rows = rows_of((tmp_path / "t" / "pivot.csv").read_text())
    assert len(rows) == 12
    assert {path: path.stat().st_mtime_ns for path in store.runs_folder.iterdir()} == before


THREADS = """
import os, sys
from importlib.abc import MetaPathFinder
class Watch(MetaPathFinder):
    def find_spec(self, name, path, target=None):
        if name == "numpy":
            print("numpy with", os.environ.get("OPENBLAS_NUM_THREADS"))
sys.meta_path.insert(0, Watch())
sys.argv = ["pcnav", "table", "nosuchgrid"]
from pcnav.cli import main
main()
"""


def test_the_libraries_are_loaded_for_one_thread(repository: Path) -> None:
    """As in the processes of a batch: sums over several threads depend on their number."""
    variables = {k: v for k, v in os.environ.items() if not k.endswith("_NUM_THREADS")}
    command = [sys.executable, "-c", THREADS]
    done = subprocess.run(
        command, env=variables, cwd=repository, capture_output=True, text=True, check=False
    )
    assert done.stdout.splitlines()[0] == "numpy with 1"
    assert "nosuchgrid: grid: expected a TOML file" in done.stderr


def test_bad_commands_are_one_line_each(pcnav: Pcnav, store: RunStore, tmp_path: Path) -> None:
    folder, other = store.folder, tmp_path / "other"
    other.mkdir()
    (other / "precious.txt").write_text("mine")
    for arguments, told in (
        ((), "expected a grid, a batch or --compare"),
        ((folder, "--rows", "range"), "--rows: range: expected some of: satellite"),
        ((folder, "--metrics", "speed_m"), "--metrics: speed_m: expected some of"),
        ((folder, "--jobs", "2"), "--jobs: expected none"),
        ((folder, "--from", "1000"), "--from: expected at most"),
        (("nosuchbatch",), "nosuchbatch"),
        ((folder, "-o", other), "empty or new folder"),
        ((folder, "-o", other, "--overwrite"), "no index.html"),
        ((other,), "expected that of a batch, with batch.json"),
        ((tmp_path / "none.toml", "-o", tmp_path / "x"), "grid: expected a TOML file or one of"),
        (("accuracy",), "--out: expected a folder"),
        (("--compare", folder, other), "expected that of a batch"),
        (("--compare", folder, folder, "--rows", "range_m"), "--rows: expected none"),
        (("--compare", folder, folder, "--metrics", "x"), "--metrics: x"),
    ):
        code, _, err = pcnav("table", *arguments)
        assert code == 2, arguments
        assert told in err, err
        assert err.count("\n") == 1
    assert [path.name for path in other.iterdir()] == ["precious.txt"]


def test_a_comparison_answers_with_its_exit_code(
    pcnav: Pcnav, store: RunStore, tmp_path: Path
) -> None:
    worse = stored(tmp_path / "worse", RUNS, factor=1.5, failures=MESSAGES).folder
    assert pcnav("table", "--compare", store.folder, store.folder)[0] == 0
    code, out, _ = pcnav(
        "table", "--compare", store.folder, worse, "--metrics", "attitude_rms_deg,pose_pct"
    )
    assert code == 0  # Only the position is worse.
    assert "0 worse" in out
    code, out, err = pcnav("table", "--compare", store.folder, worse)
    assert (code, err) == (1, "")
    assert "+50.0 %" in out
    assert "worse" in out
    assert pcnav("table", "--compare", worse, store.folder)[0] == 0


def test_a_batch_without_a_finished_run_has_no_table(tmp_path: Path) -> None:
    empty = new_store(tmp_path / "empty", "x", RUNS)
    with pytest.raises(InputError, match="at least one finished run"):
        tabulate(empty)
    assert not (tmp_path / "empty" / "tables").exists()


def test_a_batch_of_failures_alone_still_has_its_tables(tmp_path: Path) -> None:
    runs = RUNS[:4]
    failed = stored(tmp_path / "failed", runs, failures={run.key: "no" for run in runs})
    summary = tabulate(failed)
    assert len(summary.failures) == 4
    assert summary.page == tmp_path.resolve() / "failed" / "tables" / "index.html"
    text = (summary.page.parent / "locking.md").read_text()
    assert "| 3, 3 failed |" in text and "| 1, 1 failed |" in text
    # Tabulating again takes the place of the tables that are there.
    tabulate(failed)
