"""Several recordings in one call of ``pcnav run``."""

from datetime import datetime
from pathlib import Path

import pytest

from pcnav.cli.several import folders_of, run_several
from pcnav.core.errors import InputError


def test_each_gets_a_folder_of_its_own_name(tmp_path: Path) -> None:
    bag = tmp_path / "c.bag"
    bag.touch()
    recordings = [tmp_path / "x" / "a", tmp_path / "b", bag]
    now, out = datetime(2026, 1, 2, 3, 4, 5), Path("out")
    assert folders_of(recordings, out, now) == [out / "a", out / "b", out / "c"]
    recordings = [tmp_path / "x" / "depth", tmp_path / "y" / "depth"]
    assert folders_of(recordings, out, now) == [out / "x-depth", out / "y-depth"]
    dated = folders_of(recordings, None, now)
    assert dated[0] != dated[1] and all(path.parent == Path("runs") for path in dated)
    with pytest.raises(InputError, match="every recording once"):
        folders_of([tmp_path / "a", tmp_path / "b" / ".." / "a"], out, now)


def test_one_that_cannot_be_run_does_not_stop_the_others(
    capsys: pytest.CaptureFixture[str],
) -> None:
    done = []

    def run(recording: Path, folder: Path) -> bool:
        if recording.name == "bad":
            raise InputError(recording, "frames", "expected some")
        done.append((recording, folder))
        return recording.name != "empty"

    names = [Path("bad"), Path("good"), Path("empty")]
    with pytest.raises(InputError, match="1 of 3"):
        run_several(names, names, run)
    assert done == [(Path("good"), Path("good")), (Path("empty"), Path("empty"))]
    assert "error: bad: frames: expected some" in capsys.readouterr().err
    assert run_several([names[1]], [names[1]], run)
    assert not run_several(names[1:], names[1:], run)
