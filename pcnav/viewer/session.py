"""One browser: its own time, layers and plots, drawn by a thread of its own."""

import threading
import time
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field

import numpy as np
import viser

from pcnav.core.arrays import FloatArray
from pcnav.viewer.clock import Playback
from pcnav.viewer.controls import Controls, Viewpoint
from pcnav.viewer.events import Kind, neighbour
from pcnav.viewer.export import Share, exported, file_name
from pcnav.viewer.frames import Shot
from pcnav.viewer.layers import RunLayers, shot_of, vertical_fov
from pcnav.viewer.loaded_run import LoadedRun, Snapshot, Source
from pcnav.viewer.palette import RUNS
from pcnav.viewer.panels import facts_html, frame_picture, legend_html, measurements_html
from pcnav.viewer.plots import PlotsPanel
from pcnav.viewer.render_options import CAMERA_FOV_RAD, vector
from pcnav.viewer.server import UP, drawing, has_shown_all

_MAX_DRAWN_HZ = 30.0
_CURSOR_HZ = 5.0
_TEXTS_HZ = 8.0
_PICTURE_HZ = 2.0
_PLOTS_LIVE_S = 2.0
_IDLE_S = 0.1
_PATIENCE_S = 2.0
_PANEL_PX = 400


@dataclass
class _Paced:
    """Something that is done at most so often."""

    period_s: float
    last_s: float = field(default=-np.inf)

    def is_due(self, now_s: float) -> bool:
        """Whether it is time; if so it counts as done."""
        if now_s - self.last_s < self.period_s:
            return False
        self.last_s = now_s
        return True


