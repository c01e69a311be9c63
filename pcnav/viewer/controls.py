"""The controls of one browser: time, colours, camera, layers."""

from html import escape
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Protocol

import viser

from pcnav.viewer.address import PageState
from pcnav.viewer.camera import Viewpoint
from pcnav.viewer.clock import speeds
from pcnav.viewer.events import Kind
from pcnav.viewer.export import Share
from pcnav.viewer.frames import MAX_POINTS, ColourBy
from pcnav.viewer.future import AHEAD_S
from pcnav.viewer.loaded_run import LoadedRun, Snapshot
from pcnav.viewer.render_options import DEFAULT_LAYERS, Layer, RenderOptions

_ANY_EVENT = "any event"
_MAGNIFIED: dict[str, float | None] = {
    "enlarged to be seen": None,
    "true size": 1.0,
    "10 × larger": 10.0,
    "100 × larger": 100.0,
    "1000 × larger": 1000.0,
}
_POINTS = {"60,000": MAX_POINTS, "150,000": 150_000, "300,000": 300_000, "all": 10**9}
_OF_SENSOR = "3 σ of the sensor"
_LIMITS_MM: dict[str, float | None] = {
    _OF_SENSOR: None,
    **{f"± {limit:g} mm": limit for limit in (1.0, 3.0, 10.0, 30.0, 100.0, 300.0)},
}
_AHEAD: dict[str, float | None] = {
    "none": None,
    **{f"{ahead:g} s after the last estimate": ahead for ahead in AHEAD_S},
}
_WORST, _RESIDUALS = "worst", "residuals"
_FIRST, _BACK, _ON, _LAST = "|<", "<", ">", ">|"


class Commands(Protocol):
    """What the controls ask of the session that they belong to."""

    @property
    def is_playing(self) -> bool: ...
    def go_to_worst(self) -> None: ...
    def step(self, frames: int) -> None: ...
    def jump(self, direction: int, kind: Kind | None) -> None: ...
    def play(self, wanted: bool) -> None: ...
    def redraw(self) -> None: ...
    def change_speed(self) -> None: ...
    def share(self, share: Share) -> None: ...
    def look_from(self, viewpoint: Viewpoint) -> None: ...
    def measure(self, wanted: bool) -> None: ...
    def darken(self, dark: bool) -> None: ...


def set_value(control: Any, value: object) -> None:
    """Set a control as if the user had; viser types the value as read-only."""
    control.value = value


