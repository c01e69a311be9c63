"""The server: this machine alone unless told otherwise, and nobody else's pages."""

import io
import logging
import math
import threading
import warnings
from collections.abc import Callable, Coroutine, Iterator, Sequence
from contextlib import contextmanager, redirect_stdout
from typing import Any
from urllib.parse import urlsplit

import viser
import viser.infra
from viser._messages import GuiUpdateMessage, ViewerCameraMessage
from viser.infra import ClientId

from pcnav.core.errors import printable

LOOPBACK = "127.0.0.1"
UP = (0.0, -1.0, 0.0)
"""The top of the image, in the camera frame."""
_LOOPBACK = {LOOPBACK, "localhost", "::1"}
_PRINTING = threading.Lock()
_MAX_INTEGER, _MAX_TEXT, _MAX_ITEMS, _MAX_DEPTH = 2**53, 100_000, 1000, 6
"""Of messages of a page."""
_MAX_REASON = 200
_CAMERA_VECTORS: dict[str, tuple[float, ...]] = {
    "wxyz": (0.0,) * 4,
    **dict.fromkeys(("position", "look_at", "up_direction"), (0.0,) * 3),
}
_Handler = Callable[[ClientId, viser.infra.Message], Coroutine[Any, Any, None]]
_log = logging.getLogger(__name__)
_REFUSED = 1008
"""WebSocket close code: policy violation."""


class LocalServer(viser.ViserServer):
    """A server that no client can open to the outside, and no other site can talk to.

    A page of another site in the user's browser could connect to a port of this machine, as
    WebSockets know no same-origin rule: connections whose Origin is not this server are closed.
    """

    def __init__(self, host: str, port: int, label: str) -> None:
        self._told: set[int] = set()
        """Clients of which it was said already that they send what is left aside."""
        # What a page says that fits no message is dealt with below.
        warnings.filterwarnings("ignore", r"\[viser\] .* does not match annotation", UserWarning)
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
        # Each message goes to the server, and to the connection that it came over.
        inbox = self._websock_server
        inbox._handle_incoming_message = self._guarded(inbox)  # type: ignore[method-assign, assignment]
        inbox.on_client_connect(self._close_foreign)
        self.gui.configure_theme(
            dark_mode=True, show_share_button=False, show_logo=False, brand_color=(80, 150, 255)
        )

    def stop(self) -> None:
        """Stop it; what viser prints of that is not shown."""
        with _silence():
            super().stop()

    def request_share_url(self, verbose: bool = True) -> None:
        """Refuse the public tunnel that viser offers to any client."""

    def _guarded(self, inbox: viser.infra.WebsockMessageHandler) -> _Handler:
        """The handler of an inbox, which passes over what no page of ours sends."""
        handle = inbox._handle_incoming_message

        async def guarded(client_id: ClientId, message: viser.infra.Message) -> None:
            try:
                if is_sound(message, self._input_of(client_id, message)):
                    await handle(client_id, message)
                    return
                reason = "it says what no control can be"
            # Whatever viser meets in it.
            except Exception as error:
                reason = f"{type(error).__name__}: {error}"
            if client_id not in self._told:
                self._told.add(client_id)
                kind, told = type(message).__name__, printable(reason, _MAX_REASON)
                _log.warning("view: a page's message (%s) was left aside: %s", kind, told)

        return guarded

    def _input_of(self, client_id: ClientId, message: viser.infra.Message) -> object:
        """The control that a message is about, None for none."""
        client = self.get_clients().get(client_id)
        uuid = getattr(message, "uuid", None)
        if client is None or not isinstance(uuid, str):
            return None
        return client.gui._gui_input_handle_from_uuid.get(uuid)

    async def _close_foreign(self, connection: viser.infra.WebsockClientConnection) -> None:
        guarded = self._guarded(connection)
        connection._handle_incoming_message = guarded  # type: ignore[method-assign, assignment]
        # viser keeps the connection by client, but does not hand it to callbacks.
        socket = self._websock_server._live_connections[connection.client_id]
        headers = {} if socket.request is None else socket.request.headers
        if not is_own_origin(headers.get("Origin"), headers.get("Host"), self.get_host()):
            await socket.close(_REFUSED, "refused: the page comes from another site")


def is_sound(message: object, control: Any) -> bool:
    """Whether a message can come from a page of this server.

    viser sets whatever attribute an update names, and our controls take any value for one that
    they can have: neither may be asked for what is not finite, endless or out of the control's
    range.
    """
    if isinstance(message, GuiUpdateMessage):
        if control is None or set(message.updates) != {"value"}:
            return control is None
        props, value = control._impl.props, message.updates["value"]
        if not (_is_like(value, control._impl.value) and _is_finite(value)):
            return False
        options = getattr(props, "options", None)
        if options is not None and value not in options:
            return False
        low, high = getattr(props, "min", None), getattr(props, "max", None)
        return (low is None or low <= value) and (high is None or value <= high)
    if isinstance(message, ViewerCameraMessage):
        told = vars(message)
        return _is_finite(told) and _is_like(told, dict.fromkeys(told, 0.0) | _CAMERA_VECTORS)
    return _is_finite(vars(message))


def _is_like(value: object, good: object) -> bool:
    """Whether a value is of the kind of another; whole numbers stand for others, too."""
    if isinstance(good, dict):
        return isinstance(value, dict) and all(_is_like(v, good[k]) for k, v in value.items())
    if isinstance(good, tuple):
        is_list = isinstance(value, list | tuple) and len(value) == len(good)
        return is_list and all(map(_is_like, value, good))  # type: ignore[call-overload]
    if isinstance(good, bool) or isinstance(value, bool):
        return isinstance(good, bool) and isinstance(value, bool)
    if isinstance(good, int | float):
        return isinstance(value, int | float)
    return good is None or isinstance(value, type(good))


def _is_finite(value: object, depth: int = 0) -> bool:
    """Whether all numbers are finite and all that is counted is little."""
    if isinstance(value, float):
        return math.isfinite(value)
    if isinstance(value, int):
        return abs(value) <= _MAX_INTEGER
    if isinstance(value, str):
        return len(value) <= _MAX_TEXT
    if isinstance(value, dict):
        value = list(value.values())
    if isinstance(value, list | tuple):
        few = depth < _MAX_DEPTH and len(value) <= _MAX_ITEMS
        return few and all(_is_finite(each, depth + 1) for each in value)
    return True


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
