"""The web view at the browser: first picture, frames a second beside bare viser, latency, memory.

The first picture is there when a screenshot has it. Frames are counted in the page, each time
another cloud is handed to the graphics driver. Without a graphics card the processor draws, and
shares its cores with the server. The peer is a script of viser alone that shows the same clouds,
computed before, from the same place: in a window of the same size, and in one of no more than the
view leaves its scene.
"""

import io
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from PIL import Image
from rich.table import Table

from benchmarks.scenes import record, shortened
from benchmarks.viewer_page import (
    browsing,
    counted,
    counted_page,
    play_again_and_again,
    step_latencies,
)
from pcnav.config.pipeline_file import Pipeline
from pcnav.core.arrays import FloatArray
from pcnav.pipeline import run
from pcnav.viewer.browser import find_browser
from pcnav.viewer.camera import fitted_view
from pcnav.viewer.frames import ColourBy
from pcnav.viewer.layers import shot_of
from pcnav.viewer.loading import load_run
from pcnav.viewer.render_options import CAMERA_FOV_RAD

if TYPE_CHECKING:
    from playwright.sync_api import Browser, FloatRect, Page, ViewportSize

_SECONDS, _WARM_UP_S = 10.0, 3.0
_STEPS = 8
_HZ = 20.0
"""Of recording and playback."""
_SIZE: "ViewportSize" = {"width": 1280, "height": 800}
_MIDDLE: "FloatRect" = {"x": 490, "y": 300, "width": 200, "height": 200}
"""Of the scene between the panels."""
_SHARE_DRAWN = 0.05
_SCENE_SIZE = """(() => {
  const box = document.querySelector("canvas[data-engine]").getBoundingClientRect();
  return {width: Math.round(box.width), height: Math.round(box.height)};
})()"""
_MAX_MB = 600.0
_ALL = 10**9
_PIXELS_ACROSS = 1.4
"""Of a point, over the distance of neighbouring pixels, as in the view."""


@dataclass(frozen=True)
class Recording:
    """A simulated run to be looked at, and what is wanted of the view of it."""

    image_px: int
    """Width and height, for the number of points wanted."""
    frames: int
    bare_hz: float
    """That the bare script shows: more than is drawn of so many points, and not so many more that
    its page has no time left to draw."""
    min_ratio: float
    """Of the view's frames a second over those of bare viser."""


RECORDINGS = (
    Recording(484, 300, 20.0, 0.7),
    Recording(1090, 150, 10.0, 0.6),
    Recording(1890, 60, 5.0, 0.5),
)
"""For some 20,000, 100,000 and 300,000 points."""


@dataclass(frozen=True)
class Seen:
    """What a browser saw of one recording."""

    recording: Recording
    first_picture_s: float
    """From the command to the first screenshot of the page with the cloud in it."""
    points: float
    """Of the median cloud."""
    played_per_s: float
    bare_per_s: float
    """The same clouds by viser alone."""
    small_bare_per_s: float
    """The same in a window of the size of the view's scene."""
    undrawn_per_s: float
    """By a page that does all but draw: what server, network and page leave room for."""
    latencies_s: FloatArray
    """(n,) from a key to the picture of the next frame."""
    peak_mb: float
    """Resident memory of the server at its peak; nan where the system does not tell."""

    @property
    def ratio(self) -> float:
        """Over bare viser."""
        return self.played_per_s / self.bare_per_s


def measure_viewer(folder: Path) -> tuple[Seen, ...]:
    """Simulate, run, look; nothing without a browser."""
    program = find_browser()
    if program is None:
        return ()
    with browsing(program) as browser:
        return tuple(_seen(browser, each, folder / str(each.image_px)) for each in RECORDINGS)


def viewer_table(seen: tuple[Seen, ...]) -> Table:
    """What was measured, beside what is wanted."""
    table = Table(title="web view at the browser, headless Chromium without a graphics card")
    table.add_column("quantity")
    for each in seen:
        px = each.recording.image_px
        table.add_column(f"{px} x {px} px, {each.points:.0f} points", justify="right")
    if not seen:
        table.add_row("no Chromium or Chrome on the PATH")
        return table
    rows = {
        "first picture after the command, s (< 3)": [f"{s.first_picture_s:.1f}" for s in seen],
        "playback, frames/s": [f"{s.played_per_s:.1f}" for s in seen],
        "bare viser, same window, frames/s": [f"{s.bare_per_s:.1f}" for s in seen],
        "ratio (wanted)": [f"{s.ratio:.2f} (>= {s.recording.min_ratio:g})" for s in seen],
        "bare viser, window of the scene, frames/s": [f"{s.small_bare_per_s:.1f}" for s in seen],
        "view whose page draws nothing, frames/s": [f"{s.undrawn_per_s:.1f}" for s in seen],
        "key to new picture, median, ms": [f"{1e3 * np.median(s.latencies_s):.0f}" for s in seen],
        "key to new picture, longest, ms": [f"{1e3 * np.max(s.latencies_s):.0f}" for s in seen],
        f"server memory, peak, MB (< {_MAX_MB:g})": [f"{s.peak_mb:.0f}" for s in seen],
    }
    for name, cells in rows.items():
        table.add_row(name, *cells)
    return table


