"""Where a result goes when nobody says where."""

import runpy
import sys
from datetime import datetime
from pathlib import Path

import pytest

from pcnav import __version__
from pcnav.cli.dated_folder import dated_folder, link_latest
from tests.commands import Pcnav

NOW = datetime(2026, 3, 4, 5, 6, 7)


def test_a_run_without_a_place_gets_a_dated_one_that_latest_leads_to(
    pcnav: Pcnav, sequence: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    answer = pcnav("run", sequence, "--no-report")
    assert answer.code == 0, answer.err
    (folder,) = (path for path in Path("runs").iterdir() if not path.is_symlink())
    assert folder.name.endswith(f"-{sequence.name}")
    assert folder.name[:8] == f"{datetime.now():%Y%m%d}"
    assert (Path("runs") / "latest").resolve() == folder.resolve()
    assert not (folder / "report.html").exists()
    assert f"pcnav view {folder}" in answer.out
    # An output that is there is refused before anything is read, and the way out is named.
    (sequence / "scene_camera.json").unlink()
    refused = pcnav("run", sequence, "-o", folder)
    assert refused.code == 2
    assert "--overwrite" in refused.err


def test_folders_of_one_second_differ_and_names_are_plain(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    first = dated_folder(Path("data/my video (2).mp4"), NOW)
    assert first == Path("runs/20260304-050607-my-video-2")
    first.mkdir(parents=True)
    assert dated_folder(Path("data/my video (2).mp4"), NOW).name == f"{first.name}-2"


def test_latest_follows_and_leaves_what_is_no_link(tmp_path: Path) -> None:
    one, two = tmp_path / "one", tmp_path / "two"
    for folder in (one, two):
        folder.mkdir()
        link_latest(folder)
        assert (tmp_path / "latest").resolve() == folder
    (tmp_path / "latest").unlink()
    (tmp_path / "latest").mkdir()
    link_latest(one)
    assert (tmp_path / "latest").is_dir() and not (tmp_path / "latest").is_symlink()
    assert {path.name for path in tmp_path.iterdir()} == {"one", "two", "latest"}


def test_the_package_runs_as_a_module(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["pcnav", "--version"])
    with pytest.raises(SystemExit) as ended:
        runpy.run_module("pcnav", run_name="__main__")
    assert ended.value.code in (0, None)
    assert capsys.readouterr().out == f"pcnav {__version__}\n"
