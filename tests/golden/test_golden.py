"""Today's numbers against the recorded ones, and what the comparison itself sees."""

import math
from pathlib import Path

import numpy as np
import pytest

from tests.golden.cases import CASES, QUICK
from tests.golden.changes import EXPLAINED, TOLERANCE, Explained
from tests.golden.compare import compare
from tests.golden.contents import Contents, cell, contents, read_contents, write_contents
from tests.golden.running import DATA, check_case, rounds_as_recorded

LARGEST_BYTES = 1_500_000
RECORDED: Contents = {
    "result/states.csv": {"time_s": ["0", "1"], "r_x_m": ["25", "1e-15"], "status": ["a", "b c"]},
    "result/metrics.json": {"errors.attitude_deg.rms": ["0.0137754510077"], "frames": ["40"]},
    "known.txt": {"line": ["attitude x 0.25 deg", "rate x 3 deg/s"]},
}


@pytest.fixture(scope="session")
def recordings_machine() -> None:
    """Skips where even unchanged code gives other last digits; `make golden` compares anyway."""
    if not rounds_as_recorded():
        pytest.skip("this machine rounds otherwise than the one of the recording")


@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=() if name in QUICK else pytest.mark.study) for name in CASES],
)
def test_no_number_has_moved(name: str, recordings_machine: None, tmp_path: Path) -> None:
    comparison = check_case(name, tmp_path)
    assert not comparison.differences, str(comparison)


def test_every_case_is_recorded_and_all_are_small() -> None:
    assert {path.name for path in DATA.iterdir()} == set(CASES)
    assert all(read_contents(DATA / name) for name in CASES)
    files = (path for path in DATA.rglob("*") if path.is_file())
    assert sum(path.stat().st_size for path in files) < LARGEST_BYTES


def test_every_explanation_is_of_a_case() -> None:
    for pattern, explained in EXPLAINED.items():
        assert pattern.split("/")[0] in {*CASES, "*"} and explained.reason


def changed(file: str, column: str, row: int, text: str) -> Contents:
    """The recorded tables with one cell replaced."""
    today = {name: {key: [*cells] for key, cells in t.items()} for name, t in RECORDED.items()}
    today[file][column][row] = text
    return today


def places(today: Contents, **tables: dict[str, str] | dict[str, Explained]) -> list[str]:
    """Where today's tables differ from the recorded ones."""
    nothing: dict[str, dict[str, str]] = {"renamed": {}, "reworded": {}, "explained": {}}
    comparison = compare("case", RECORDED, today, **(nothing | tables))  # type: ignore[arg-type]
    return [difference.place for difference in comparison.differences]


def test_the_same_is_the_same() -> None:
    comparison = compare("case", RECORDED, RECORDED)
    assert str(comparison) == "same" and comparison.largest == 0.0


@pytest.mark.parametrize(
    ("file", "column", "row", "text"),
    [
        ("result/states.csv", "r_x_m", 0, cell(25.0 * (1.0 + 4.0 * TOLERANCE))),
        ("result/states.csv", "r_x_m", 1, "1e-7"),
        ("result/states.csv", "r_x_m", 1, ""),
        ("result/states.csv", "status", 1, "b d"),
        ("result/metrics.json", "errors.attitude_deg.rms", 0, "0.0137754510377"),
        ("result/metrics.json", "frames", 0, "41"),
        ("known.txt", "line", 1, "rate x 4 deg/s"),
        ("known.txt", "line", 1, "rate y 3 deg/s"),
    ],
)
def test_a_change_is_seen(file: str, column: str, row: int, text: str) -> None:
    assert places(changed(file, column, row, text)) == [f"case/{file}/{column}"]


@pytest.mark.parametrize(("row", "text"), [(0, cell(25.0 * (1.0 + 0.5 * TOLERANCE))), (1, "-2e-9")])
def test_rounding_is_not_a_change(row: int, text: str) -> None:
    today = changed("result/states.csv", "r_x_m", row, text)
    comparison = compare("case", RECORDED, today)
    assert not comparison.differences and "same to" in str(comparison)


def test_what_comes_and_goes_is_seen() -> None:
    today = changed("known.txt", "line", 0, "attitude x 0.25 deg")
    today["result/new.csv"] = {"a": ["1"]}
    del today["result/metrics.json"]
    today["known.txt"]["line"].append("more")
    today["result/states.csv"]["more"] = ["1", "2"]
    assert places(today) == [
        "case/known.txt/line",
        "case/result/metrics.json",
        "case/result/new.csv",
        "case/result/states.csv/more",
    ]


def test_names_and_words_may_be_renamed() -> None:
    today = changed("known.txt", "line", 1, "turn rate x 3 deg/s")
    states = today.pop("result/states.csv")
    states["position_x_m"] = states.pop("r_x_m")
    states["status"] = ["first", "b c"]
    today["result/track.csv"] = states
    today["result/metrics.json"]["errors.angle_deg.rms"] = today["result/metrics.json"].pop(
        "errors.attitude_deg.rms"
    )
    renamed = {"states.csv": "track.csv", "r_x_m": "position_x_m", "attitude_deg": "angle_deg"}
    reworded = {"a": "first", "rate": "turn rate"}
    assert places(today, renamed=renamed, reworded=reworded) == []
    assert places(today)


def test_an_explained_change_may_go_so_far_and_no_farther() -> None:
    today = changed("result/metrics.json", "frames", 0, "41")
    place = "case/result/metrics.json/frames"
    for allowed, expected in ((0.1, []), (0.01, [place]), (math.inf, [])):
        explained = {"case/result/*/frames": Explained("a frame more", allowed)}
        assert places(today, explained=explained) == expected
    explained = {place: Explained("a frame more", absolute=1.0)}
    assert places(today, explained=explained) == []


def test_files_become_tables_that_are_read_back(tmp_path: Path) -> None:
    made = tmp_path / "made"
    made.mkdir()
    rows = "".join(f"{k},{k / 3},{'odd' if k % 2 else ''}\n" for k in range(100))
    (made / "states.csv").write_text("time_s,third,word\n" + rows)
    (made / "metrics.json").write_text('{"frames": 3, "nis": {"mean": null, "bounds": [0.5, 2]}}')
    covariances = np.stack([np.diag([1.0, 4.0]), np.array([[1.0, 0.5], [0.5, 1.0]])])
    np.savez(made / "covariances.npz", P=covariances, time_s=np.arange(2.0))
    found = contents(made, "result")
    assert found["result/metrics.json"]["nis.bounds.1"] == ["2"]
    assert found["result/metrics.json"]["nis.mean"] == [""]
    states, totals = found["result/states.csv"], found["result/states.csv.totals.json"]
    assert states["time_s"][0] == "0" and states["time_s"][-1] == "99"
    assert totals["time_s.mean"] == ["49.5"] and totals["word.odd"] == ["50"]
    assert found["result/covariances.npz.csv"]["P.trace"] == ["5", "2"]
    assert found["result/covariances.npz.csv"]["P.norm_of_correlations"][1] == cell(2.5**0.5)
    write_contents(tmp_path / "data", found)
    assert read_contents(tmp_path / "data") == found