class Session:
    """What one browser sees."""

    def __init__(self, client: viser.ClientHandle, source: Source, first_frame: int | None) -> None:
        self._client, self._source = client, source
        self._snapshot = source()
        self._wanted, self._drawn = _start_frame(self._snapshot, first_frame), -1
        self._is_closed = False
        self._wake = threading.Condition()
        self._playback: Playback | None = None
        self._redraw = self._redraw_plots = False
        self._cursor, self._picture = _Paced(1.0 / _CURSOR_HZ), _Paced(1.0 / _PICTURE_HZ)
        self._texts = _Paced(1.0 / _TEXTS_HZ)
        self._plots_paced = _Paced(_PLOTS_LIVE_S)
        self._details_frame = -1
        self._followed: FloatArray | None = None
        """The target's place that the camera was last carried along to."""
        with drawing(client):
            self._layers = RunLayers(client.scene, self._runs, RUNS)
            self._controls = Controls(client.gui, self._snapshot, self)
            self._build_panel()
            self._look_at_first()
            if len(self._first):
                frame = min(self._wanted, len(self._first) - 1)
                self._draw(time.monotonic(), frame, shot_of(self._first, frame))
        self._questions = ThreadPoolExecutor(1, "pcnav questions")
        self._page = self._asked_page()
        """Whether the browser has worked off what was drawn for it."""
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
        self.play(False)
        self._controls.stop_following_newest()
        self.go_to(self._wanted + frames)

    def jump(self, direction: int, kind: Kind | None) -> None:
        """Go to the next event (1) or the one before (-1)."""
        found = neighbour(self._first.events, self._wanted, direction, kind)
        if found is None:
            self._controls.tell("no such event there")
            return
        self.play(False)
        self._controls.stop_following_newest()
        self.go_to(found.frame)
        self._controls.tell(f"{found.kind} at frame {found.frame}: {found.text}")

    def play(self, wanted: bool) -> None:
        """Start or stop."""
        with self._wake:
            at_end = self._wanted >= len(self._first) - 1
            start = 0 if at_end else self._wanted
            self._playback = self._playing_from(start) if wanted else None
            self._wake.notify()
        self._controls.show_playing(wanted)

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

    @property
    def shown_frame(self) -> int:
        """The frame on the screen."""
        return max(self._drawn, 0)

    def close(self) -> None:
        """The browser has gone."""
        with self._wake:
            self._is_closed = True
            self._wake.notify()

    # Drawing.

    @property
    def _runs(self) -> tuple[LoadedRun, ...]:
        return self._snapshot.runs

    @property
    def _wanted_s(self) -> float:
        times = self._first.run.time_s
        return float(times[min(self._wanted, len(times) - 1)]) if len(times) else 0.0

    @property
    def _first(self) -> LoadedRun:
        return self._snapshot.runs[0]

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
                    self._questions.shutdown(wait=False)
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
                self._wanted = playback.frame_at(now_s, times)
                ended = playback.has_ended(now_s, times) and not self._snapshot.is_live
            if ended:
                self._playback = None
            redraw, self._redraw = self._redraw, False
            redraw_plots, self._redraw_plots = self._redraw_plots, False
        if ended:
            self._controls.show_playing(False)
        moves = (redraw or self._wanted != self._drawn) and len(times) > 0
        frame = min(self._wanted, len(times) - 1) if moves else self._drawn
        lacks_details = self._details_frame != frame and playback is None and frame >= 0
        if not (news or moves or lacks_details or redraw_plots):
            return
        # Read and compared while the browser is busy with the frame before.
        shot = shot_of(self._first, frame) if moves or lacks_details else None
        self._wait_for_page()
        with drawing(self._client):
            if news:
                self._go_on(now_s)
            if redraw_plots:
                self._plots.draw_choice()
            if moves:
                self._draw(now_s, frame, shot)
            elif lacks_details:
                self._draw_details(frame, shot)
        self._page = self._asked_page()

    def _asked_page(self) -> Future[bool]:
        return self._questions.submit(has_shown_all, self._client, _PATIENCE_S)

    def _wait_for_page(self) -> None:
        """Until the browser has worked off what was drawn: the next frame is then the newest.

        A slow browser holds up its own thread alone. Nor could it take a plot off that it is yet
        to change: of messages that come together it carries out the changes last.
        """
        while not self._is_closed and not self._page.result():
            self._page = self._asked_page()

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
            self._plots.go_on(self._runs, self._wanted_s)

    def _draw(self, now_s: float, frame: int, shot: Shot | None) -> None:
        options = self._controls.options
        self._layers.show(frame, shot, options)
        self._follow(frame)
        at_rest = self._playback is None
        # Laying out a page anew costs a browser more than drawing the scene.
        if self._texts.is_due(now_s) or at_rest:
            self._controls.show_frame(frame)
            self._facts.content = facts_html(self._first, frame, options.magnified)
        if self._cursor.is_due(now_s) or at_rest:
            self._plots.move_cursor(float(self._first.run.time_s[frame]))
        self._drawn = frame
        if at_rest or self._picture.is_due(now_s):
            self._draw_details(frame, shot)

    def _draw_details(self, frame: int, shot: Shot | None) -> None:
        loaded, options = self._first, self._controls.options
        records = loaded.records_at(frame)
        known = loaded.pose(frame) is not None
        self._controls.show_legend(legend_html(loaded, options.colour_by, has_estimate=known))
        if loaded.target is not None:
            self._measurements.content = measurements_html(records)
        self._image.visible = shot is not None
        if shot is not None and loaded.frames is not None:
            picture = frame_picture(shot, records, options.colour_by, loaded.frames.scale_m)
            self._image.image = picture
        self._plots.move_cursor(float(loaded.run.time_s[frame]))
        self._details_frame = frame

    def _build_panel(self) -> None:
        gui = self._client.gui
        gui.main_panel.dock_left()
        gui.main_panel.set_width(300)
        panel = gui.add_panel()
        self._plots = PlotsPanel(
            *(gui, panel.add_tab("Plots"), self._runs, self._wanted_s),
            lambda: self.redraw(plots=True),
        )
        with panel.add_tab("This frame"):
            self._facts = gui.add_html("")
            self._image = gui.add_image(
                np.zeros((8, 8, 3), dtype=np.uint8), label="depth image", format="png"
            )
            self._measurements = gui.add_html("")
        panel.dock_right()
        panel.set_width(_PANEL_PX)

    # Cameras.

    def look_from(self, viewpoint: Viewpoint) -> None:
        """Move the browser's camera."""
        loaded, handle = self._first, self._client.camera
        position, centre = loaded.viewpoint(self._wanted)
        self._followed = None
        with drawing(self._client):
            handle.up_direction = UP
            if viewpoint is Viewpoint.CHASER:
                eye = loaded.frames.camera() if loaded.frames is not None else None
                handle.position = (0.0, 0.0, 0.0)
                handle.look_at = (0.0, 0.0, max(float(centre[2]), 1.0))
                handle.fov = CAMERA_FOV_RAD if eye is None else vertical_fov(eye)
                return
            handle.fov = CAMERA_FOV_RAD
            handle.position = vector(position)
            handle.look_at = vector(centre)
        if viewpoint is Viewpoint.FOLLOW:
            self._followed = centre

    def _look_at_first(self) -> None:
        """What a page opens with. A target without a model may go far: it is followed."""
        self._is_placed = bool(self._first.run.has_estimate.any())
        self.look_from(Viewpoint.ORBIT if self._first.target is not None else Viewpoint.FOLLOW)

    def _follow(self, frame: int) -> None:
        """Carry the camera along with the target, without touching what the user turned."""
        if not self._first.run.has_estimate[frame]:
            return
        if not self._is_placed:
            self._look_at_first()
        # Another thread may look from elsewhere in the meantime.
        followed = self._followed
        if followed is None:
            return
        centre = self._first.centre(frame)
        shift = centre - followed
        if self._followed is followed:
            self._followed = centre
        if np.linalg.norm(shift) > 0.0:
            self._client.camera.position = np.asarray(self._client.camera.position) + shift


def _start_frame(snapshot: Snapshot, asked: int | None) -> int:
    first = snapshot.runs[0]
    last = max(len(first) - 1, 0)
    if snapshot.is_live:
        return last
    return first.first_frame if asked is None else min(asked, last)
