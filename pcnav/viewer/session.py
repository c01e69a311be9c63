"""One browser: its own time, layers and plots, drawn by a thread of its own."""

import threading
import time
from contextlib import suppress
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import viser

from pcnav.viewer.address import PageState, read_address
from pcnav.viewer.assessment import Opening, opening_frame, worst_frame
from pcnav.viewer.browser import BACKGROUND
from pcnav.viewer.camera import Viewfinder, Viewpoint
from pcnav.viewer.clock import Paced, Playback, frame_to_show
from pcnav.viewer.controls import Controls
from pcnav.viewer.events import Kind, neighbour
from pcnav.viewer.export import Share, exported, file_name
from pcnav.viewer.flow import Flow
from pcnav.viewer.frames import Shot
from pcnav.viewer.keys import bind, listed, page_keys
from pcnav.viewer.layers import RunLayers, read_ahead, shot_of
from pcnav.viewer.loaded_run import LoadedRun, Snapshot, Source, all_events
from pcnav.viewer.page import Page, number_of
from pcnav.viewer.palette import RUNS
from pcnav.viewer.panels import legend_html, ray_through
from pcnav.viewer.picking import Ray
from pcnav.viewer.pointer import Pointer
from pcnav.viewer.server import drawing, has_shown_all
from pcnav.viewer.side_panel import SidePanel
from pcnav.viewer.status_bar import status_of_frame
from pcnav.viewer.timeline import text_of, time_line

_MAX_DRAWN_HZ = 30.0
_TEXTS_HZ = 8.0
_PICTURE_HZ = 2.0
_TEXTS_EVERY, _PICTURE_EVERY = 3, 8
"""Frames of a run that is played."""
_ADDRESS_HZ = 1.0
_PLOTS_LIVE_S = 2.0
_IDLE_S = 0.1
_PATIENCE_S = 2.0
_CONTROLS_PX = 270