class Controls:
    """The main panel of one browser."""

    def __init__(self, gui: viser.GuiApi, snapshot: Snapshot, session: Commands) -> None:
        self._gui, self._session = gui, session
        first = snapshot.runs[0]
        self._frames = len(first)
        self._notes = gui.add_html(_notes_html(snapshot))
        self._add_time(gui, snapshot)
        has_future = first.target is not None and not snapshot.is_live
        self._add_colours(gui, first.frames is not None, has_future)
        self._checkboxes = self._add_layers(gui, snapshot)
        self._add_share(gui)

    # Read by the session.

    @property
    def options(self) -> RenderOptions:
        """How a frame is to be drawn."""
        limit_mm = _LIMITS_MM[self._limits.value]
        return RenderOptions(
            layers=frozenset(layer for layer, box in self._checkboxes.items() if box.value),
            colour_by=ColourBy(self._colour.value),
            magnified=_MAGNIFIED[self._magnified.value],
            max_points=_POINTS[self._points.value],
            point_size=float(self._point_size.value),
            forecast_s=_AHEAD[self._ahead.value],
            residual_scale_m=None if limit_mm is None else 1e-3 * limit_mm,
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

    @property
    def is_dark(self) -> bool:
        """Whether the page is dark."""
        return bool(self._dark.value)

    @property
    def measures(self) -> bool:
        """Whether a click begins or ends a distance."""
        return bool(self._measure.value)

    @property
    def layers(self) -> tuple[Layer, ...]:
        """The layers that can be switched, in the order of their boxes."""
        return tuple(self._checkboxes)

    def toggle(self, box: int) -> None:
        """Show or hide the layer of a number from 0 on."""
        boxes = list(self._checkboxes.items())
        if box < len(boxes):
            layer, checkbox = boxes[box]
            set_value(checkbox, not checkbox.value)
            # The boxes may lie below the screen, and a layer may have nothing in this frame.
            self.tell(f"{layer}: {'shown' if checkbox.value else 'hidden'}")
            self._session.redraw()

    def next_colours(self) -> None:
        """Colour the points by the next quantity."""
        kinds = list(ColourBy)
        after = (kinds.index(ColourBy(self._colour.value)) + 1) % len(kinds)
        set_value(self._colour, str(kinds[after]))
        self._session.redraw()

    def toggle_residuals(self) -> None:
        """Colour the points by their residuals, and back by planes."""
        shown = ColourBy(self._colour.value) is ColourBy.RESIDUAL
        set_value(self._colour, str(ColourBy.PLANE if shown else ColourBy.RESIDUAL))
        self._session.redraw()

    def toggle_measure(self) -> None:
        """Begin or end measuring."""
        set_value(self._measure, not self._measure.value)
        self._session.measure(self._measure.value)

    def toggle_dark(self) -> None:
        """Dark to light and back."""
        set_value(self._dark, not self._dark.value)
        self._session.darken(self._dark.value)

    def take(self, state: PageState) -> None:
        """Layers, colours, points and theme of an address, as far as it tells."""
        if state.layers is not None:
            for layer, box in self._checkboxes.items():
                set_value(box, layer in state.layers)
        if state.colour_by is not None:
            set_value(self._colour, str(state.colour_by))
        if state.max_points is not None:
            # The next larger choice, so that a link made elsewhere never shows less.
            names = [name for name, most in _POINTS.items() if most >= state.max_points]
            set_value(self._points, names[0] if names else next(reversed(_POINTS)))
        if state.dark is not None and state.dark is not self.is_dark:
            self.toggle_dark()

    def show_playing(self, playing: bool) -> None:
        """Name the button after what it does."""
        self._play.label = "Pause" if playing else "Play"

    def stop_following_newest(self) -> None:
        """The user looks at a frame of their own choice."""
        set_value(self._newest, False)

    def refresh(self, snapshot: Snapshot) -> None:
        """There are more frames, or the run has ended."""
        first = snapshot.runs[0]
        self._frames, self._speeds = len(first), dict(speeds(first.run.time_s))
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
        told = [_WORST] if first.errors is not None else []
        told += [_RESIDUALS] if first.frames is not None else []
        deviations = gui.add_button_group("deviations", told or [""], visible=bool(told))
        self._told = gui.add_html("")

        @deviations.on_click
        def _(_: object) -> None:
            if deviations.value == _WORST:
                self._session.go_to_worst()
            else:
                self.toggle_residuals()

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

    def _add_colours(self, gui: viser.GuiApi, has_frames: bool, has_future: bool) -> None:
        self._colour = gui.add_dropdown(
            "points by",
            tuple(str(by) for by in ColourBy),
            initial_value=str(ColourBy.PLANE),
            visible=has_frames,
        )
        self._legend = gui.add_html("")
        self._limits = gui.add_dropdown(
            "residuals to", tuple(_LIMITS_MM), initial_value=_OF_SENSOR, visible=has_frames
        )
        self._points = gui.add_dropdown(
            "points, at most", tuple(_POINTS), initial_value=next(iter(_POINTS)), visible=has_frames
        )
        self._point_size = gui.add_slider(
            "point size", 0.25, 4.0, 0.25, initial_value=1.0, visible=has_frames
        )
        self._magnified = gui.add_dropdown(
            "3σ drawn", tuple(_MAGNIFIED), initial_value="enlarged to be seen"
        )
        self._ahead = gui.add_dropdown(
            "forecast", tuple(_AHEAD), initial_value="none", visible=has_future
        )
        self._ahead.on_update(lambda _: self._session.redraw())
        camera = gui.add_button_group("look from", tuple(str(each) for each in Viewpoint))
        self._colour.on_update(lambda _: self._session.redraw())
        self._magnified.on_update(lambda _: self._session.redraw())
        for control in (self._limits, self._points, self._point_size):
            control.on_update(lambda _: self._session.redraw())
        camera.on_click(lambda _: self._session.look_from(Viewpoint(camera.value)))
        self._measure = gui.add_checkbox("measure distance", False, visible=has_frames)
        self._measure.on_update(lambda _: self._session.measure(bool(self._measure.value)))
        self._dark = gui.add_checkbox("dark", True)
        self._dark.on_update(lambda _: self._session.darken(bool(self._dark.value)))

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
                if share is Share.RRD and find_spec("rerun") is None:
                    continue
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


def recording_of(loaded: LoadedRun) -> Path | None:
    """Where the recording of a run is or was; None where it does not tell."""
    pipeline = loaded.run.pipeline
    if pipeline is None or pipeline.sequence is None:
        return None
    return Path(pipeline.sequence).resolve()


def _notes_html(snapshot: Snapshot) -> str:
    notes = [note for loaded in snapshot.runs for note in loaded.notes]
    if len({recording_of(loaded) for loaded in snapshot.runs} - {None}) > 1:
        notes.append("the runs are of different recordings: compared by time alone")
    if snapshot.is_live:
        notes.append("live: the run goes on")
    return "".join(
        "<div class='pcnav-note' style='font-size:12px;padding:4px 10px;color:#ffc43c'>"
        f"{escape(note)}</div>"
        for note in notes
    )


def _line(text: str) -> str:
    return f"<div style='font-size:12px;padding:0 10px;opacity:.8'>{escape(text)}</div>"
