"""The tables and documents that a batch writes."""

import re
import shutil
import subprocess
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import pytest

from pcnav.batch.record import RunRecord, write_record
from pcnav.batch.statistics import MetricValue
from pcnav.batch.store import RunStore, new_store
from pcnav.batch.tables import (
    value_text,
)
from pcnav.batch.tabulate import kept_records, tabulate
from pcnav.files.text_table import TextTable
from tests.batch.made_up import records, some_runs
from tests.batch.stored_batch import FAILURE, RUNS, rows_of
from tests.commands import PATIENCE_S


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
        assert ("_ms," in header or "memory" in header) == (path.stem == "cost"), path.name


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
        command, cwd=tmp_path, capture_output=True, text=True, timeout=PATIENCE_S, check=False
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
