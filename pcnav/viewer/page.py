"""What a page shows beside viser's own parts (status bar, time line, plots, cards), and says.

A panel that is never seen holds all of it: the script, a channel of JSON each way. Its own window
keeps it on the page when the user folds the other panels.
"""

import json
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import viser

_SCRIPTS = ("page.js", "plots.js")
CHANNELS = ("help", "timeline", "plots", "now", "card", "address")
PLOTS_HTML = (
    "<div class='pcnav-plots'></div><img src='data:,' alt='' style='display:none' "
    "onerror='window.pcnav&amp;&amp;pcnav.plots&amp;&amp;pcnav.plots.build()'>"
)
"""Where the plots are drawn."""
_MAX_MESSAGE, _MAX_NUMBER = 4000, 1e12

Json = dict[str, Any] | list[Any] | str


class Page:
    """The page of one browser: sends by channel, hears what the user does."""

    def __init__(self, gui: viser.GuiApi, on_message: Callable[[dict[str, Any]], None]) -> None:
        panel = gui.add_panel()
        with panel.add_tab("pcnav"):
            gui.add_html(_on_arrival("", _script(), ""))
            self._channels = {name: gui.add_html("") for name in CHANNELS}
            self._heard = gui.add_text("page", "")
        panel.float(x=0, y=0, width=200, height=100)
        self.sent: dict[str, Json] = {}
        """By channel, what was sent last."""

        @self._heard.on_update
        def _(_: object) -> None:
            message = read_message(self._heard.value)
            if message is not None:
                on_message(message)

    def send(self, channel: str, content: Json) -> None:
        """Show something, in place of what the channel showed before."""
        if self.sent.get(channel) == content:
            return
        self.sent[channel] = content
        text = json.dumps(content, separators=(",", ":"), allow_nan=False)
        take = f"window.pcnav&&pcnav.take('{channel}',this.alt)"
        self._channels[channel].content = _on_arrival(text, take, channel)


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
