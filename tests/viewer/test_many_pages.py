"""Pages that come and go, and several at once: nothing grows, nothing is raised."""

import gc
import logging
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import msgspec
import pytest
import viser
from websockets.exceptions import ConnectionClosed
from websockets.sync.connection import Connection

from pcnav.viewer.app import serve
from pcnav.viewer.loaded_run import LoadedRun, finished
from pcnav.viewer.server import LocalServer
from pcnav.viewer.session import Session
from tests.commands import PATIENCE_S
from tests.viewer.conftest import connected, messages_in

_PAGES = 6
_MAX_GROWTH_MB = 15.0
"""Of 800 pages, each of which is sent a megabyte."""
_MIN_SHOWN_BYTES = 20_000
"""Of a message with what a page shows."""
_MAX_IDLE_THREADS = 8
_MB_PER_KIB = 1024e-6


@pytest.fixture
def raised(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[str]]:
    """What threads raise, and what is logged as an error."""
    found: list[str] = []
    monkeypatch.setattr(threading, "excepthook", lambda args: found.append(repr(args.exc_value)))

    class Keep(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            found.append(record.getMessage())

    handler = Keep(logging.ERROR)
    logging.getLogger().addHandler(handler)
    logging.getLogger("asyncio").addHandler(handler)
    yield found
    logging.getLogger().removeHandler(handler)
    logging.getLogger("asyncio").removeHandler(handler)


@pytest.fixture
def server(loaded: LoadedRun) -> Iterator[LocalServer]:
    served = serve(finished(loaded), "127.0.0.1", 0)
    yield served
    served.stop()


def joined(server: LocalServer) -> Connection:
    return connected(server.get_port())


def until(holds: Any, patience_s: float = PATIENCE_S) -> None:
    deadline = time.monotonic() + patience_s
    while not holds():
        assert time.monotonic() < deadline
        time.sleep(0.005)


@contextmanager
def viewed(run: Path) -> Iterator[tuple[int, subprocess.Popen[str]]]:
    """`pcnav view` of a run and its port; it must end without having said anything is wrong."""
    if not Path("/proc/self/status").is_file():
        pytest.skip("the system does not tell how much memory is taken")
    command = [sys.executable, "-m", "pcnav", "view", str(run), "--port", "0"]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, stdout=pipe, stderr=pipe, text=True) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        try:
            address = next(line for line in process.stdout if line.startswith("view: "))
            yield int(address.split()[1].rpartition(":")[2]), process
        finally:
            process.send_signal(signal.SIGINT)
        assert process.stderr.read() == ""
        assert process.wait(PATIENCE_S) == 0


def told_of(process: subprocess.Popen[str], name: str) -> int:
    """A number that the system tells of a process; of its memory, in KiB."""
    status = Path(f"/proc/{process.pid}/status").read_text()
    told = dict(line.split(":", 1) for line in status.splitlines())
    return int(told[name].split()[0])


def sessions() -> int:
    return sum(thread.name == "pcnav session" for thread in threading.enumerate())


def test_pages_that_left_are_held_by_nothing(server: LocalServer, raised: list[str]) -> None:
    for k in range(12):
        page = joined(server)
        if k % 4:
            until(lambda: sessions() > 0)
        page.close()
    until(lambda: sessions() == 0 and not server.get_clients())

    def kept() -> list[object]:
        gc.collect()
        return [each for each in gc.get_objects() if isinstance(each, Session | viser.ClientHandle)]

    until(lambda: not kept())
    assert raised == []


@pytest.mark.study
def test_a_thousand_pages_that_come_and_go_leave_nothing(run_folder: Path) -> None:
    """As `pcnav view` serves them: what the allocator keeps is counted, too."""
    with viewed(run_folder) as (port, process):
        at_rest = told_of(process, "Threads")
        memory = 0.0
        for k in range(1000):
            page = connected(port)
            if k % 4:
                # Its session is built, and it is sent what it shows.
                while len(page.recv(PATIENCE_S)) < _MIN_SHOWN_BYTES:
                    pass
            # Every fourth leaves while that is being built.
            page.close()
            if k % 100 == 99:
                until(lambda: told_of(process, "Threads") <= at_rest + _MAX_IDLE_THREADS)
            if k == 199:
                memory = told_of(process, "VmRSS") * _MB_PER_KIB
        growth = told_of(process, "VmRSS") * _MB_PER_KIB - memory
    assert growth < _MAX_GROWTH_MB


@pytest.mark.study
def test_six_pages_play_at_once(server: LocalServer, raised: list[str]) -> None:
    pages = [joined(server) for _ in range(_PAGES)]
    received = [0] * _PAGES
    readers = [
        threading.Thread(target=_read, args=(page, received, k)) for k, page in enumerate(pages)
    ]
    for reader in readers:
        reader.start()
    until(lambda: sessions() == _PAGES and len(server.get_clients()) == _PAGES)
    until(lambda: min(received) > 20_000)
    buttons = []
    for client in server.get_clients().values():
        handles = dict(client.gui._gui_input_handle_from_uuid)
        buttons += [uuid for uuid, each in handles.items() if getattr(each, "label", "") == "Play"]
    assert len(buttons) == _PAGES
    before = list(received)
    for page in pages:
        for uuid in buttons:
            told = {"type": "GuiUpdateMessage", "uuid": uuid, "updates": {"value": True}}
            page.send(msgspec.msgpack.encode(told))
    # Each plays for itself, whatever the others take.
    until(lambda: all(now - then > 20_000 for now, then in zip(received, before, strict=True)))
    for page in pages:
        page.close()
    for reader in readers:
        reader.join(PATIENCE_S)
    until(lambda: sessions() == 0 and not server.get_clients())
    assert raised == []


def _read(page: Connection, received: list[int], k: int) -> None:
    """Take what comes, and answer as a page does that has shown it."""
    try:
        while True:
            data = page.recv()
            assert isinstance(data, bytes)
            received[k] += len(data)
            for message in messages_in(data):
                if message["type"] == "LocalStorageGetItemRequestMessage":
                    answer = {
                        "type": "LocalStorageGetItemResponseMessage",
                        **{"value": None, "error": None, "request_uuid": message["request_uuid"]},
                    }
                    page.send(msgspec.msgpack.encode(answer))
    except ConnectionClosed:
        return
