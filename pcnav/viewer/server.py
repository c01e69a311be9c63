"""The server: this machine alone unless told otherwise, and nobody else's pages."""

import io
import logging
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, redirect_stdout
from urllib.parse import urlsplit

import viser

LOOPBACK = "127.0.0.1"
UP = (0.0, -1.0, 0.0)
"""The top of the image, in the camera frame."""
_LOOPBACK = {LOOPBACK, "localhost", "::1"}
_PRINTING = threading.Lock()
_REFUSED = 1008
"""WebSocket close code: policy violation."""


class LocalServer(viser.ViserServer):
    """A server that no client can open to the outside, and no other site can talk to.

    A page of another site in the user's browser could connect to a port of this machine, as
    WebSockets know no same-origin rule: connections whose Origin is not this server are closed.
    """

    def __init__(self, host: str, port: int, label: str) -> None:
        # Whoever opens a connection and says nothing would fill the terminal.
        logging.getLogger("websockets").setLevel(logging.CRITICAL + 1)
        # viser prints a frame with its addresses; the command line says its own.
        with _silence():
            super().__init__(host=host, port=port, label=label, verbose=False)
        # Before any page is there: nothing says whether a page is told of it before or after its
        # own camera's place, which it reckons from the axes that it knows.
        self.scene.set_up_direction(UP)
        self.scene.world_axes.visible = False
        self.scene.configure_default_lights(enabled=True, cast_shadow=False)
        # Light of viser's photographed surroundings costs a browser without a graphics card three
        # seconds before it draws anything.
        self.scene.configure_environment_map(hdri=None)
        self.scene.add_light_ambient("/light", intensity=1.5)
        self._websock_server.on_client_connect(self._close_foreign)
        self.gui.configure_theme(
            dark_mode=True, show_share_button=False, show_logo=False, brand_color=(80, 150, 255)
        )

    def stop(self) -> None:
        """Stop it; what viser prints of that is not shown."""
        with _silence():
            super().stop()

    def request_share_url(self, verbose: bool = True) -> None:
        """Refuse the public tunnel that viser offers to any client."""

    async def _close_foreign(self, connection: viser.infra.WebsockClientConnection) -> None:
        # viser keeps the connection by client, but does not hand it to callbacks.
        socket = self._websock_server._live_connections[connection.client_id]
        headers = {} if socket.request is None else socket.request.headers
        if not is_own_origin(headers.get("Origin"), headers.get("Host"), self.get_host()):
            await socket.close(_REFUSED, "refused: the page comes from another site")


@contextmanager
def _silence() -> Iterator[None]:
    """Nothing printed. One at a time: the standard output is the whole process's."""
    with _PRINTING, redirect_stdout(io.StringIO()):
        yield


def is_own_origin(origin: str | None, host: str | None, serving: str) -> bool:
    """Whether a connection comes from this server's own page, or from no page at all.

    ``origin`` and ``host`` are the headers of the request, ``serving`` the address that is served
    on. The host must be this server's, see `is_own_host`.
    """
    if origin is None:
        return True
    try:
        return is_own_host(host, serving) and urlsplit(origin).netloc == host
    except ValueError:
        return False


def is_own_host(host: str | None, serving: str) -> bool:
    """Whether a request names this server: on loopback it must name loopback.

    A foreign name that was made to point here (DNS rebinding) is refused.
    """
    try:
        named = urlsplit(f"//{host or ''}").hostname
    except ValueError:
        return False
    return serving not in _LOOPBACK or named in _LOOPBACK


def label_of(names: Sequence[str]) -> str:
    """The title of a page that shows runs."""
    return f"pcnav: {' and '.join(names)}"


@contextmanager
def drawing(client: viser.ClientHandle) -> Iterator[None]:
    """A browser applies at once what is drawn in the block; one that has left is no fault."""
    with client._websock_connection.get_message_buffer().sanctioned_dead_writes(), client.atomic():
        yield


def has_shown_all(client: viser.ClientHandle, patience_s: float) -> bool:
    """Wait until a browser has worked off all that was drawn for it; whether it has in time.

    Its page answers questions in the order of the messages. Without asking, a page that draws
    slowly would be sent more and more that it cannot show.
    """
    buffer = client._websock_connection.get_message_buffer()
    try:
        with buffer.sanctioned_dead_writes():
            client.local_storage.get_item("pcnav", timeout=patience_s)
    except TimeoutError:
        return False
    except RuntimeError:
        # It left, or forbids its storage: then it has answered at least, or will be closed.
        return True
    return True
