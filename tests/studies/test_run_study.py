"""Running a study: the folder it leaves, what it refuses, and the whole study."""

import csv
from pathlib import Path

import pytest

from pcnav.batch.cluster import Workers
from pcnav.config.pipeline_file import read_pipeline
from pcnav.core.errors import InputError
from pcnav.files.text_table import TextTable
from studies import STUDIES, run_study
from studies.folder import study_folder

OTHERS = [name for name in STUDIES if name != "yu2019"]


def test_unknown_study_and_too_few_runs_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"expected one of: .*yu2019"):
        run_study("yu1999", tmp_path / "out")
    with pytest.raises(InputError, match="at least 2"):
        run_study("yu2019", tmp_path / "out", runs=1)
    assert not list(tmp_path.iterdir())


def test_folder_is_refused_replaced_or_left_alone(tmp_path: Path) -> None:
    out = tmp_path / "study"
    with study_folder(out, overwrite=False) as staging:
        (staging / "index.html").write_text("first")
    with pytest.raises(InputError, match="overwrite"), study_folder(out, overwrite=False):
        pass
    with pytest.raises(RuntimeError, match="half"), study_folder(out, overwrite=True) as staging:
        (staging / "index.html").write_text("second")
        raise RuntimeError("half way")
    assert (out / "index.html").read_text() == "first"
    with study_folder(out, overwrite=True) as staging:
        (staging / "index.html").write_text("third")
    assert (out / "index.html").read_text() == "third"
    foreign = tmp_path / "thesis"
    foreign.mkdir()
    (foreign / "chapter.txt").write_text("years of work")
    with (
        pytest.raises(InputError, match=r"has no index\.html"),
        study_folder(foreign, overwrite=True),
    ):
        pass
    (foreign / "index.html").write_text("of a site")
    with (
        pytest.raises(InputError, match=r"has chapter\.txt"),
        study_folder(foreign, overwrite=True),
    ):
        pass
    assert sorted(path.name for path in tmp_path.iterdir()) == ["study", "thesis"]


def test_table_in_its_three_forms() -> None:
    table = TextTable("t", "Title", ("what", "m"), (("a|b", "1.0"), ("c,d", "2.0")), "A note.")
    assert table.to_csv() == 'what,m\na|b,1.0\n"c,d",2.0\n'
    assert "| a\\|b | 1.0 |" in table.to_markdown()
    assert table.to_rich().row_count == 2
    with pytest.raises(ValueError, match="differ in length"):
        TextTable("t", "Title", ("what", "m"), (("a",),))


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.study) for name in ("yu2019", *OTHERS)]
)
def test_a_quick_study_writes_everything(name: str, tmp_path: Path) -> None:
    if name == "applsci2022":
        pytest.importorskip("poselib", reason="the extra `images` is not installed")
    out, done = tmp_path / name, list[tuple[int, int]]()
    here = Workers(jobs=1)
    summary = run_study(name, out, runs=2, workers=here, on_progress=lambda *at: done.append(at))
    assert summary.page == out / "index.html" and summary.tables
    page = summary.page.read_text(encoding="utf-8")
    assert page.count("<figure>") == len(list((out / "figures").glob("*.svg"))) >= 3
    tables = sorted((out / "tables").glob("*.csv"))
    assert len(tables) >= 5
    for path in tables:
        with path.open(newline="", encoding="utf-8") as file:
            rows = list(csv.reader(file))
        assert len(rows) > 1 and all(len(row) == len(rows[0]) for row in rows), path.name
        assert path.with_suffix(".md").stat().st_size > 0
    for path in (out / "pipelines").glob("*.toml"):
        read_pipeline(path)
    assert [path.name for path in tmp_path.iterdir()] == [name]
    counts = [k for k, _ in done]
    assert counts == sorted(counts) and counts[-1] == done[0][1]


@pytest.mark.study
def test_the_whole_study_meets_the_paper(tmp_path: Path) -> None:
    run_study("yu2019", tmp_path / "yu")
    with (tmp_path / "yu" / "tables" / "verdict.csv").open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    missed = {row["quantity"] for row in rows if row["met"] != "yes"}
    # In a pure spin about a principal axis three ratios cannot be observed, whatever the filter.
    # The tilt of a panel of 1.5 m is known to 0.23 deg facing the sensor at 0.1 m noise: the bar of
    # 0.2 deg is reached about each axis, and may be missed by the angle of all three.
    assert missed - {"panel, 0.1 m: attitude RMS, whole angle, deg"} == {
        "inertia ratios that converge, printed spin"
    }
