"""Whom the server lets in, and what it gives away."""

import socket
import time
import urllib.error
import urllib.request
from collections.abc import Iterator
from typing import Any

import msgspec
import pytest
import viser
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect
from websockets.sync.connection import Connection
from websockets.typing import Origin, Subprotocol

from pcnav.viewer.app import serve
from pcnav.viewer.loaded_run import LoadedRun, finished
from pcnav.viewer.server import LocalServer, is_own_origin
from tests.commands import PATIENCE_S
from tests.viewer.conftest import CAMERA

_PROTOCOL = Subprotocol(f"viser-v{viser.__version__}")


@pytest.fixture
def server(loaded: LoadedRun) -> Iterator[LocalServer]:
    served = serve(finished(loaded), "127.0.0.1", 0)
    yield served
    served.stop()


def url(server: LocalServer, scheme: str = "http") -> str:
    return f"{scheme}://127.0.0.1:{server.get_port()}"


def joined(server: LocalServer, origin: str | None) -> Connection:
    return connect(
        url(server, "ws"),
        subprotocols=[_PROTOCOL],
        origin=None if origin is None else Origin(origin),
    )


def test_page_is_served_on_loopback(server: LocalServer) -> None:
    with urllib.request.urlopen(url(server), timeout=PATIENCE_S) as answer:
        assert answer.status == 200
        assert b"<html" in answer.read().lower()


def test_only_loopback_is_listened_on(server: LocalServer) -> None:
    assert server.get_host() == "127.0.0.1"
    own = socket.gethostbyname(socket.gethostname())
    if own.startswith("127."):
        pytest.skip("this machine has no other address by its name")
    with pytest.raises(OSError):
        socket.create_connection((own, server.get_port()), timeout=1.0).close()


@pytest.mark.parametrize(
    "path",
    ["/../../../../etc/passwd", "/%2e%2e/%2e%2e/_viser.py", "/..%5c..%5c_viser.py", "/states.csv"],
)
def test_nothing_but_the_page_is_served(server: LocalServer, path: str) -> None:
    with pytest.raises(urllib.error.HTTPError) as refused:
        urllib.request.urlopen(url(server) + path, timeout=PATIENCE_S)
    assert refused.value.code == 404
    refused.value.close()


def test_nobody_can_open_a_public_tunnel(server: LocalServer) -> None:
    answer: object = server.request_share_url()  # type: ignore[func-returns-value]
    assert answer is None


def test_pages_of_other_sites_are_cut_off(server: LocalServer) -> None:
    with joined(server, "http://elsewhere.example") as page:
        with pytest.raises(ConnectionClosed) as closed:
            while True:
                page.recv(timeout=PATIENCE_S)
        assert closed.value.rcvd is not None and closed.value.rcvd.code == 1008


@pytest.mark.parametrize("origin", [None, "own"])
def test_its_own_page_is_let_in(server: LocalServer, origin: str | None) -> None:
    told = url(server) if origin == "own" else None
    with joined(server, told) as page:
        assert len(page.recv(timeout=PATIENCE_S)) > 0


def test_a_name_that_was_made_to_point_here_is_foreign() -> None:
    rebound = "evil.example:8080"
    assert not is_own_origin(f"http://{rebound}", rebound, "127.0.0.1")
    assert is_own_origin("http://localhost:8080", "localhost:8080", "127.0.0.1")
    assert is_own_origin("http://10.0.0.5:8080", "10.0.0.5:8080", "0.0.0.0")
    assert not is_own_origin("http://other:8080", "10.0.0.5:8080", "0.0.0.0")


def test_a_taken_port_moves_up(server: LocalServer, loaded: LoadedRun) -> None:
    second = serve(finished(loaded), "127.0.0.1", server.get_port())
    try:
        assert second.get_port() > server.get_port()
    finally:
        second.stop()


def test_a_client_that_says_nothing_gets_no_session(server: LocalServer) -> None:
    with joined(server, None):
        time.sleep(0.2)
        assert server.get_clients() == {}


def test_malformed_messages_of_a_page_are_one_line_and_harm_nobody(
    server: LocalServer, capfd: pytest.CaptureFixture[str], caplog: pytest.LogCaptureFixture
) -> None:
    with joined(server, None) as page, caplog.at_level("WARNING", logger="pcnav"):
        page.send(msgspec.msgpack.encode(CAMERA))
        deadline = time.monotonic() + 60.0
        while not (clients := server.get_clients()) or not _inputs(clients):
            assert time.monotonic() < deadline
            time.sleep(0.02)
        (client,) = clients.values()
        inputs = _inputs(clients)
        before = {uuid: handle._impl.value for uuid, handle in inputs.items()}
        removed = {uuid: handle._impl.removed for uuid, handle in inputs.items()}
        bad: tuple[Any, ...] = (None, "x" * 10**6, float("nan"), 10**15, [[[]]], {})
        for uuid in inputs:
            for updates in (
                *({"value": each} for each in bad),
                *({name: "broken"} for name in ("removed", "update_cb", "sync_cb", "nonsense")),
            ):
                message = {"type": "GuiUpdateMessage", "uuid": uuid, "updates": updates}
                page.send(msgspec.msgpack.encode(message))
        page.send(msgspec.msgpack.encode({**CAMERA, "position": (float("nan"), 0.0, 1e400)}))
        # A session that is still being built places the camera itself once more.
        while abs(client.camera.fov - 0.6) > 1e-6:
            page.send(msgspec.msgpack.encode({**CAMERA, "fov": 0.6}))
            assert time.monotonic() < deadline
            time.sleep(0.02)
        assert client.camera.position.tolist() == [0.0, 0.0, 0.0]
        # The page may still be moving to the frame that it opens at: values stay what they can be.
        for uuid, handle in inputs.items():
            value = handle._impl.value
            assert (type(value), handle._impl.removed) == (type(before[uuid]), removed[uuid])
            assert value not in ("x" * 10**6, 10**15)
    # What is no message at all ends its connection, and no other.
    for raw in (b"", b"\xc1", b"\x80", msgspec.msgpack.encode({"type": "NoSuchMessage"}), "text"):
        with joined(server, None) as page:
            page.send(raw)
            with pytest.raises(ConnectionClosed):
                while True:
                    page.recv(timeout=PATIENCE_S)
    with joined(server, None) as page:
        assert len(page.recv(timeout=PATIENCE_S)) > 0
    assert "Traceback" not in "".join(capfd.readouterr())
    (line,) = [each.getMessage() for each in caplog.records if each.name.startswith("pcnav")]
    assert "\n" not in line and len(line) < 400


def _inputs(clients: dict[int, viser.ClientHandle]) -> dict[str, Any]:
    """The controls of the one page, by what its messages call them."""
    return {
        uuid: handle
        for client in clients.values()
        for uuid, handle in dict(client.gui._gui_input_handle_from_uuid).items()
        if hasattr(handle._impl, "value")
    }
