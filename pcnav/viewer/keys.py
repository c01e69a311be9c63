"""The keys of the page: what each does, for the list and for the browser."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, Protocol

import viser

from pcnav.viewer.controls import Controls
from pcnav.viewer.events import Kind


@dataclass(frozen=True)
class Key:
    """One key."""

    key: Any
    """As viser names it."""
    what: str
    run: Callable[[], object]
    shift: bool = False

    @property
    def shown(self) -> str:
        """As the list names it."""
        names = {"arrowleft": "←", "arrowright": "→", "space": "space"}
        name = names.get(self.key, self.key if len(self.key) == 1 else self.key.capitalize())
        return f"shift + {name}" if self.shift else name


class Moves(Protocol):
    """What keys ask of the session that they belong to."""

    @property
    def is_playing(self) -> bool: ...
    def play(self, wanted: bool) -> None: ...
    def step(self, frames: int) -> None: ...
    def jump(self, direction: int, kind: Kind | None) -> None: ...
    def go_to_worst(self) -> None: ...


_MAX_LAYERS = 9
_ALL = 10**9
"""More frames than there are."""
_MORE = (
    ("?", "this list"),
    ("Escape", "close a card or this list"),
    ("click in a plot or the time line", "go there"),
    ("drag in a plot", "zoom; a double click shows all"),
    ("click in the scene or the image", "what is there, and why it was rejected"),
)


def page_keys(moves: Moves, controls: Controls, *, has_returns: bool) -> tuple[Key, ...]:
    """Of a page: of a run without returns no key is there that would do nothing."""
    of_returns = (
        Key("R", "residuals of the points, and back", controls.toggle_residuals),
        Key("C", "colour the points by the next quantity", controls.next_colours),
        Key("M", "measure a distance", controls.toggle_measure),
    )
    return (
        Key("space", "play or pause", lambda: moves.play(not moves.is_playing)),
        Key("arrowleft", "one frame back", lambda: moves.step(-1)),
        Key("arrowright", "one frame on", lambda: moves.step(1)),
        Key("arrowleft", "ten frames back", lambda: moves.step(-10), shift=True),
        Key("arrowright", "ten frames on", lambda: moves.step(10), shift=True),
        Key("home", "first frame", lambda: moves.step(-_ALL)),
        Key("end", "last frame", lambda: moves.step(_ALL)),
        Key("N", "next event", lambda: moves.jump(1, None)),
        Key("P", "previous event", lambda: moves.jump(-1, None)),
        Key("X", "largest error over σ", moves.go_to_worst),
        *(of_returns if has_returns else ()),
        Key("L", "dark or light", controls.toggle_dark),
        *(
            Key(str(k + 1), f"show or hide: {layer}", partial(controls.toggle, k))
            for k, layer in enumerate(controls.layers[:_MAX_LAYERS])
        ),
    )


def bind(gui: viser.GuiApi, keys: tuple[Key, ...]) -> None:
    """Let the browser listen to them; Ctrl-K lists them, too."""
    for key in keys:
        command = gui.add_command(key.what, hotkey=key.key, modifier="shift" if key.shift else None)
        command.on_trigger(_pressed(key))


def _pressed(key: Key) -> Callable[[viser.CommandEvent], None]:
    def pressed(_: viser.CommandEvent) -> None:
        key.run()

    return pressed


def listed(keys: tuple[Key, ...]) -> list[list[str]]:
    """Key and what it does, for the list."""
    return [[key.shown, key.what] for key in keys] + [list(pair) for pair in _MORE]
