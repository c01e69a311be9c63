"""The web view: a server that gives every browser a session of its own."""

import threading

import viser

from pcnav.viewer.assessment import Opening
from pcnav.viewer.loaded_run import Source
from pcnav.viewer.server import LocalServer, label_of
from pcnav.viewer.session import Session


def serve(
    source: Source,
    host: str = "127.0.0.1",
    port: int = 8080,
    first_frame: int | Opening = Opening.LAST,
) -> LocalServer:
    """Start a server that shows a source; see `show`.

    A taken port moves up: read ``server.get_port()``. The caller keeps the process alive.
    """
    server = LocalServer(host, port, label_of([loaded.name for loaded in source().runs]))
    show(server, source, first_frame)
    return server


def show(server: LocalServer, source: Source, first_frame: int | Opening = Opening.LAST) -> None:
    """Give every browser of a server a session, those that have been waiting for it, too.

    ``first_frame`` is where a browser opens whose address names no frame.
    """
    sessions: dict[int, Session] = {}
    lock = threading.Lock()

    @server.on_client_connect
    def _(client: viser.ClientHandle) -> None:
        session = Session(client, source, first_frame)
        with lock:
            # It may have left while its session was built.
            gone = client.client_id not in server.get_clients()
            if not gone:
                sessions[client.client_id] = session
        if gone:
            session.close()

    @server.on_client_disconnect
    def _(client: viser.ClientHandle) -> None:
        with lock:
            session = sessions.pop(client.client_id, None)
        if session is not None:
            session.close()
