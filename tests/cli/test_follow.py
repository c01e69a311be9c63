"""``pcnav run --follow``: killed and gone on with."""

import shutil
from pathlib import Path
from typing import Any

import pytest

from pcnav import cli
from pcnav.estimators.depth.tracker import Tracker
from pcnav.files.owned import in_use
from pcnav.runs.reader import read_run
from pcnav.runs.timing import AnswerTime, read_timing
from tests.cli.answers import FRAMES, content, expect_refusal
from tests.commands import Pcnav

FOLLOW = ("--follow", "--no-report")


class KilledError(BaseException):
    """Ends a process without a word, as far as the result is concerned."""


@pytest.fixture(scope="module")
def killed(recorded: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a sequence of six frames and of a run that was killed in the fifth."""
    folder = tmp_path_factory.mktemp("killed")
    shutil.copytree(recorded / "sequence", folder / "sequence")
    with pytest.MonkeyPatch.context() as patch:
        step = Tracker.step

        def dies(self: Tracker, frame: Any) -> Any:
            if frame.index == 4:
                raise KilledError
            return step(self, frame)

        patch.setattr(Tracker, "step", dies)
        words = ("run", folder / "sequence", "-o", folder / "result", *FOLLOW)
        patch.setattr("sys.argv", ["pcnav", *map(str, words)])
        with pytest.raises(KilledError):
            cli.main()
    return folder


def test_what_was_done_is_whole_and_gone_on_with(
    killed: Path, recorded: Path, tmp_path: Path, pcnav: Pcnav, monkeypatch: pytest.MonkeyPatch
) -> None:
    shutil.copytree(killed, tmp_path / "two")
    sequence, result = tmp_path / "two" / "sequence", tmp_path / "two" / "result"
    done = read_run(result)
    assert len(done) == 4 and not done.is_finished and not in_use(result)
    whole = (recorded / "result" / "states.csv").read_text()
    assert whole.startswith((result / "states.csv").read_text())
    (sequence / "END").touch()
    lengths = []
    step = Tracker.step

    def looked_at(self: Tracker, frame: Any) -> Any:
        # Until it is caught up with, the earlier run stands as it is.
        lengths.append(len(read_run(result)))
        return step(self, frame)

    monkeypatch.setattr(Tracker, "step", looked_at)
    answer = pcnav("run", sequence, "-o", result, *FOLLOW)
    assert answer.code == 0, answer.err
    assert lengths == [4, 4, 4, 4, 4, 5]
    assert (result / "states.csv").read_text() == whole
    assert read_run(result, with_covariance=True).is_finished
    words = {row.answer for row in read_timing(result).values()}
    assert len(read_timing(result)) == FRAMES and words == {AnswerTime.EARLIER}
    assert sorted(path.name for path in result.parent.iterdir()) == ["result", "sequence"]


def test_it_goes_on_only_with_the_same_run(killed: Path, tmp_path: Path, pcnav: Pcnav) -> None:
    shutil.copytree(killed, tmp_path / "two")
    sequence, result = tmp_path / "two" / "sequence", tmp_path / "two" / "result"
    before = content(result)
    command = ("run", sequence, "-o", result, *FOLLOW)
    expect_refusal(pcnav(*command, "--max-range", "50"), "pipeline.toml", "region", "--overwrite")
    (result / "thesis.txt").write_text("mine")
    expect_refusal(pcnav(*command), result, "thesis.txt")
    (result / "thesis.txt").unlink()
    assert content(result) == before


def test_nothing_within_the_idle_time_is_an_error_that_says_what_is_missed(
    tmp_path: Path, pcnav: Pcnav
) -> None:
    (tmp_path / "frames").mkdir()
    words = ("-o", tmp_path / "out", *FOLLOW, "--idle", "0.05", "--quiet")
    answer = pcnav("run", tmp_path / "frames", *words)
    expect_refusal(answer, tmp_path / "frames", "expected")
    assert not (tmp_path / "out").exists()
    expect_refusal(pcnav("run", tmp_path / "frames", "--idle", "1"), "--idle", "--follow")
