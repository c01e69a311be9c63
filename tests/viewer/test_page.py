"""A page is opened as its address says, whatever is lost on the way; spoken as a browser does."""

import json
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from html import unescape
from typing import Any

import msgspec
import pytest
from websockets.sync.connection import Connection

from pcnav.viewer.app import serve
from pcnav.viewer.loaded_run import LoadedRun, finished
from pcnav.viewer.server import LOOPBACK, LocalServer
from tests.viewer.conftest import FRAMES, connected, messages_in

_BRIDGE = re.compile(r"data-channel='(\w*)'.*? alt='([^']*)'", re.DOTALL)
_QUIET_S = 1.5
"""Longer than it takes a session to set an address anew."""


@pytest.fixture
def server(loaded: LoadedRun) -> Iterator[LocalServer]:
    served = serve(finished(loaded), LOOPBACK, 0, first_frame=FRAMES - 1)
    yield served
    served.stop()


@dataclass
class Spoken:
    """What passes between a server and the script of a page."""

    socket: Connection
    box: str = ""
    """The control that is written into."""
    session: str = ""
    told: dict[str, list[Any]] = field(default_factory=dict)
    """By channel, what came."""
    said: int = 0

    def listen(self, quiet_s: float = _QUIET_S) -> None:
        """Take what comes until nothing has for a while, and say that it has been shown."""
        try:
            while True:
                data = self.socket.recv(quiet_s)
                assert isinstance(data, bytes)
                for message in messages_in(data):
                    self._take(message)
        except TimeoutError:
            return

    def _take(self, message: dict[str, Any]) -> None:
        kind = message["type"]
        if kind == "LocalStorageGetItemRequestMessage":
            answer = {"value": None, "error": None, "request_uuid": message["request_uuid"]}
            self._send({"type": "LocalStorageGetItemResponseMessage", **answer})
        elif kind == "GuiTextMessage" and message["props"]["label"] == "page":
            self.box = message["uuid"]
        elif kind in ("GuiHtmlMessage", "GuiUpdateMessage"):
            content = message.get("props", message.get("updates", {})).get("content", "")
            for channel, text in _BRIDGE.findall(content if isinstance(content, str) else ""):
                if channel:
                    self.told.setdefault(channel, []).append(json.loads(unescape(text)))
                else:
                    self.session = text

    def say(self, message: dict[str, Any]) -> None:
        self.said += 1
        value = json.dumps({"n": self.said, **message})
        told = {"type": "GuiUpdateMessage", "uuid": self.box, "updates": {"value": value}}
        self._send(told)

    def ask(self, address: str, session: str | None = None) -> None:
        named = self.session if session is None else session
        self.say({"do": "open", "session": named, "state": address})

    def _send(self, message: dict[str, Any]) -> None:
        self.socket.send(msgspec.msgpack.encode(message))

    @property
    def frame(self) -> int:
        """What is shown."""
        return int(self.told["now"][-1]["frame"])

    @property
    def addresses(self) -> list[str]:
        return [each.split("&")[0] for each in self.told.get("address", [])]


@pytest.fixture
def page(server: LocalServer) -> Iterator[Spoken]:
    spoken = Spoken(connected(server.get_port()))
    spoken.listen()
    assert spoken.box and spoken.session
    yield spoken
    spoken.socket.close()


def test_an_address_is_not_set_before_the_page_was_opened_as_it_says(page: Spoken) -> None:
    assert page.frame == FRAMES - 1
    assert page.addresses == []
    page.ask("frame=5")
    page.listen()
    assert page.frame == 5
    assert set(page.addresses) == {"frame=5"}


def test_each_request_is_confirmed_and_the_first_alone_opens(page: Spoken) -> None:
    page.ask("frame=5")
    page.listen()
    page.say({"do": "frame", "frame": 8})
    page.listen()
    # The page was not told, or is put together anew: what its user did since stays.
    page.ask("frame=5")
    page.listen()
    assert page.frame == 8
    confirmed = page.told["opened"]
    assert [each["session"] for each in confirmed] == [page.session] * 2
    assert confirmed[0] != confirmed[1]


def test_a_request_of_the_time_before_a_restart_is_passed_over(
    page: Spoken, server: LocalServer
) -> None:
    other = Spoken(connected(server.get_port()))
    other.listen()
    assert other.session != page.session
    page.ask("frame=5", other.session)
    page.listen()
    assert page.frame == FRAMES - 1 and "opened" not in page.told
    page.ask("frame=6")
    page.listen()
    assert page.frame == 6
    other.socket.close()


def test_an_address_that_cannot_be_opened_is_confirmed_once_it_was_tried(page: Spoken) -> None:
    page.ask("frame=nonsense&camera=1,2&plots=none")
    page.listen()
    assert page.frame == FRAMES - 1 and len(page.told["opened"]) == 1