def _seen(browser: "Browser", recording: Recording, folder: Path) -> Seen:
    result, clouds = made(recording, folder), folder / "clouds.npz"
    _write_clouds(result, clouds)
    started = time.monotonic()
    with _served(result) as (url, process):
        page = counted_page(browser, _SIZE)
        page.goto(f"{url}?returns={_ALL}")
        page.get_by_role("button", name="Play").wait_for()
        while _share_drawn(page) < _SHARE_DRAWN:
            pass
        first_s = time.monotonic() - started
        scene: ViewportSize = page.evaluate(_SCENE_SIZE)
        page.keyboard.press("Home")
        page.wait_for_timeout(3000)
        latencies = step_latencies(page, _STEPS)
        play_again_and_again(page)
        played = counted(page, _WARM_UP_S, _SECONDS)
        page.close()
        page = counted_page(browser, _SIZE, draws=False)
        page.goto(f"{url}?returns={_ALL}")
        play_again_and_again(page)
        undrawn = counted(page, _WARM_UP_S, _SECONDS)
        page.close()
        peak_mb = _peak_mb(process.pid)
    bare, small = (_bare(browser, size, clouds, recording.bare_hz) for size in (_SIZE, scene))
    found = (first_s, played.points, played.per_s, bare, small, undrawn.per_s, latencies, peak_mb)
    return Seen(recording, *found)


def _bare(browser: "Browser", size: "ViewportSize", clouds: Path, hz: float) -> float:
    """Frames a second of a bare viser script."""
    command = [sys.executable, "-m", "benchmarks.viewer_bare", str(clouds), str(hz)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            port = next(line.split()[1] for line in process.stdout if line.startswith("port: "))
            page = counted_page(browser, size)
            page.goto(f"http://127.0.0.1:{port}")
            bare = counted(page, _WARM_UP_S, _SECONDS)
            page.close()
            return bare.per_s
        finally:
            process.terminate()


@contextmanager
def _served(result: Path) -> Iterator[tuple[str, "subprocess.Popen[str]"]]:
    """A view of a result in a process of its own: its address, and the process."""
    command = [sys.executable, "-c", "from pcnav.cli import main; main()"]
    served = subprocess.Popen(
        [*command, "view", str(result), "--port", "0"],
        stdout=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONUNBUFFERED": "1"},
    )
    try:
        assert served.stdout is not None
        yield next(line.split()[1] for line in served.stdout if line.startswith("view: ")), served
    finally:
        served.terminate()
        served.wait()


def _peak_mb(pid: int) -> float:
    """Resident memory of a process at its peak, MB; nan where the system does not tell."""
    status = Path(f"/proc/{pid}/status")
    if not status.is_file():
        return float("nan")
    told = dict(line.split(":", 1) for line in status.read_text().splitlines())
    return float(told["VmHWM"].split()[0]) * 1024e-6


def _share_drawn(page: "Page") -> float:
    """How much of the scene's middle is not background."""
    image = Image.open(io.BytesIO(page.screenshot(clip=_MIDDLE))).convert("L")
    pixels = np.asarray(image).astype(int)
    return float((np.abs(pixels - np.median(pixels[0])) > 30).mean())


def _write_clouds(result: Path, path: Path) -> None:
    """What the view shows of a run, every return, as `benchmarks.viewer_bare` reads it."""
    loaded = load_run(result)
    at = loaded.opening_frame
    shots = [shot_of(loaded, frame, _ALL) for frame in range(len(loaded))]
    known = [shot for shot in shots if shot is not None]
    place, centre = fitted_view(loaded, at, shots[at])
    colours = [
        np.broadcast_to(shot.colours(ColourBy.PLANE, 1.0), shot.points.shape) for shot in known
    ]
    camera = known[0].frame.camera
    np.savez(
        path,
        points=np.concatenate([shot.points for shot in known]),
        colours=np.concatenate(colours),
        ends=np.cumsum([len(shot.points) for shot in known]),
        point_size=_PIXELS_ACROSS * np.linalg.norm(loaded.centre(at)) / camera.fx,
        camera=np.array([*place, *centre, CAMERA_FOV_RAD]),
    )


def made(recording: Recording, folder: Path) -> Path:
    """A run on frames of so many pixels: boxsat near."""
    pipeline = shortened("boxsat", recording.frames)
    size = {"width_px": recording.image_px, "height_px": recording.image_px}
    camera = pipeline.camera.model_copy(update=size)
    scenario = pipeline.scenario.model_copy(update={"frame_rate_hz": _HZ})
    pipeline = pipeline.model_copy(update={"camera": camera, "scenario": scenario})
    sequence = record("boxsat", pipeline, folder / "sequence").path
    run(sequence, folder / "result", Pipeline())
    return folder / "result"
