"""The controls of one browser: time, colours, camera, layers."""

from enum import StrEnum
from html import escape
from typing import Protocol

import viser

from pcnav.viewer.clock import speeds
from pcnav.viewer.events import Kind
from pcnav.viewer.export import Share
from pcnav.viewer.frames import ColourBy
from pcnav.viewer.loaded_run import Snapshot
from pcnav.viewer.render_options import DEFAULT_LAYERS, Layer, RenderOptions

_ANY_EVENT = "any event"
_MAGNIFIED: dict[str, float | None] = {
    "enlarged to be seen": None,
    "true size": 1.0,
    "10 × larger": 10.0,
    "100 × larger": 100.0,
    "1000 × larger": 1000.0,
}
_FIRST, _BACK, _ON, _LAST = "|<", "<", ">", ">|"


class Viewpoint(StrEnum):
    """Where the browser looks from."""

    CHASER = "chaser's eye"
    ORBIT = "orbit"
    FOLLOW = "follow"


class Commands(Protocol):
    """What the controls ask of the session that they belong to."""

    @property
    def is_playing(self) -> bool: ...
    def go_to(self, frame: int) -> None: ...
    def step(self, frames: int) -> None: ...
    def jump(self, direction: int, kind: Kind | None) -> None: ...
    def play(self, wanted: bool) -> None: ...
    def redraw(self) -> None: ...
    def change_speed(self) -> None: ...
    def share(self, share: Share) -> None: ...
    def look_from(self, viewpoint: Viewpoint) -> None: ...


