"""All or nothing on disk: runs that fail, and folders that exist."""

from pathlib import Path

import pytest

from pcnav.core.errors import InputError
from pcnav.files.manifest import MANIFEST_FILE
from pcnav.runs.estimate import Estimate
from pcnav.runs.reader import read_run
from pcnav.runs.writer import RunWriter
from tests.runs.made_estimates import DEPTH, empty, write


def test_an_exception_leaves_nothing(tmp_path: Path, frames: list[Estimate]) -> None:
    with (
        pytest.raises(KeyboardInterrupt),
        RunWriter(tmp_path / "new" / "deep" / "run", DEPTH) as writer,
    ):
        writer.add(frames[3])
        raise KeyboardInterrupt
    assert list(tmp_path.iterdir()) == []


def test_an_earlier_run_survives_until_the_new_one_is_complete(
    tmp_path: Path, frames: list[Estimate]
) -> None:
    folder = tmp_path / "run"
    write(folder, frames)
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    with pytest.raises(InputError, match="overwrite"):
        write(folder, frames[:2])
    with pytest.raises(RuntimeError, match="fault"), RunWriter(folder, DEPTH, True) as writer:
        writer.add(frames[3])
        raise RuntimeError("fault")
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before
    assert [path.name for path in tmp_path.iterdir()] == ["run"]
    with RunWriter(folder, DEPTH, overwrite=True) as writer:
        writer.add(frames[3])
        writer.finish_tables()
        assert {path.name: path.read_bytes() for path in folder.iterdir()} == before
    assert len(read_run(folder)) == 1
    assert [path.name for path in tmp_path.iterdir()] == ["run"]


def test_overwriting_spares_a_folder_that_is_no_run(tmp_path: Path) -> None:
    (tmp_path / "thesis").mkdir()
    (tmp_path / "thesis" / "chapter1.tex").write_text("years of work")
    with pytest.raises(InputError, match=r"states\.csv"):
        write(tmp_path / "thesis", [empty(0)], overwrite=True)
    assert (tmp_path / "thesis" / "chapter1.tex").read_text() == "years of work"
    with pytest.raises(InputError, match="this is a file"):
        write(tmp_path / "thesis" / "chapter1.tex", [empty(0)], overwrite=True)


def test_an_empty_folder_is_used(tmp_path: Path) -> None:
    write(tmp_path, [empty(0)])
    assert len(read_run(tmp_path)) == 1


def test_additions_appear_with_the_run(tmp_path: Path, frames: list[Estimate]) -> None:
    folder = tmp_path / "run"
    with RunWriter(folder, DEPTH) as writer:
        writer.add(frames[3])
        staging = writer.finish_tables()
        writer.write_text("note.txt", f"{len(read_run(staging))} frame of 5 °")
        writer.write_json("metrics.json", {"rms_m": 0.5})
        with pytest.raises(RuntimeError, match="finish_tables"):
            writer.add(frames[4])
        with pytest.raises(ValueError, match="JSON"):
            writer.write_json("bad.json", {"rms_m": float("nan")})
        assert not folder.exists()
    assert (folder / "note.txt").read_text(encoding="utf-8") == "1 frame of 5 °"
    assert sorted(path.name for path in folder.iterdir()) == [
        *(MANIFEST_FILE, "covariances.npz", "measurements.csv", "metrics.json"),
        *("note.txt", "poses.tum", "states.csv"),
    ]
