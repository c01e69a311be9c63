"""What a page shows beside viser's own parts (status bar, time line, plots, cards), and says.

A panel that is never seen holds all of it: the script, a channel of JSON each way. Its own window
keeps it on the page when the user folds the other panels.

A page asks to be opened as its address says, and asks again until the server confirms that it was:
what it says while it is put together, or connects anew, may be lost. It says nothing else before.
"""

import json
import secrets
import threading
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import viser

from pcnav.viewer.server import drawing

_SCRIPTS = ("page.js", "plots.js")
CHANNELS = ("help", "timeline", "plots", "now", "card", "address", "opened")
PLOTS_HTML = (
    "<div class='pcnav-plots'></div><img src='data:,' alt='' style='display:none' "
    "onerror='window.pcnav&amp;&amp;pcnav.plots&amp;&amp;pcnav.plots.build()'>"
)
"""Where the plots are drawn."""
_MAX_MESSAGE, _MAX_NUMBER = 4000, 1e12

Json = dict[str, Any] | list[Any] | str


class Page:
    """The page of one browser: sends by channel, hears what the user does.

    ``on_open`` is called once, with the address, and has opened the page when it returns;
    ``on_message`` is called with all else that the page says.
    """

    def __init__(
        self,
        client: viser.ClientHandle,
        on_open: Callable[[str], None],
        on_message: Callable[[dict[str, Any]], None],
    ) -> None:
        gui = client.gui
        self._client, self._on_open = client, on_open
        self._opening, self._asked = threading.Lock(), 0
        self._session = secrets.token_hex(8)
        """A page that connected anew may still hold requests and answers of the time before."""
        self.is_opened = False
        """Whether the page shows what its address asked for: until then it may not be set."""
        panel = gui.add_panel()
        with panel.add_tab("pcnav"):
            gui.add_html(_on_arrival(self._session, _script(), ""))
            self._channels = {name: gui.add_html("") for name in CHANNELS}
            self._heard = gui.add_text("page", "")
        panel.float(x=0, y=0, width=200, height=100)
        self.sent: dict[str, Json] = {}
        """By channel, what was sent last."""

        @self._heard.on_update
        def _(_: object) -> None:
            message = read_message(self._heard.value)
            if message is not None and message["do"] == "open":
                self._open(message)
            elif message is not None:
                on_message(message)

    def send(self, channel: str, content: Json) -> None:
        """Show something, in place of what the channel showed before."""
        if self.sent.get(channel) == content:
            return
        self.sent[channel] = content
        text = json.dumps(content, separators=(",", ":"), allow_nan=False)
        take = f"window.pcnav&&pcnav.take('{channel}',this.alt)"
        with drawing(self._client):
            self._channels[channel].content = _on_arrival(text, take, channel)

    def _open(self, message: dict[str, Any]) -> None:
        """Open the page as it asks, if it was not yet; confirm it in any case."""
        state = message.get("state")
        if message.get("session") != self._session or not isinstance(state, str):
            return
        with self._opening:
            if not self.is_opened:
                try:
                    self._on_open(state)
                finally:
                    # What cannot be opened once cannot be the next time.
                    self.is_opened = True
            self._asked += 1
            # Counted, as what was sent already is not sent again.
            self.send("opened", {"session": self._session, "asked": self._asked})


def read_message(text: str) -> dict[str, Any] | None:
    """What a page said; None for what no page of ours says."""
    if len(text) > _MAX_MESSAGE:
        return None
    try:
        found = json.loads(text)
    except (ValueError, RecursionError):
        return None
    return found if isinstance(found, dict) and isinstance(found.get("do"), str) else None


def number_of(message: dict[str, Any]) -> float | None:
    """The time, frame or index that a message of the page tells; None for none that can be."""
    at = message.get("time", message.get("frame", message.get("index")))
    if isinstance(at, bool) or not isinstance(at, int | float):
        return None
    return float(at) if abs(at) < _MAX_NUMBER else None


@cache
def _script() -> str:
    folder = Path(__file__).parent / "client"
    return "\n".join((folder / name).read_text(encoding="utf-8") for name in _SCRIPTS)


def _on_arrival(text: str, script: str, channel: str) -> str:
    """HTML that runs a script as soon as it is on the page: a picture that cannot be loaded."""
    return (
        f"<img class='pcnav-bridge' src='data:,' data-channel='{channel}' style='display:none' "
        f"alt='{_quoted(text)}' onerror='{_quoted(script)}'>"
    )


def _quoted(text: str) -> str:
    """A text as the value of an attribute in single quotes, shorter than `html.escape` has it."""
    return text.replace("&", "&amp;").replace("<", "&lt;").replace("'", "&#39;")