class Controls:
    """The main panel of one browser."""

    def __init__(self, gui: viser.GuiApi, snapshot: Snapshot, session: Commands) -> None:
        self._gui, self._session = gui, session
        first = snapshot.runs[0]
        self._frames = len(first)
        self._notes = gui.add_html(_notes_html(snapshot))
        self._add_time(gui, snapshot)
        self._add_colours(gui, first.frames is not None)
        self._checkboxes = self._add_layers(gui, snapshot)
        self._add_share(gui)

    # Read by the session.

    @property
    def options(self) -> RenderOptions:
        """How a frame is to be drawn."""
        return RenderOptions(
            layers=frozenset(layer for layer, box in self._checkboxes.items() if box.value),
            colour_by=ColourBy(self._colour.value),
            magnified=_MAGNIFIED[self._magnified.value],
        )

    @property
    def speed(self) -> float:
        """Seconds of the run per second."""
        return self._speeds[self._speed.value]

    @property
    def follows_newest(self) -> bool:
        """Whether the newest frame of a run that goes on is shown."""
        return self._newest.visible and bool(self._newest.value)

    # Told by the session.

    def show_frame(self, frame: int) -> None:
        """Put the slider where the time is."""
        # viser types the value as read-only, though assigning is how it is set.
        self._slider.value = frame  # type: ignore[misc]

    def show_playing(self, playing: bool) -> None:
        """Name the button after what it does."""
        self._play.label = "Pause" if playing else "Play"

    def stop_following_newest(self) -> None:
        """The user looks at a frame of their own choice."""
        self._newest.value = False  # type: ignore[misc]

    def refresh(self, snapshot: Snapshot) -> None:
        """There are more frames, or the run has ended."""
        first = snapshot.runs[0]
        self._frames, self._speeds = len(first), dict(speeds(first.run.time_s))
        self._slider.max = max(self._frames - 1, 1)
        self._newest.visible = snapshot.is_live
        self._notes.content = _notes_html(snapshot)

    def show_legend(self, html: str) -> None:
        """Say what the colours of the points mean."""
        self._legend.content = html

    def tell(self, text: str) -> None:
        """One line below the controls of time."""
        self._told.content = _line(text)

    def _add_time(self, gui: viser.GuiApi, snapshot: Snapshot) -> None:
        first = snapshot.runs[0]
        self._slider = gui.add_slider(
            "frame", min=0, max=max(self._frames - 1, 1), step=1, initial_value=0
        )
        self._newest = gui.add_checkbox(
            "newest frame", initial_value=snapshot.is_live, visible=snapshot.is_live
        )
        self._play = gui.add_button("Play")
        steps = gui.add_button_group("step", (_FIRST, _BACK, _ON, _LAST))
        self._speeds = dict(speeds(first.run.time_s))
        names = tuple(self._speeds)
        self._speed = gui.add_dropdown("speed", names, initial_value=names[-1])
        self._event_kind = gui.add_dropdown("events", (_ANY_EVENT, *(str(kind) for kind in Kind)))
        jumps = gui.add_button_group("jump to", ("previous", "next"))
        self._told = gui.add_html(_line(_counted(first.events)))

        @self._slider.on_update
        def _(event: viser.GuiEvent[viser.GuiSliderHandle[int]]) -> None:
            if event.client is not None:
                self.stop_following_newest()
                self._session.go_to(int(self._slider.value))

        @self._play.on_click
        def _(_: object) -> None:
            self._session.play(not self._session.is_playing)

        @steps.on_click
        def _(_: object) -> None:
            far = self._frames
            self._session.step({_FIRST: -far, _BACK: -1, _ON: 1, _LAST: far}[steps.value])

        @jumps.on_click
        def _(_: object) -> None:
            chosen = self._event_kind.value
            kind = None if chosen == _ANY_EVENT else Kind(chosen)
            self._session.jump(1 if jumps.value == "next" else -1, kind)

        self._speed.on_update(lambda _: self._session.change_speed())

    def _add_colours(self, gui: viser.GuiApi, has_frames: bool) -> None:
        self._colour = gui.add_dropdown(
            "points by",
            tuple(str(by) for by in ColourBy),
            initial_value=str(ColourBy.PLANE),
            visible=has_frames,
        )
        self._legend = gui.add_html("")
        self._magnified = gui.add_dropdown(
            "3σ drawn", tuple(_MAGNIFIED), initial_value="enlarged to be seen"
        )
        camera = gui.add_button_group("look from", tuple(str(each) for each in Viewpoint))
        self._colour.on_update(lambda _: self._session.redraw())
        self._magnified.on_update(lambda _: self._session.redraw())
        camera.on_click(lambda _: self._session.look_from(Viewpoint(camera.value)))

    def _add_layers(
        self, gui: viser.GuiApi, snapshot: Snapshot
    ) -> dict[Layer, viser.GuiCheckboxHandle]:
        boxes = {}
        with gui.add_folder("Layers"):
            for layer in available_layers(snapshot):
                boxes[layer] = gui.add_checkbox(str(layer), initial_value=layer in DEFAULT_LAYERS)
                boxes[layer].on_update(lambda _: self._session.redraw())
        return boxes

    def _add_share(self, gui: viser.GuiApi) -> None:
        with gui.add_folder("Share", expand_by_default=False):
            for share in Share:
                self._add_share_button(gui, share)

    def _add_share_button(self, gui: viser.GuiApi, share: Share) -> None:
        gui.add_button(str(share)).on_click(lambda _: self._session.share(share))


def available_layers(snapshot: Snapshot) -> tuple[Layer, ...]:
    """The layers that a run has anything for."""
    first = snapshot.runs[0]
    available = first.layers
    if snapshot.is_live and first.target is not None:
        # What a run that goes on knows of the truth is seen when it has ended.
        available |= {Layer.TRUTH}
    return tuple(layer for layer in Layer if layer in available)


def _counted(events: tuple[object, ...]) -> str:
    return "1 event" if len(events) == 1 else f"{len(events) or 'no'} events"


def _notes_html(snapshot: Snapshot) -> str:
    notes = [note for loaded in snapshot.runs for note in loaded.notes]
    if snapshot.is_live:
        notes.append("live: the run goes on")
    return "".join(
        f"<div style='font-size:12px;padding:4px 10px;color:#ffc43c'>{escape(note)}</div>"
        for note in notes
    )


def _line(text: str) -> str:
    return f"<div style='font-size:12px;padding:0 10px;opacity:.8'>{escape(text)}</div>"
