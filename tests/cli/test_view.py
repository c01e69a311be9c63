"""``pcnav view``: where it opens, and to whom."""

import shutil
import socket
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pcnav.viewer.assessment import Opening, error_over_sigma
from pcnav.viewer.loading import load_run
from tests.commands import Pcnav


@pytest.fixture
def opened(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """Views end as soon as they are served; where each opened is kept."""
    kept: list[Any] = []
    monkeypatch.setattr(
        "pcnav.viewer.app.show", lambda server, source, frame: kept.append((server, frame))
    )
    # The package has a function of this name.
    command = import_module("pcnav.cli.view")
    monkeypatch.setattr(command, "serve_until_interrupted", lambda server: server.stop())
    return kept


@pytest.mark.parametrize("host", ["0.0.0.0", "localhost"])
def test_an_address_that_others_may_reach_is_said_to_be_open(
    pcnav: Pcnav, recorded: Path, opened: list[Any], host: str
) -> None:
    answer = pcnav("view", recorded / "result", "--host", host, "--port", "0")
    assert answer.code == 0
    told = f"open to every machine that reaches {host}: anyone there can look at this run"
    assert (told in answer.out) is (host == "0.0.0.0")
    (server, _), *_ = opened
    assert server.get_host() == host
    assert f"view: http://{host}:{server.get_port()}" in answer.out


def test_without_a_host_it_is_open_to_this_machine_alone(
    pcnav: Pcnav, recorded: Path, opened: list[Any]
) -> None:
    answer = pcnav("view", recorded / "result", "--port", "0")
    assert answer.code == 0 and "open to every machine" not in answer.out
    assert opened[0][0].get_host() == "127.0.0.1"


def test_an_address_of_another_machine_is_refused(pcnav: Pcnav, recorded: Path) -> None:
    answer = pcnav("view", recorded / "result", "--host", "192.0.2.1", "--port", "0")
    assert answer.code == 2 and "--host" in answer.err and "192.0.2.1" in answer.err


def test_a_port_that_is_taken_moves_up_and_is_told(
    pcnav: Pcnav, recorded: Path, opened: list[Any]
) -> None:
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        taken = other.getsockname()[1]
        answer = pcnav("view", recorded / "result", "--port", str(taken))
    assert answer.code == 0 and f"port {taken} is taken" in answer.out


@pytest.mark.parametrize(
    ("options", "at"), [((), Opening.LAST), (("--worst",), Opening.WORST), (("--frame", "2"), 2)]
)
def test_it_opens_where_it_is_told(
    pcnav: Pcnav, recorded: Path, opened: list[Any], options: tuple[str, ...], at: object
) -> None:
    assert pcnav("view", recorded / "result", "--port", "0", *options).code == 0
    assert opened[0][1] == at


def test_the_worst_frame_is_exported_when_asked_for(
    pcnav: Pcnav, recorded: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ratio = error_over_sigma(load_run(recorded / "result"))
    assert ratio is not None
    drawn: list[int] = []

    def exported(share: object, runs: object, frame: int, *_: object, **__: object) -> bytes:
        drawn.append(frame)
        return b""

    monkeypatch.setattr("pcnav.viewer.export.exported", exported)
    for name, options in (("a.html", ("--worst",)), ("b.html", ())):
        assert pcnav("view", recorded / "result", "--html", tmp_path / name, *options).code == 0
    assert drawn[0] == int(np.nanargmax(ratio))
    assert drawn[1] == load_run(recorded / "result").opening_frame


def test_a_frame_and_the_worst_one_are_one_too_many(pcnav: Pcnav, recorded: Path) -> None:
    answer = pcnav("view", recorded / "result", "--worst", "--frame", "1")
    assert answer.code == 2 and "--worst" in answer.err


def test_without_a_truth_no_frame_is_the_worst(
    pcnav: Pcnav, recorded: Path, tmp_path: Path, opened: list[Any]
) -> None:
    bare = tmp_path / "bare"
    shutil.copytree(recorded / "sequence", bare)
    for each in bare.iterdir():
        if "truth" in each.name or "scene_gt" in each.name:
            each.unlink()
    answer = pcnav("view", recorded / "result", "--sequence", bare, "--worst", "--port", "0")
    assert answer.code == 0 and "no error is known" in answer.out
