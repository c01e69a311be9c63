"""Help, examples and wrong command lines, through the real entry point."""

import re
import shlex
import shutil
from pathlib import Path

import pytest

from pcnav import cli
from studies import STUDIES
from tests.cli.answers import expect_refusal
from tests.commands import Pcnav

COMMANDS = ("demo", "simulate", "run", "target", "study")


@pytest.mark.parametrize("flag", ["-h", "--help"])
@pytest.mark.parametrize("command", COMMANDS)
def test_help_shows_an_example_of_the_command(pcnav: Pcnav, command: str, flag: str) -> None:
    answer = pcnav(command, flag)
    assert answer.code == 0
    assert answer.err == ""
    assert f"Example: `pcnav {command}" in answer.out


def test_help_of_study_names_every_study(pcnav: Pcnav) -> None:
    answer = pcnav("study", "--help")
    assert {"yu2019", "tracking"} <= set(STUDIES)
    for name in STUDIES:
        assert re.search(rf"\b{name}\b", answer.out.partition("Arguments")[2]), name


def test_without_a_command_the_help_is_shown(pcnav: Pcnav) -> None:
    answer = pcnav()
    assert answer.code == 0
    for command in COMMANDS:
        assert re.search(rf"^  {command} ", answer.out, re.MULTILINE)
    assert pcnav("--version").out.startswith("pcnav ")


def examples() -> dict[str, list[str]]:
    """The examples in the help texts by command."""
    found = {}
    for command in COMMANDS:
        match = re.search(r"Example: `(pcnav .*)`", getattr(cli, command).__doc__ or "")
        assert match is not None, command
        found[command] = shlex.split(match[1])
    return found


@pytest.mark.usefixtures("quick_drawings")
def test_examples_use_what_is_shipped_and_work_in_order(
    pcnav: Pcnav, recorded: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    shown = examples()
    assert set(shown) == set(COMMANDS)
    target = pcnav(*shown["target"][1:])
    assert target.code == 0, target.err
    assert "bus_x_plus" in target.out
    assert "catalogue: boxsat.toml" in target.out
    assert "picture: boxsat.png" in target.out
    assert (tmp_path / "boxsat.png").read_bytes().startswith(b"\x89PNG")
    # What `simulate` takes minutes to write stands here already, shorter.
    written = Path(shown["simulate"][shown["simulate"].index("-o") + 1])
    assert shown["run"][2] == str(written)
    shutil.copytree(recorded / "sequence", written)
    expect_refusal(pcnav(*shown["simulate"][1:]), written, "folder", "overwrite")
    answer = pcnav(*shown["run"][1:])
    assert answer.code == 0
    # Not a terminal: no bar and no blank lines, on either stream.
    assert answer.error_lines == []
    assert "\x1b" not in answer.out + answer.err
    assert "Errors against the truth" in answer.out
    assert re.search(r"known from data: \d+\s+of\s+20\s+states", answer.out)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("fly",), ("fly", "pcnav --help")),
        (("run",), ("sequence", "pcnav run --help")),
        (("simulate", "demo"), ("--out", "pcnav simulate --help")),
        (("simulate", "demo", "-o", "x", "--fast"), ("--fast", "pcnav simulate --help")),
        (("study", "yu2019", "-o", "x", "--runs", "many"), ("--runs", "pcnav study --help")),
        (("study", "nobody1900", "-o", "x"), ("nobody1900", "study", "expected")),
        (("study", "yu2019", "-o", "x", "--jobs", "0"), ("--jobs", "expected at least 1")),
        (("study", "yu2019", "-o", "x", "--scheduler", "host"), ("host", "tcp://host:8786")),
        (("target", "boxsat", "extra"), ("extra", "pcnav target --help")),
        (("target", "boxsat", "-o", "x.jpg"), ("x.jpg", "--out", ".toml or .png")),
        (("target", "boxsat", "--mesh-unit", "mile"), ("--mesh-unit", "mile", "mm")),
        (("--nothing",), ("--nothing", "pcnav --help")),
    ],
)
def test_a_wrong_command_line_is_one_line(
    pcnav: Pcnav,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    arguments: tuple[str, ...],
    words: tuple[str, ...],
) -> None:
    monkeypatch.chdir(tmp_path)
    expect_refusal(pcnav(*arguments), *words)
    assert not list(tmp_path.iterdir())


# Bad sequences.
