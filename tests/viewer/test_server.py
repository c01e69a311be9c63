"""Whom the server lets in, and what it gives away."""

import socket
import time
import urllib.error
import urllib.request
from collections.abc import Iterator

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
