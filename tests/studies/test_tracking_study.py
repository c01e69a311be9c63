"""The tracking study as a whole, with few runs and short sequences."""

import csv
from pathlib import Path

import pytest

from pcnav.config.pipeline_file import read_pipeline
from studies import run_study
from studies.tracking.faults import FAULTS

TABLES = (
    "verdict",
    "cold_starts",
    "cold_start_failures",
    "blackouts",
    "blackout_runs",
    "consistency",
    "cramer_rao",
    "consistency_worst",
    "faults",
    "silent_wrong",
)


def rows_of(path: Path) -> list[dict[str, str]]:
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


@pytest.mark.study
def test_a_quick_study_writes_everything(tmp_path: Path) -> None:
    out = tmp_path / "tracking"
    done: list[tuple[int, int]] = []
    summary = run_study("tracking", out, runs=2, on_progress=lambda k, n: done.append((k, n)))
    page = summary.page.read_text(encoding="utf-8")
    assert page.count("<figure>") == len(list((out / "figures").glob("*.svg"))) == 7
    for name in TABLES:
        assert rows_of(out / "tables" / f"{name}.csv"), name
    assert [path.stem for path in sorted((out / "tables").glob("*.csv"))] == sorted(TABLES)
    assert read_pipeline(out / "pipelines" / "twinwing.toml").target_mesh == "twinwing"
    counts = [k for k, _ in done]
    assert counts == sorted(counts) and counts[-1] == done[0][1]
    starts = rows_of(out / "tables" / "cold_starts.csv")
    assert [row["satellite"] for row in starts] == ["boxsat", "cubesat6u", "twinwing"]
    assert {row["starts"] for row in starts} == {"6"}
    assert [row["symmetry"] for row in starts] == ["C1", "C2 about x", "C2 about z"]
    faults = rows_of(out / "tables" / "faults.csv")
    assert [row["fault"] for row in faults] == list(FAULTS)
    assert {row["met"] for row in rows_of(out / "tables" / "verdict.csv")} <= {"yes", "no"}
