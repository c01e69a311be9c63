"""The web view at the browser: time to the first picture, frames a second of playback.

Counted where they are seen: in the page, each time another cloud is handed to the graphics driver.
A page with nothing but an empty scene is measured beside it, as fast as it can draw: without a
graphics card that alone is slow, and no view on it can be faster.
"""

import os
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from rich.table import Table

from benchmarks.scenes import record, shortened
from pcnav.config import Pipeline
from pcnav.pipeline import run
from pcnav.viewer.browser import find_browser

if TYPE_CHECKING:
    from playwright.sync_api import Page

_FRAMES = 300
_IMAGE_PX = 512
_SECONDS = 8.0
_ARGUMENTS = (
    *("--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"),
    *("--disable-background-networking", "--no-first-run", "--disable-quic"),
    *("--disable-component-update", "--disable-sync", "--disable-gpu-compositing"),
)
_COUNT_CLOUDS = """
window.__clouds = [];
for (const name of ["bufferData", "bufferSubData"]) {
  const original = WebGL2RenderingContext.prototype[name];
  WebGL2RenderingContext.prototype[name] = function (...given) {
    const data = given.find((one) => one && one.byteLength !== undefined);
    if (data && data.BYTES_PER_ELEMENT === 4 && data.byteLength > 60000)
      window.__clouds.push([performance.now(), data.byteLength / 12]);
    return original.apply(this, given);
  };
}
window.__drawn = 0;
(function count() { window.__drawn += 1; requestAnimationFrame(count); })();
"""


@dataclass(frozen=True)
class Seen:
    """What a browser saw."""

    first_picture_s: float
    """From the command to the first cloud on the page."""
    clouds_per_s: float
    points: float
    """Of the median cloud."""
    empty_per_s: float
    """Pictures a second of the page while it draws an empty scene as fast as it can."""


def measure_viewer(folder: Path) -> Seen | None:
    """Simulate, run, look; None without a browser."""
    program = find_browser()
    if program is None:
        return None
    from playwright.sync_api import sync_playwright

    result = _made(folder)
    started = time.monotonic()
    command = [sys.executable, "-c", "from pcnav.cli import main; main()"]
    served = subprocess.Popen(
        [*command, "view", str(result), "--port", "0"],
        stdout=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONUNBUFFERED": "1"},
    )
    try:
        assert served.stdout is not None
        url = next(line.split()[1] for line in served.stdout if line.startswith("view: "))
        with sync_playwright() as playwright:
            # A user's browser is running already: its start is not counted.
            ready = time.monotonic()
            browser = playwright.chromium.launch(executable_path=program, args=list(_ARGUMENTS))
            page = browser.new_page(viewport={"width": 1280, "height": 800})
            launch_s = time.monotonic() - ready
            page.add_init_script(_COUNT_CLOUDS)
            page.goto(url)
            page.wait_for_function("window.__clouds.length > 0")
            first_s = time.monotonic() - started - launch_s
            page.get_by_role("button", name="Play").click()
            page.wait_for_timeout(2000)
            before = page.evaluate("[window.__clouds.length, performance.now()]")
            page.wait_for_timeout(1000.0 * _SECONDS)
            after = page.evaluate("[window.__clouds.length, performance.now()]")
            points = page.evaluate("window.__clouds.map((cloud) => cloud[1])")
            empty_per_s = _empty_scene(page)
            browser.close()
    finally:
        served.terminate()
        served.wait()
    clouds_per_s = 1000.0 * (after[0] - before[0]) / (after[1] - before[1])
    return Seen(first_s, clouds_per_s, float(np.median(points)), empty_per_s)


def viewer_table(seen: Seen | None) -> Table:
    """What was measured, beside what is wanted."""
    table = Table(title="web view at the browser, headless Chromium without a graphics card")
    for heading in ("quantity", "measured", "wanted"):
        table.add_column(heading)
    if seen is None:
        table.add_row("everything", "no Chromium or Chrome on the PATH", "")
        return table
    table.add_row("first picture after the command, s", f"{seen.first_picture_s:.1f}", "< 3")
    table.add_row("points a frame", f"{seen.points:.0f}", "20000")
    table.add_row("playback, frames/s", f"{seen.clouds_per_s:.1f}", "20")
    table.add_row("an empty scene of viser, pictures/s", f"{seen.empty_per_s:.1f}", "")
    return table


def _empty_scene(page: "Page") -> float:
    """Pictures a second while one number of an empty scene changes all the time."""
    from pcnav.viewer.layers import set_up_scene
    from pcnav.viewer.server import LocalServer

    server = LocalServer("127.0.0.1", 0, "empty")
    set_up_scene(server.scene)
    node = server.scene.add_frame("/moved", show_axes=False)
    try:
        page.goto(f"http://127.0.0.1:{server.get_port()}")
        page.wait_for_timeout(3000)
        before = page.evaluate("[window.__drawn, performance.now()]")
        end = time.monotonic() + 0.5 * _SECONDS
        while time.monotonic() < end:
            node.position = (time.monotonic() % 1.0, 0.0, 0.0)
            page.wait_for_timeout(15)
        after = page.evaluate("[window.__drawn, performance.now()]")
    finally:
        server.stop()
    return float(1000.0 * (after[0] - before[0]) / (after[1] - before[1]))


def _made(folder: Path) -> Path:
    """A result on frames of some 20,000 points: boxsat near, in a camera of more pixels."""
    pipeline = shortened("boxsat", _FRAMES)
    size = {"width_px": _IMAGE_PX, "height_px": _IMAGE_PX}
    camera = pipeline.camera.model_copy(update=size)
    pipeline = pipeline.model_copy(update={"camera": camera})
    sequence = record("boxsat", pipeline, folder / "viewer").path
    run(sequence, folder / "viewer-result", Pipeline())
    return folder / "viewer-result"
