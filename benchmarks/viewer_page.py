"""What a page in a browser shows, counted in the page itself."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from pcnav.core.arrays import FloatArray

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page, ViewportSize

_ARGUMENTS = (
    *("--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"),
    *("--disable-background-networking", "--no-first-run", "--disable-quic"),
    *("--disable-component-update", "--disable-sync", "--disable-gpu-compositing"),
)
_COUNT_CLOUDS = """
window.__clouds = [];
window.__pictures = [];
for (const name of ["bufferData", "bufferSubData"]) {
  const original = WebGL2RenderingContext.prototype[name];
  WebGL2RenderingContext.prototype[name] = function (...given) {
    const data = given.find((one) => one && one.byteLength !== undefined);
    // Three numbers of 16 or 32 bits a point; colours are bytes.
    if (data && data.BYTES_PER_ELEMENT !== 1 && data.byteLength > 30000) {
      window.__clouds.push([performance.now(), data.length / 3]);
      requestAnimationFrame((now) => window.__pictures.push(performance.now()));
    }
    return original.apply(this, given);
  };
}
"""
_DRAW_NOTHING = """
for (const name of ["drawArrays", "drawElements", "drawArraysInstanced", "drawElementsInstanced"])
  WebGL2RenderingContext.prototype[name] = function () {};
"""
_REPLAY = """
setInterval(() => {
  for (const each of document.querySelectorAll("button"))
    if (each.textContent === "Play") each.click();
}, 30);
"""
"""A run that was played to its end is played again."""


@dataclass(frozen=True)
class Played:
    """What was counted while frames went by."""

    per_s: float
    """Clouds handed to the graphics driver, each drawn in the next picture."""
    points: float
    """Of the median cloud."""


@contextmanager
def browsing(program: str) -> "Iterator[Browser]":
    """A browser without a window, and without a graphics card."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=program, args=list(_ARGUMENTS))
        try:
            yield browser
        finally:
            browser.close()


def counted_page(browser: "Browser", size: "ViewportSize", *, draws: bool = True) -> "Page":
    """A page that counts clouds, and may leave out drawing them."""
    page = browser.new_page(viewport=size)
    page.add_init_script(_COUNT_CLOUDS + ("" if draws else _DRAW_NOTHING))
    return page


def play_again_and_again(page: "Page") -> None:
    """Play the run of a view, and again whenever it has ended."""
    page.get_by_role("button", name="Play").wait_for()
    page.wait_for_function("window.__clouds.length > 0")
    page.evaluate(_REPLAY)


def counted(page: "Page", warm_up_s: float, seconds: float) -> Played:
    """Clouds a second of a page that shows one after the other."""
    page.wait_for_function("window.__clouds.length > 0", timeout=120_000)
    page.wait_for_timeout(1000.0 * warm_up_s)
    before = page.evaluate("[window.__clouds.length, performance.now()]")
    page.wait_for_timeout(1000.0 * seconds)
    after = page.evaluate("[window.__clouds.length, performance.now()]")
    points = page.evaluate("window.__clouds.map((cloud) => cloud[1])")
    return Played(
        1000.0 * (after[0] - before[0]) / (after[1] - before[1]), float(np.median(points))
    )


def step_latencies(page: "Page", steps: int) -> FloatArray:
    """(steps,) from a key that is pressed to the picture of the next frame, s."""
    found = []
    for _ in range(steps):
        seen = page.evaluate("window.__pictures.length")
        page.evaluate(
            "addEventListener('keydown', () => window.__pressed = performance.now(),"
            " {capture: true, once: true})"
        )
        page.keyboard.press("ArrowRight")
        page.wait_for_function(f"window.__pictures.length > {seen}", timeout=60_000)
        found.append(page.evaluate(f"window.__pictures[{seen}] - window.__pressed"))
        # Until image, plots and texts of the frame are there, too.
        page.wait_for_timeout(500)
    return 1e-3 * np.array(found)
