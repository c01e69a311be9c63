"""The web view at the browser: time to the first picture, frames a second of playback.

The first picture is there when a screenshot has it. Frames are counted in the page, each time
another cloud is handed to the graphics driver. Without a graphics card the processor draws, and
shares its cores with the server. Two more figures tell what that costs: the same playback by a page
that does all but draw, and the same cloud alone.
"""

import io
import os
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from PIL import Image
from rich.table import Table

from benchmarks.scenes import record, shortened
from pcnav.config.pipeline_file import Pipeline
from pcnav.pipeline import run
from pcnav.viewer.browser import find_browser

if TYPE_CHECKING:
    from playwright.sync_api import FloatRect, Page, ViewportSize

_FRAMES = 300
_IMAGE_PX = 484
"""For some 20,000 points."""
_SECONDS = 8.0
_SIZE: "ViewportSize" = {"width": 1280, "height": 800}
_MIDDLE: "FloatRect" = {"x": 490, "y": 300, "width": 200, "height": 200}
"""Of the scene between the panels."""
_SHARE_DRAWN = 0.05
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
"""
_DRAW_NOTHING = """
for (const name of ["drawArrays", "drawElements", "drawArraysInstanced", "drawElementsInstanced"])
  WebGL2RenderingContext.prototype[name] = function () {};
"""


@dataclass(frozen=True)
class Seen:
    """What a browser saw."""

    first_picture_s: float
    """From the command to the first screenshot of the page with the cloud in it."""
    points: float
    """Of the median cloud."""
    played_per_s: float
    """Frames a second, played at 20."""
    undrawn_per_s: float
    """The same with a page that does all but draw: what server, network and page leave room for."""
    alone_per_s: float
    """Pictures a second of an empty scene with one such cloud that moves: what drawing allows."""


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
            page = browser.new_page(viewport=_SIZE)
            launch_s = time.monotonic() - ready
            page.add_init_script(_COUNT_CLOUDS)
            page.goto(url)
            page.get_by_role("button", name="Play").wait_for()
            while _share_drawn(page) < _SHARE_DRAWN:
                pass
            first_s = time.monotonic() - started - launch_s
            played, points = _played(page)
            page.close()
            page = browser.new_page(viewport=_SIZE)
            page.add_init_script(_COUNT_CLOUDS + _DRAW_NOTHING)
            page.goto(url)
            undrawn, _ = _played(page)
            page.close()
            alone = _cloud_alone(browser.new_page(viewport=_SIZE), int(points))
            browser.close()
    finally:
        served.terminate()
        served.wait()
    return Seen(first_s, points, played, undrawn, alone)


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
    table.add_row("playback, frames/s", f"{seen.played_per_s:.1f}", "20")
    table.add_row("- by a page that draws nothing", f"{seen.undrawn_per_s:.1f}", "20")
    table.add_row("one such cloud alone, pictures/s", f"{seen.alone_per_s:.1f}", "")
    return table


def _share_drawn(page: "Page") -> float:
    """How much of the scene's middle is not background."""
    image = Image.open(io.BytesIO(page.screenshot(clip=_MIDDLE))).convert("L")
    pixels = np.asarray(image).astype(int)
    return float((np.abs(pixels - np.median(pixels[0])) > 30).mean())


def _played(page: "Page") -> tuple[float, float]:
    """Clouds a second while a run is played, and the points of the median one."""
    page.wait_for_function("window.__clouds.length > 0")
    page.get_by_role("button", name="Play").click()
    page.wait_for_timeout(2000)
    before = page.evaluate("[window.__clouds.length, performance.now()]")
    page.wait_for_timeout(1000.0 * _SECONDS)
    after = page.evaluate("[window.__clouds.length, performance.now()]")
    points = page.evaluate("window.__clouds.map((cloud) => cloud[1])")
    return 1000.0 * (after[0] - before[0]) / (after[1] - before[1]), float(np.median(points))


def _cloud_alone(page: "Page", points: int) -> float:
    """Pictures a second of a scene that holds nothing but a cloud, which moves all the time."""
    from pcnav.viewer.server import UP, LocalServer, has_shown_all

    server = LocalServer("127.0.0.1", 0, "cloud")
    camera = server.initial_camera
    camera.position, camera.look_at, camera.up = (0.0, 0.0, 0.0), (0.0, 0.0, 20.0), UP
    places = np.random.default_rng(0).uniform((-4.0, -4.0, 20.0), (4.0, 4.0, 20.1), (points, 3))
    cloud = server.scene.add_point_cloud(
        "/cloud",
        places.astype(np.float32),
        (90, 170, 255),
        point_size=0.03,
        point_shape="circle",
        precision="float32",
    )
    try:
        page.goto(f"http://127.0.0.1:{server.get_port()}")
        page.wait_for_timeout(3000)
        client = next(iter(server.get_clients().values()))
        count, start = 0, time.monotonic()
        while time.monotonic() - start < 0.5 * _SECONDS:
            cloud.position = (0.001 * (count % 10), 0.0, 0.0)
            has_shown_all(client, 2.0)
            count += 1
        return count / (time.monotonic() - start)
    finally:
        server.stop()


def _made(folder: Path) -> Path:
    """A result on frames of some 20,000 points: boxsat near, in a camera of more pixels."""
    pipeline = shortened("boxsat", _FRAMES)
    size = {"width_px": _IMAGE_PX, "height_px": _IMAGE_PX}
    camera = pipeline.camera.model_copy(update=size)
    pipeline = pipeline.model_copy(update={"camera": camera})
    sequence = record("boxsat", pipeline, folder / "viewer").path
    run(sequence, folder / "viewer-result", Pipeline())
    return folder / "viewer-result"
