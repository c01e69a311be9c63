"""A folder is whole or not there, and nobody loses a file for it."""

import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from pcnav.core.errors import InputError
from pcnav.files.manifest import MANIFEST_FILE
from pcnav.files.new_file import write_whole
from pcnav.files.new_folder import new_folder

MARKER = "states.csv"
NEEDS_LOCKS = pytest.mark.skipif(os.name != "posix", reason="Windows has no such locks")
KILLED = """
import os, signal, sys
from pathlib import Path
from pcnav.files import new_folder as module

out, when = Path(sys.argv[1]), sys.argv[2]

def die(*_):
    os.kill(os.getpid(), signal.SIGKILL)

with module.new_folder(out, True, "states.csv") as staging:
    (staging / "states.csv").write_text("new")
    if when == "writing":
        die()
    if when == "moving":
        module._refuse_foreign = lambda content, _: die() if content != out else None
    if when == "removing":
        module.remove_listed = die
"""


def make(out: Path, text: str = "ours", overwrite: bool = False) -> None:
    """A folder as pcnav makes them."""
    with new_folder(out, overwrite, MARKER) as staging:
        (staging / MARKER).write_text(text)
        (staging / "depth").mkdir()
        (staging / "depth" / "000000.png").write_text(text)


def killed(out: Path, when: str, repository: Path) -> None:
    """A process that is killed while it replaces a folder."""
    process = subprocess.run(
        [sys.executable, "-c", KILLED, str(out), when],
        env={**os.environ, "PYTHONPATH": str(repository)},
        check=False,
    )
    assert process.returncode == -signal.SIGKILL


def names(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()}


@pytest.mark.parametrize("overwrite", [False, True])
def test_a_folder_that_somebody_makes_meanwhile_stays(tmp_path: Path, overwrite: bool) -> None:
    out = tmp_path / "run"
    with (
        pytest.raises(InputError, match="overwrite"),
        new_folder(out, overwrite, MARKER) as staging,
    ):
        (staging / MARKER).write_text("ours")
        out.mkdir()
        (out / "thesis.tex").write_text("theirs")
    assert (out / "thesis.tex").read_text() == "theirs"
    assert names(tmp_path) == {"run"}


@pytest.mark.parametrize("place", ["thesis.tex", "depth/raw.bin", "raw/scan.bin"])
def test_overwriting_refuses_by_name_what_pcnav_did_not_write(tmp_path: Path, place: str) -> None:
    out = tmp_path / "run"
    make(out)
    file = out / place
    file.parent.mkdir(exist_ok=True)
    file.write_text("years of work")
    with pytest.raises(InputError, match=rf"but it has {place},"):
        make(out, "newer", overwrite=True)
    assert file.read_text() == "years of work" and (out / MARKER).read_text() == "ours"
    file.unlink()
    if place.startswith("raw"):
        file.parent.rmdir()
    make(out, "newer", overwrite=True)
    assert (out / MARKER).read_text() == "newer"
    assert names(tmp_path) == {"run"}


def test_a_file_of_the_right_name_alone_makes_no_folder_of_ours(tmp_path: Path) -> None:
    out = tmp_path / "data"
    out.mkdir()
    (out / MARKER).write_text("my own states")
    # Neither does a list that lists nothing, or is no list.
    for listed in (None, "[]", "{", '{"states.csv": 1}', "[" * 100_000):
        if listed is not None:
            (out / MANIFEST_FILE).write_text(listed)
        with pytest.raises(InputError, match=rf"but it has {MARKER}|but it has {MANIFEST_FILE}"):
            make(out, overwrite=True)
        assert (out / MARKER).read_text() == "my own states"


@pytest.mark.skipif(os.name != "posix", reason="links need a privilege on Windows")
def test_what_links_lead_to_is_neither_looked_at_nor_removed(tmp_path: Path) -> None:
    out, raw = tmp_path / "run", tmp_path / "raw"
    make(out)
    shutil.move(out / "depth", raw)
    (out / "depth").symlink_to(raw)
    # The list names what the link leads to, but the link is not the folder that was written.
    with pytest.raises(InputError, match="has depth,"):
        make(out, "newer", overwrite=True)
    assert (raw / "000000.png").read_text() == "ours"
    assert (out / "depth").is_symlink()


def test_a_file_that_comes_at_the_last_moment_stays(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "run"
    make(out)
    rename = Path.rename

    def slow(self: Path, to: Path) -> Path:
        if self == out:
            (out / "thesis.tex").write_text("years of work")
        return rename(self, to)

    with monkeypatch.context() as patch, pytest.raises(InputError, match=r"has thesis\.tex"):
        patch.setattr(Path, "rename", slow)
        make(out, "newer", overwrite=True)
    assert (out / "thesis.tex").read_text() == "years of work"
    assert (out / MARKER).read_text() == "ours" and names(tmp_path) == {"run"}


@NEEDS_LOCKS
@pytest.mark.parametrize(("when", "kept"), [("writing", "ours"), ("removing", "new")])
def test_what_a_killed_process_left_is_collected_at_the_next_start(
    tmp_path: Path, repository: Path, when: str, kept: str
) -> None:
    out = tmp_path / "run"
    make(out)
    killed(out, when, repository)
    assert (out / MARKER).read_text() == kept and len(names(tmp_path)) == 2
    # Of nobody's making, however alike the names: these stay.
    for name in (".photos-0123abcd", ".run-0123abcd-earlier"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "mine.jpg").write_text("dear")
    with new_folder(tmp_path / "alive", False, MARKER) as staging:
        (staging / MARKER).write_text("in the making")
        make(tmp_path / "other")
        others = {".photos-0123abcd", ".run-0123abcd-earlier"}
        assert names(tmp_path) == {"run", "other", staging.name} | others
    assert (out / MARKER).read_text() == kept


@NEEDS_LOCKS
def test_an_earlier_result_comes_back_where_a_kill_left_none(
    tmp_path: Path, repository: Path
) -> None:
    out = tmp_path / "run"
    make(out)
    killed(out, "moving", repository)
    assert not out.exists() and len(names(tmp_path)) == 2
    make(tmp_path / "other")
    assert (out / MARKER).read_text() == "ours"
    assert names(tmp_path) == {"run", "other"}


@NEEDS_LOCKS
def test_parts_of_files_that_kills_left_are_collected(tmp_path: Path) -> None:
    old, new, foreign = (
        tmp_path / name
        for name in (".a.png-0123abcd.pcnav-part", ".b.png-0123abcd.pcnav-part", ".c-0123abcd")
    )
    for path in (old, new, foreign):
        path.write_text("half")
    for path in (old, foreign):
        os.utime(path, (0, 0))
    write_whole(tmp_path / "a.png", b"whole")
    assert names(tmp_path) == {"a.png", new.name, foreign.name}
