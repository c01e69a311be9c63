"""What a run says of frames that show nothing, or too little."""

import html
import json
import re
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from pcnav.runs.reader import read_run
from tests.cli.answers import FRAMES, PIPELINE, png
from tests.commands import Answer, Pcnav


def blank(sequence: Path, numbers: range) -> None:
    for number in numbers:
        Image.fromarray(np.zeros((128, 128), dtype=np.uint16)).save(sequence / png(number))


def expect_nothing_found(answer: Answer, report: Path, *words: str) -> None:
    """A warning with every word in it, its own exit code, and the same words in the report."""
    assert answer.code == 3, answer
    (line,) = answer.error_lines
    assert line.startswith("WARNING: no target found in ")
    page = html.unescape(report.read_text(encoding="utf-8"))
    for word in words:
        assert word in line
        assert word in page


def test_a_sequence_without_returns_says_so_and_ends_with_its_own_code(
    pcnav: Pcnav, sequence: Path, tmp_path: Path
) -> None:
    blank(sequence, range(FRAMES))
    answer = pcnav("run", sequence, "-o", tmp_path / "result")
    report = tmp_path / "result" / "report.html"
    expect_nothing_found(answer, report, "in 6 frames", "no frame has any return")
    assert read_run(tmp_path / "result").status == ("acquiring",) * FRAMES
    assert "acquiring 100.0%" in answer.out
    assert "acquiring 100.0%" in (tmp_path / "result" / "report.html").read_text()
    assert (tmp_path / "result" / "poses.tum").read_text() == ""
    summary = json.loads((tmp_path / "result" / "summary.json").read_text())
    assert (summary["found"], summary["estimate"], summary["frames"]) == (False, None, FRAMES)
    assert "no frame has any return" in summary["warnings"][0]


@pytest.mark.usefixtures("quick_drawings")
def test_empty_first_frames_delay_the_lock(pcnav: Pcnav, sequence: Path, tmp_path: Path) -> None:
    blank(sequence, range(2))
    answer = pcnav("run", sequence, "-o", tmp_path / "result")
    assert answer.code == 0, answer.err
    track = read_run(tmp_path / "result")
    assert track.status[:2] == ("acquiring", "acquiring")
    assert track.status[-1] == "locked"


@pytest.mark.usefixtures("quick_drawings")
def test_an_empty_frame_in_between_is_coasted_over(
    pcnav: Pcnav, sequence: Path, tmp_path: Path
) -> None:
    blank(sequence, range(4, 5))
    assert pcnav("run", sequence, "-o", tmp_path / "result").code == 0
    track = read_run(tmp_path / "result")
    assert track.status[3:] == ("locked", "coasting", "locked")
    assert track.notes["n_rectangles"][4] == 0


@pytest.mark.usefixtures("quick_drawings")
def test_one_frame_is_a_sequence(pcnav: Pcnav, tmp_path: Path) -> None:
    file = tmp_path / "one.toml"
    file.write_text(PIPELINE.replace("frames = 6", "frames = 1"))
    assert pcnav("simulate", file, "-o", tmp_path / "new" / "sequence").code == 0
    answer = pcnav("run", tmp_path / "new" / "sequence", "-o", tmp_path / "result")
    assert read_run(tmp_path / "result").status == ("acquiring",)
    report = tmp_path / "result" / "report.html"
    expect_nothing_found(answer, report, "in 1 frame:", "a motion takes 3")


@pytest.mark.usefixtures("quick_drawings")
def test_a_target_out_of_view_is_told(pcnav: Pcnav, tmp_path: Path) -> None:
    file = tmp_path / "behind.toml"
    file.write_text(PIPELINE.replace("18.0, 0.0, 0.0", "-18.0, 0.0, 0.0"))
    answer = pcnav("simulate", file, "-o", tmp_path / "sequence")
    assert answer.code == 0
    assert re.fullmatch(r"WARNING: .*outside the image in 6 of 6 frames\n", answer.err)
    answer = pcnav("run", tmp_path / "sequence", "-o", tmp_path / "result")
    expect_nothing_found(answer, tmp_path / "result" / "report.html", "no frame has any return")
    assert set(read_run(tmp_path / "result").status) == {"acquiring"}
