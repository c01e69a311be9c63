"""The keys of the page: what each does, for the list and for the browser."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import viser


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


_MORE = (
    ("?", "this list"),
    ("Escape", "close a card or this list"),
    ("click in a plot or the time line", "go there"),
    ("drag in a plot", "zoom; a double click shows all"),
    ("click in the scene", "what is there"),
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
