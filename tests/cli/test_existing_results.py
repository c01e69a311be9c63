"""What the command line leaves alone, and what it replaces."""

import shutil
from pathlib import Path

import pytest

from pcnav.config.shipped import shipped_mesh_names
from tests.cli.answers import content, expect_refusal, png, truncate, written
from tests.commands import Pcnav


def test_an_existing_result_stays_unless_told_to_overwrite(
    pcnav: Pcnav, recorded: Path, sequence: Path, tmp_path: Path
) -> None:
    result = tmp_path / "result"
    shutil.copytree(recorded / "result", result)
    before = content(result)
    expect_refusal(pcnav("run", sequence, "-o", result), result, "folder", "overwrite")
    assert content(result) == before
    truncate(sequence)
    expect_refusal(pcnav("run", sequence, "-o", result, "--overwrite"), png(4), "whole PNG")
    assert content(result) == before
    assert {path.name for path in tmp_path.iterdir()} == {"sequence", "result"}


@pytest.mark.usefixtures("quick_drawings")
def test_overwriting_replaces_an_earlier_result(
    pcnav: Pcnav, recorded: Path, sequence: Path, tmp_path: Path
) -> None:
    result = tmp_path / "result"
    shutil.copytree(recorded / "result", result)
    (result / "metrics.json").unlink()
    saved = recorded / "result" / "pipeline.toml"
    answer = pcnav("run", sequence, "--pipeline", saved, "-o", result, "--overwrite")
    assert answer.code == 0, answer.err
    assert (result / "metrics.json").is_file()
    # The saved settings repeat the run.
    states = (recorded / "result" / "states.csv").read_bytes()
    assert (result / "states.csv").read_bytes() == states
    assert {path.name for path in tmp_path.iterdir()} == {"sequence", "result"}


def test_overwriting_deletes_neither_the_input_nor_other_folders(
    pcnav: Pcnav, sequence: Path, tmp_path: Path, recorded: Path
) -> None:
    other = tmp_path / "photographs"
    other.mkdir()
    (other / "mine.jpg").write_bytes(b"dear")
    outer = tmp_path / "outer"
    shutil.copytree(recorded / "result", outer)
    shutil.move(sequence, outer / "sequence")
    before = content(tmp_path)
    for out, words in ((other, "states.csv"), (outer, "does not hold"), (outer / "sequence", "")):
        answer = pcnav("run", outer / "sequence", "-o", out, "--overwrite")
        expect_refusal(answer, out, "folder", words)
    expect_refusal(
        pcnav("simulate", recorded / "six.toml", "-o", other, "--overwrite"),
        other,
        "scene_camera.json",
    )
    assert content(tmp_path) == before


def test_a_file_is_never_taken_for_a_folder(pcnav: Pcnav, sequence: Path, tmp_path: Path) -> None:
    file = written(tmp_path / "notes", b"dear")
    for arguments in (("run", sequence), ("simulate", "demo"), ("study", "yu2019")):
        for out in (file, file / "below"):
            answer = pcnav(*arguments, "-o", out, "--overwrite")
            assert answer.code == 2
            assert len(answer.error_lines) == 1, answer.err
            assert "notes" in answer.err
    assert file.read_bytes() == b"dear"


def test_the_demo_replaces_nothing_by_itself(pcnav: Pcnav, recorded: Path, tmp_path: Path) -> None:
    for name in ("sequence", "result"):
        out = tmp_path / name
        shutil.copytree(recorded / name, out / name)
        before = content(out)
        expect_refusal(pcnav("demo", "-o", out), out / name, "folder", "overwrite")
        assert content(out) == before


def test_a_catalogue_file_is_written_once_and_its_folder_made(pcnav: Pcnav, tmp_path: Path) -> None:
    out = tmp_path / "new" / "catalogue.toml"
    assert pcnav("target", "cubesat6u", "-o", out).code == 0
    before = out.read_bytes()
    assert b"rectangles" in before
    expect_refusal(pcnav("target", "boxsat", "-o", out), out, "file", "--overwrite")
    assert out.read_bytes() == before
    assert pcnav("target", "boxsat", "-o", out, "--overwrite").code == 0
    assert out.read_bytes() != before
    expect_refusal(pcnav("target", "boxsat", "-o", tmp_path, "--overwrite"), tmp_path, "file")


@pytest.mark.parametrize("name", shipped_mesh_names())
def test_every_shipped_satellite_can_be_described(pcnav: Pcnav, name: str) -> None:
    answer = pcnav("target", name)
    assert answer.code == 0
    assert answer.err == ""
    for heading in ("symmetry group", "mass centre", "rectangles", "length m"):
        assert heading in answer.out
    assert "object at 0x" not in answer.out


@pytest.mark.skipif(not Path("/proc/self").is_dir(), reason="no folder that nobody can write to")
def test_a_place_that_cannot_be_written_is_one_line(pcnav: Pcnav, sequence: Path) -> None:
    for arguments in (("run", sequence), ("simulate", "demo"), ("target", "boxsat")):
        for out in ("/proc/result", "/proc/new/result"):
            expect_refusal(pcnav(*arguments, "-o", out), "/proc/", "expected")


# Interruption.
