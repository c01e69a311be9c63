"""``pcnav forecast`` as users meet it."""

import csv
from pathlib import Path

import numpy as np

from pcnav.evaluation.forecast.csv_file import COLUMNS
from pcnav.runs.reader import read_run
from tests.cli.answers import expect_refusal
from tests.commands import Pcnav


def test_a_face_is_forecast_and_written(pcnav: Pcnav, recorded: Path, tmp_path: Path) -> None:
    table, picture = tmp_path / "f.csv", tmp_path / "f.png"
    answer = pcnav(
        *("forecast", recorded / "result", "--point", "bus_x_plus", "--ahead", 4, "--step", 2),
        *("-o", table, "-o", picture),
    )
    assert answer.code == 0, answer.err
    for text in (
        "bus_x_plus, from the estimate at",
        "facing the chaser within 30.0 deg",
        "known to",
    ):
        assert text in answer.out
    with table.open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert tuple(rows[0]) == COLUMNS
    assert [float(row["ahead_s"]) for row in rows] == [0.0, 2.0, 4.0]
    # The face's centroid is 0.8 m from the origin of the model, whose pose the run tells.
    run = read_run(recorded / "result")
    distance = (
        float(np.linalg.norm(run.trajectory.poses[-1] @ [0.8, 0.0, 0.0, 1.0]) ** 2 - 1.0) ** 0.5
    )
    place = [float(rows[0][name]) for name in ("p_x_m", "p_y_m", "p_z_m")]
    assert abs(np.linalg.norm(place) - distance) < 2e-3
    assert picture.read_bytes().startswith(b"\x89PNG")


def test_the_same_forecast_is_the_same_file(pcnav: Pcnav, recorded: Path, tmp_path: Path) -> None:
    for name in ("a.csv", "b.csv"):
        options = ("--point", "0.1 0.2, 0.3", "--ahead", 2, "-o", tmp_path / name)
        assert pcnav("forecast", recorded / "result", *options).code == 0
    assert (tmp_path / "a.csv").read_bytes() == (tmp_path / "b.csv").read_bytes()


def test_bad_requests_are_refused(pcnav: Pcnav, recorded: Path, tmp_path: Path) -> None:
    result = recorded / "result"
    expect_refusal(pcnav("forecast", result, "--point", "nose"), "--point", "com, origin", "nose")
    expect_refusal(pcnav("forecast", result, "--point", "1 2"), "--point", "three numbers")
    expect_refusal(pcnav("forecast", result, "--normal", "0 0 0"), "--normal", "a direction")
    expect_refusal(pcnav("forecast", result, "--facing-deg", 20), "--normal", "expected one")
    expect_refusal(pcnav("forecast", result, "-o", tmp_path / "f.txt"), "--out", ".csv")
    expect_refusal(pcnav("forecast", result, "--step", 0.001), "--step", "20000")
    expect_refusal(pcnav("forecast", tmp_path), tmp_path, "states.csv")