class Session:
    """What one browser sees."""

    def __init__(
        self, client: viser.ClientHandle, source: Source, first_frame: int | Opening
    ) -> None:
        self._client, self._source = client, source
        self._snapshot = source()
        self._events = all_events(self._runs)
        self._visited: int | None = None
        """The event that was jumped to last."""
        self._wanted, self._drawn = _start_frame(self._snapshot, first_frame), -1
        self._details_frame = -1
        self._shot: Shot | None = None
        self._is_closed = False
        self._named_from: tuple[float, ...] = ()
        """The browser's camera that names were laid out for last."""
        self._wake = threading.Condition()
        self._playback: Playback | None = None
        self._prepared: int | None = None
        """The frame that is read ahead."""
        self._redraw = self._redraw_plots = False
        self._picture = Paced(1.0 / _PICTURE_HZ, _PICTURE_EVERY)
        self._texts = Paced(1.0 / _TEXTS_HZ, _TEXTS_EVERY)
        self._plots_paced, self._addressed = Paced(_PLOTS_LIVE_S), Paced(1.0 / _ADDRESS_HZ)
        with drawing(client):
            self._page = Page(client, lambda state: self.open(read_address(state)), self.hear)
            self._layers = RunLayers(client.scene, self._runs, RUNS)
            self._controls = Controls(client.gui, self._snapshot, self)
            client.gui.main_panel.dock_left()
            client.gui.main_panel.set_width(_CONTROLS_PX)
            self._side = SidePanel(client.gui, self._runs, lambda: self.redraw(plots=True))
            self._pointer = Pointer(client, self._page)
            self._viewfinder = Viewfinder(client)
            keys = page_keys(self, self._controls, has_returns=self._first.frames is not None)
            bind(client.gui, keys)
            self._page.send("help", listed(keys))
            client.scene.on_click()(self._pick)
            self._page.send("timeline", time_line(self._runs, self._events))
            self._page.send("plots", self._side.plots(self._runs))
            self._controls.tell(f"{len(self._events)} event(s); ? lists the keys")
            self._look_at_first()
            if len(self._first):
                frame = min(self._wanted, len(self._first) - 1)
                self._draw(time.monotonic(), frame, self._shot_of(frame))
        self._flow = Flow(partial(has_shown_all, client, _PATIENCE_S))
        self._flow.sent()
        self._thread = threading.Thread(target=self._run, daemon=True, name="pcnav session")
        self._thread.start()

    # What the controls ask for.

    def go_to(self, frame: int) -> None:
        """Show a frame; the newest wish wins. Playing starts again from there."""
        last = max(len(self._first) - 1, 0)
        with self._wake:
            self._wanted = min(max(frame, 0), last)
            if self._playback is not None:
                self._playback = self._playing_from(self._wanted)
            self._wake.notify()

    def step(self, frames: int) -> None:
        """Move by so many frames, at rest."""
        self._rest_at(self._wanted + frames)

    def go_to_worst(self) -> None:
        """Go to the largest error over sigma."""
        worst = worst_frame(self._first)
        if worst is None:
            self._controls.tell("no error is known: there is no truth")
            return
        self._rest_at(worst)

    def jump(self, direction: int, kind: Kind | None) -> None:
        """Go to the next event (1) or the one before (-1)."""
        found = neighbour(self._events, self._wanted, self._visited, direction, kind)
        if found is None:
            self._controls.tell("no such event there")
            return
        self.visit(found)

    def visit(self, index: int) -> None:
        """Go to an event by its index."""
        self._visited = index
        self._rest_at(self._events[index].frame)
        self._controls.tell(text_of(self._events[index], self._runs))

    def play(self, wanted: bool) -> None:
        """Start or stop."""
        with self._wake:
            at_end = self._wanted >= len(self._first) - 1
            start = 0 if at_end else self._wanted
            self._playback = self._playing_from(start) if wanted and len(self._first) else None
            self._wake.notify()
        self._controls.show_playing(self.is_playing)

    @property
    def is_playing(self) -> bool:
        """Whether time runs."""
        return self._playback is not None

    def redraw(self, *, plots: bool = False) -> None:
        """Draw the same frame anew, or the plots that were chosen."""
        with self._wake:
            self._redraw, self._redraw_plots = (
                self._redraw or not plots,
                self._redraw_plots or plots,
            )
            self._wake.notify()

    def change_speed(self) -> None:
        """Go on from here at the chosen speed."""
        self.go_to(self._wanted)

    def share(self, share: Share) -> None:
        """Let the browser download what it shows."""
        self._controls.tell(f"making {share} ...")
        frame, options = self.shown_frame, self._controls.options
        content = exported(share, self._runs, frame, options, self._client)
        name = file_name(share, self._runs, frame)
        self._client.send_file_download(name, content, save_immediately=True)
        self._controls.tell(f"{name}: {len(content) / 1e6:.1f} MB")

    def look_from(self, viewpoint: Viewpoint) -> None:
        """Move the browser's camera."""
        self._viewfinder.look_from(viewpoint, self._first, self._wanted, self._shot)

    def measure(self, wanted: bool) -> None:
        """Let clicks measure distances, or tell what was clicked at."""
        self._pointer.measure(wanted)
        self._controls.tell("click at two returns" if wanted else "")

    def darken(self, dark: bool) -> None:
        """A dark page, or a light one."""
        self._client.gui.configure_theme(
            dark_mode=dark, show_share_button=False, show_logo=False, brand_color=(80, 150, 255)
        )
        # The scene stays dark: its colours are for that.
        behind = None if dark else np.full((2, 2, 3), BACKGROUND, dtype=np.uint8)
        self._client.scene.set_background_image(behind, format="png")

    @property
    def shown_frame(self) -> int:
        """The frame on the screen."""
        return max(self._drawn, 0)

    def close(self) -> None:
        """The browser has gone."""
        with self._wake:
            self._is_closed = True
            self._wake.notify()

    # What the page says.

    def hear(self, message: dict[str, Any]) -> None:
        """What the user did at the time line, the plots or the bar; nonsense is passed over."""
        kind = message["do"]
        at = number_of(message)
        if kind == "closed":
            self._pointer.clear()
        elif kind == "image":
            self._pick_in_image(message)
        elif at is None or not len(self._first):
            return
        elif kind == "seek":
            self._rest_at(int(np.argmin(np.abs(self._first.run.time_s - at))))
        elif kind == "frame":
            self._rest_at(int(at))
        elif kind == "event" and 0 <= int(at) < len(self._events):
            self.visit(int(at))

    def open(self, state: PageState) -> None:
        """Show what an address says."""
        self._controls.take(state)
        if state.plots is not None:
            self._side.choose(state.plots)
        if state.camera is not None:
            self._viewfinder.set_state(state.camera)
        if isinstance(state.frame, Opening):
            self._rest_at(opening_frame(self._first, state.frame))
        elif state.frame is not None:
            self._rest_at(state.frame)
        self.redraw()
        self.redraw(plots=True)

    def _rest_at(self, frame: int) -> None:
        self.play(False)
        self._controls.stop_following_newest()
        self.go_to(frame)

    def _pick(self, event: viser.SceneClickEvent) -> None:
        direction = np.array(event.ray_direction, dtype=np.float64)
        direction /= np.linalg.norm(direction)
        self._pick_along(Ray(np.array(event.ray_origin, dtype=np.float64), direction))

    def _pick_along(self, ray: Ray) -> None:
        records = self._first.records_at(self.shown_frame) if len(self._first) else ()
        self._pointer.pick(ray, self._first, self._shot, records)

    def _pick_in_image(self, message: dict[str, Any]) -> None:
        place = [number_of({"index": message.get(axis)}) for axis in "xy"]
        if None in place or not len(self._first):
            return
        at = np.array(place, dtype=np.float64)
        if self._shot is not None:
            self._pick_along(Ray(np.zeros(3), ray_through(self._shot, at)))
            return
        self._pointer.pick_in_image(at, self._first, self.shown_frame)

    # Drawing.

    @property
    def _runs(self) -> tuple[LoadedRun, ...]:
        return self._snapshot.runs

    @property
    def _first(self) -> LoadedRun:
        return self._snapshot.runs[0]

    def _shot_of(self, frame: int) -> Shot | None:
        return shot_of(self._first, frame, self._controls.options.max_points)

    def _playing_from(self, frame: int) -> Playback:
        time_s = float(self._first.run.time_s[frame])
        return Playback(time.monotonic(), time_s, self._controls.speed)

    def _run(self) -> None:
        """Draw what is wanted, at most so often, and only when the browser took the last."""
        while True:
            with self._wake:
                if not self._has_work():
                    self._wake.wait(_IDLE_S)
                if self._is_closed:
                    self._flow.close()
                    return
            started = time.monotonic()
            self._turn(started)
            left_s = 1.0 / _MAX_DRAWN_HZ - (time.monotonic() - started)
            time.sleep(max(left_s, 0.002))

    def _has_work(self) -> bool:
        return (
            self._is_closed
            or self._redraw
            or self._redraw_plots
            or self._playback is not None
            or self._wanted != self._drawn
            or self._details_frame != self._drawn
        )

    def _turn(self, now_s: float) -> None:
        """Draw if there is anything to draw."""
        news = self._take_news()
        times, ended = self._first.run.time_s, False
        with self._wake:
            playback = self._playback
            if playback is not None:
                due = playback.frame_at(now_s, times)
                self._wanted = frame_to_show(due, self._drawn, self._prepared)
                ended = playback.has_ended(now_s, times) and not self._snapshot.is_live
            if ended:
                self._playback, self._wanted = None, len(times) - 1
            redraw, self._redraw = self._redraw, False
            redraw_plots, self._redraw_plots = self._redraw_plots, False
        if ended:
            self._controls.show_playing(False)
        if playback is None and self._is_settled and self._addressed.is_due(now_s):
            self._page.send("address", self._address())
            self._keep_names_apart()
        moves = (redraw or self._wanted != self._drawn) and len(times) > 0
        frame = min(self._wanted, len(times) - 1) if moves else self._drawn
        lacks_details = self._details_frame != frame and playback is None and frame >= 0
        if not (news or moves or lacks_details or redraw_plots):
            return
        # Read and compared while the browser is busy with the frame before.
        shot = self._shot_of(frame) if moves or lacks_details else None
        self._flow.wait(lambda: self._is_closed, plays=playback is not None)
        came_from = self._drawn
        with drawing(self._client):
            if news:
                self._go_on(now_s)
            if redraw_plots:
                self._page.send("plots", self._side.plots(self._runs))
            if moves:
                self._draw(now_s, frame, shot)
            elif lacks_details:
                self._draw_details(frame, shot)
        self._flow.sent()
        if moves and frame != came_from:
            self._prepare(frame, came_from, plays=playback is not None)

    def _prepare(self, frame: int, came_from: int, *, plays: bool) -> None:
        """Have the frame read that will be shown next, if all goes on as it does."""
        step = frame - came_from
        if not plays or step < 0:
            step = 1 if step > 0 else -1
        self._prepared = frame + step
        # When the program ends, its threads take no more work while this one still runs.
        with suppress(RuntimeError):
            read_ahead(self._first, self._prepared, self._controls.options.max_points)

    def _take_news(self) -> bool:
        """Look at the source's newest snapshot from now on; whether it is a new one."""
        snapshot = self._source()
        if snapshot.number == self._snapshot.number:
            return False
        if self._snapshot.is_live and not snapshot.is_live:
            self.redraw()
        self._snapshot = snapshot
        with self._wake:
            if self._controls.follows_newest:
                self._wanted = max(len(self._first) - 1, 0)
        return True

    def _go_on(self, now_s: float) -> None:
        """Lengthen what is drawn of the whole run."""
        self._controls.refresh(self._snapshot)
        self._layers.go_on(self._runs)
        if self._plots_paced.is_due(now_s) or not self._snapshot.is_live:
            self._layers.refresh_trails()
            self._events = all_events(self._runs)
            self._visited = None
            self._page.send("timeline", time_line(self._runs, self._events))
            self._page.send("plots", self._side.plots(self._runs))
            self._side.show_known(self._runs)

    def _draw(self, now_s: float, frame: int, shot: Shot | None) -> None:
        self._layers.show(frame, shot, self._controls.options)
        self._layers.keep_names_apart(self._viewfinder.pixels)
        if not self._is_placed and self._first.run.has_estimate[frame]:
            self._look_at_first()
        self._viewfinder.follow(self._first, frame)
        at_rest = self._playback is None
        # Laying out a page anew costs a browser more than drawing the scene.
        if self._texts.is_due(now_s) or at_rest:
            self._page.send("now", status_of_frame(self._runs, frame))
        if frame != self._drawn:
            self._pointer.clear()
        self._drawn, self._shot = frame, shot
        if at_rest or self._picture.is_due(now_s):
            self._draw_details(frame, shot)

    def _draw_details(self, frame: int, shot: Shot | None) -> None:
        loaded, options = self._first, self._controls.options
        known = loaded.pose(frame) is not None
        self._controls.show_legend(legend_html(loaded, options, shot, has_estimate=known))
        self._side.show(self._runs, frame, shot, options)
        self._page.send("now", status_of_frame(self._runs, frame))
        self._details_frame = frame

    @property
    def _is_settled(self) -> bool:
        """Whether the page shows what was asked for; before, its address is not overwritten."""
        return self._page.is_opened and self._drawn >= 0 and self._drawn == self._wanted

    def _address(self) -> str:
        options = self._controls.options
        state = PageState(
            frame=self._drawn,
            camera=self._viewfinder.state,
            layers=options.layers,
            colour_by=options.colour_by,
            max_points=options.max_points,
            plots=self._side.chosen,
            dark=self._controls.is_dark,
        )
        if self._snapshot.is_live and self._controls.follows_newest:
            state = replace(state, frame=None)
        return state.address()

    def _keep_names_apart(self) -> None:
        """Which names lie over others changes as the user turns the scene."""
        state = self._viewfinder.state
        if state != self._named_from:
            self._named_from = state
            with drawing(self._client):
                self._layers.keep_names_apart(self._viewfinder.pixels)

    def _look_at_first(self) -> None:
        """What a page opens with. A target without a model may go far: it is followed."""
        first = self._first
        self._is_placed = bool(first.run.has_estimate.any())
        shot = self._shot_of(min(self._wanted, len(first) - 1)) if len(first) else None
        viewpoint = Viewpoint.ORBIT if first.target is not None else Viewpoint.FOLLOW
        self._viewfinder.look_from(viewpoint, first, self._wanted, shot)


def _start_frame(snapshot: Snapshot, asked: int | Opening) -> int:
    first = snapshot.runs[0]
    last = max(len(first) - 1, 0)
    if snapshot.is_live:
        return last
    return opening_frame(first, asked) if isinstance(asked, Opening) else min(asked, last)
