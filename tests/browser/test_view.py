"""The view in a real browser: what is on the screen, and what the controls change."""

import io
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from playwright.sync_api import Locator, Page

from pcnav.config.pipeline_file import read_pipeline
from pcnav.config.shipped import shipped_pipeline
from pcnav.pipeline import run as run_pipeline
from pcnav.simulation.simulate import simulate
from pcnav.viewer import page as bridge
from pcnav.viewer.app import serve, show
from pcnav.viewer.loaded_run import finished
from pcnav.viewer.loading import load_run
from pcnav.viewer.palette import LABELS, REJECTED_COLOUR, RUNS, hex_of
from pcnav.viewer.server import LOOPBACK, LocalServer
from tests.browser.conftest import FRAMES, PATIENCE_MS, Opened, Served

Serve = Callable[..., Served]


_BEYOND = """() => {
  const found = [];
  for (const panel of document.querySelectorAll(".mantine-ScrollArea-viewport")) {
    if (!panel.offsetParent) continue;
    const edge = panel.getBoundingClientRect();
    for (const each of panel.querySelectorAll("table, td, th, img, canvas, div, button")) {
      const box = each.getBoundingClientRect();
      const isBeyond = box.right > edge.right + 1 || box.left < edge.left - 1;
      if (each.offsetParent && box.width && isBeyond)
        found.push(each.tagName + " " + each.textContent.slice(0, 30));
    }
  }
  return found;
}"""
"""What is in a panel that is open and reaches beyond it, left or right."""


def scene(page: Page) -> np.ndarray:
    """(h, w, 3) pixels of the scene between the panels."""
    image = Image.open(io.BytesIO(page.screenshot())).convert("RGB")
    pixels = np.asarray(image).astype(int)
    # Below viser's warning of software rendering, above the time line.
    return pixels[190:-120, 290 : pixels.shape[1] - 450]


def cloud_pixels(page: Page) -> int:
    """How many pixels of the scene have the colour of a flat part."""
    pixels = scene(page)
    near = [np.abs(pixels - colour.astype(int)).max(axis=-1) < 30 for colour in LABELS]
    return int(np.any(near, axis=0).sum())


def wait_until(page: Page, holds: Callable[[], bool], what: str) -> None:
    """Look again and again until something holds."""
    deadline = time.monotonic() + 1e-3 * PATIENCE_MS
    while time.monotonic() < deadline:
        if holds():
            return
        page.wait_for_timeout(100)
    raise AssertionError(f"never came: {what}")


def ready(page: Page) -> None:
    """Wait for the cloud to be on the screen."""
    page.get_by_role("button", name="Play").wait_for()
    wait_until(page, lambda: cloud_pixels(page) > 5_000, "the cloud")


def frame_box(page: Page) -> Locator:
    """The number in the bar above the scene."""
    return page.locator("#pcnav-frame")


def go_to(page: Page, frame: int) -> None:
    box = frame_box(page)
    box.fill(str(frame))
    box.press("Enter")


def cursor_s(page: Page) -> float:
    """The time that the page shows."""
    return float(page.evaluate("pcnav.data.now.time"))


def checkbox(page: Page, name: str) -> Locator:
    """The box of a layer: the one that stands in the same row as its name."""
    row = page.get_by_text(name, exact=True).locator("xpath=ancestor::div[.//input][1]")
    return row.locator("input[type=checkbox]").first


def test_a_run_is_on_the_screen_and_follows_its_controls(
    runs: tuple[Path, Path], served: Serve, opened: Opened, report_folder: Path
) -> None:
    view = served("view", str(runs[0]), "--port", "0", "--frame", "20")
    page = opened(view.url)
    ready(page)
    page.screenshot(path=report_folder / "view-1280x800.png")
    assert frame_box(page).input_value() == "20"
    wait_until(page, lambda: cursor_s(page) == 10.0, "the cursor at frame 20")

    before = scene(page)
    go_to(page, 35)
    wait_until(page, lambda: cursor_s(page) == 17.5, "the cursor at frame 35")
    wait_until(page, lambda: bool((scene(page) != before).mean() > 0.01), "another picture")

    # Lines and names have some of the colours, too.
    with_cloud = cloud_pixels(page)
    checkbox(page, "points").click()
    wait_until(page, lambda: cloud_pixels(page) < 0.4 * with_cloud, "no cloud")
    checkbox(page, "points").click()
    wait_until(page, lambda: cloud_pixels(page) > 0.9 * with_cloud, "the cloud again")

    page.get_by_role("tab", name="Frame").click()
    page.get_by_text("accepted").nth(1).wait_for()
    page.screenshot(path=report_folder / "frame-1280x800.png")

    page.get_by_role("button", name="Play").click()
    page.get_by_role("button", name="Pause").wait_for()
    page.get_by_role("button", name="Play").wait_for()
    wait_until(page, lambda: frame_box(page).input_value() == str(FRAMES - 1), "the end")
    page.get_by_role("button", name="previous").click()
    page.get_by_text("at frame").wait_for()


def test_keys_clicks_and_the_time_line_move_the_page(
    runs: tuple[Path, Path], served: Serve, opened: Opened
) -> None:
    page = opened(served("view", str(runs[0]), "--port", "0", "--frame", "20").url)
    ready(page)
    shown = frame_box(page).input_value
    page.keyboard.press("ArrowRight")
    wait_until(page, lambda: shown() == "21", "the next frame")
    page.keyboard.press("Home")
    wait_until(page, lambda: shown() == "0", "the first frame")
    line = page.locator("#pcnav-time canvas").bounding_box()
    assert line is not None
    middle = line["x"] + 104 + 0.5 * (line["width"] - 104 - 64)
    page.mouse.click(middle, line["y"] + line["height"] - 24)
    wait_until(page, lambda: shown() == str(FRAMES // 2), "the middle of the run")
    plot = page.locator(".pcnav-plots canvas").first.bounding_box()
    assert plot is not None
    page.mouse.click(plot["x"] + 62 + 0.25 * (plot["width"] - 72), plot["y"] + 30)
    wait_until(page, lambda: abs(cursor_s(page) - 0.25 * 0.5 * (FRAMES - 1)) < 0.6, "a quarter")
    page.keyboard.press("n")
    wait_until(page, lambda: "frame" in page.evaluate("document.body.innerText"), "an event")
    wait_until(page, lambda: f"frame={shown()}" in page.url, "the address")
    assert f"frame={shown()}" in page.url


@pytest.fixture(scope="session")
def one_camera(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run on tracks of which the last frame shows one far from where it is."""
    path = shipped_pipeline("applsci2022")
    assert path is not None
    pipeline = read_pipeline(path)
    scenario = pipeline.scenario.model_copy(update={"frames": 12})
    pipeline = pipeline.model_copy(update={"scenario": scenario})
    folder = tmp_path_factory.mktemp("camera")
    simulate(pipeline, path).write(folder / "recording")
    tracks = folder / "recording" / "tracks.csv"
    *rows, last = tracks.read_text().splitlines()
    time_s, feature, u, v = last.split(",")
    wrong = f"{time_s},{feature},{float(u) + 50.0},{float(v) + 90.0}"
    tracks.write_text("\n".join([*rows, wrong, ""]))
    run_pipeline(folder / "recording", folder / "result", pipeline)
    return folder / "result"


def test_a_click_at_a_track_says_why_it_was_rejected(
    one_camera: Path, served: Serve, opened: Opened, report_folder: Path
) -> None:
    view = served("view", str(one_camera), "--port", "0")
    page = opened(view.url)
    page.get_by_text("1 rejected").wait_for()
    image = page.locator(".pcnav-plots").locator(
        "xpath=ancestor::div[contains(@class, 'ScrollArea-content')]"
    )
    box = image.locator("img:visible").first.bounding_box()
    assert box is not None
    seen = Image.open(io.BytesIO(page.screenshot(clip=box))).convert("RGB")
    off = np.abs(np.asarray(seen).astype(int) - REJECTED_COLOUR).max(axis=-1)
    rows, columns = np.nonzero(off < 40)
    assert len(rows)
    page.mouse.click(box["x"] + float(columns.mean()), box["y"] + float(rows.mean()))
    card = page.locator("#pcnav-card")
    card.get_by_text("(rejected)").wait_for()
    page.screenshot(path=report_folder / "camera-1280x800.png")
    assert "beyond the gate of" in card.inner_text()
    # Its keys are those that do something here, and say what they did.
    page.keyboard.press("Escape")
    page.keyboard.press("3")
    page.get_by_text("rate: hidden").wait_for()
    page.keyboard.press("?")
    page.get_by_text("show or hide: rate").wait_for()
    assert page.get_by_text("measure a distance").count() == 0


@pytest.mark.study
def test_nothing_lies_beyond_the_edge_of_its_panel(
    runs: tuple[Path, Path], served: Serve, opened: Opened
) -> None:
    """Neither table, image nor plot, of any tab at any size."""
    view = served("view", str(runs[0]), "--port", "0")
    for width, height in ((1280, 800), (1440, 900), (1920, 1080)):
        page = opened(view.url, width, height)
        ready(page)
        for tab in ("Image and plots", "Frame", "Known"):
            page.get_by_role("tab", name=tab).click()
            places = {
                "Frame": page.get_by_text("d² / gate"),
                "Known": page.get_by_text("known from"),
            }
            places.get(tab, page.locator(".pcnav-plots canvas")).first.wait_for()
            assert page.evaluate(_BEYOND) == [], (width, tab)


@pytest.mark.study
def test_two_pages_have_their_own_time(
    runs: tuple[Path, Path], served: Serve, opened: Opened
) -> None:
    view = served("view", str(runs[0]), "--port", "0", "--frame", "20")
    first, second = opened(view.url), opened(view.url)
    ready(first)
    ready(second)
    go_to(first, 30)
    wait_until(first, lambda: cursor_s(first) == 15.0, "the cursor at frame 30")
    assert frame_box(second).input_value() == "20"
    assert cursor_s(second) == 10.0


@pytest.mark.study
def test_two_runs_are_laid_over_each_other(
    runs: tuple[Path, Path], served: Serve, opened: Opened, report_folder: Path
) -> None:
    view = served("view", *map(str, runs), "--port", "0", "--frame", "20")
    page = opened(view.url, 1920, 1080)
    ready(page)
    for run in runs:
        assert page.get_by_text(run.name).count() >= 1
    lines = page.evaluate("pcnav.data.plots.charts[0].lines.map(line => line.colour)")
    assert lines == [hex_of(colour) for colour in RUNS]
    assert page.evaluate("pcnav.data.timeline.runs.length") == len(runs)
    page.screenshot(path=report_folder / "compare-1920x1080.png")


@pytest.mark.study
def test_a_restarted_server_is_found_again_and_shows_what_the_address_says(
    runs: tuple[Path, Path], served: Serve, opened: Opened
) -> None:
    view = served("view", str(runs[0]), "--port", "8790")
    page = opened(f"{view.url}/?frame=17&points=plane")
    ready(page)
    assert frame_box(page).input_value() == "17"
    port = view.url.rsplit(":", 1)[1]
    view.stop()
    # Until then it shows what it did.
    page.evaluate("window.before = pcnav")
    served("view", str(runs[0]), "--port", port, "--frame", "33")
    wait_until(page, lambda: page.evaluate("pcnav !== before && 'now' in pcnav.data"), "the server")
    wait_until(page, lambda: frame_box(page).input_value() == "17", "the page's own frame")
    ready(page)
    assert "frame=17&" in page.url


def test_a_page_that_is_not_heard_asks_again_until_it_is_opened(
    runs: tuple[Path, Path], opened: Opened, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It keeps its address and what its user does meanwhile, and asks no more once it is open."""
    asked: list[dict[str, Any]] = []
    hear = bridge.Page._open

    def deaf_at_first(page: bridge.Page, message: dict[str, Any]) -> None:
        asked.append(message)
        if len(asked) > 3:
            hear(page, message)

    monkeypatch.setattr(bridge.Page, "_open", deaf_at_first)
    server = serve(finished(load_run(runs[0])), LOOPBACK, 0, first_frame=33)
    try:
        page = opened(f"http://{LOOPBACK}:{server.get_port()}/?frame=17")
        wait_until(page, lambda: len(asked) == 2, "the same request again")
        assert frame_box(page).input_value() == "33"
        assert page.url.endswith("?frame=17")
        wait_until(page, lambda: frame_box(page).input_value() == "17", "the page's own frame")
        assert {message["state"] for message in asked} == {"frame=17"}
        # By the clock of the page.
        assert np.diff([message["at"] for message in asked]).min() > 900.0
        wait_until(page, lambda: "frame=17&camera" in page.url, "the address")
        go_to(page, 20)
        wait_until(page, lambda: "frame=20&camera" in page.url, "the address of another frame")
        told = len(asked)
        page.wait_for_timeout(2500)
        assert len(asked) == told
    finally:
        server.stop()


@pytest.mark.study
def test_a_run_is_followed_as_it_goes_on(
    sequence: Path, tmp_path: Path, served: Serve, opened: Opened, report_folder: Path
) -> None:
    out = tmp_path / "result"
    view = served("run", str(sequence), "-o", str(out), "--view", "--port", "0")
    page = opened(view.url)
    page.get_by_text("newest frame").wait_for()
    view.wait_for("the view stays open")
    wait_until(page, lambda: frame_box(page).input_value() == str(FRAMES - 1), "the last frame")
    ready(page)
    page.screenshot(path=report_folder / "live-1280x800.png")
    assert (out / "report.html").is_file()


def test_an_exported_page_opens_offline(
    runs: tuple[Path, Path], tmp_path: Path, opened: Opened, report_folder: Path
) -> None:
    from pcnav.viewer.export import scene_html
    from pcnav.viewer.render_options import RenderOptions

    file = tmp_path / "frame.html"
    file.write_bytes(scene_html((load_run(runs[0]),), 20, RenderOptions()))
    page = opened(file.as_uri(), offline=True)
    wait_until(page, lambda: cloud_pixels(page) > 5_000, "the cloud")
    page.screenshot(path=report_folder / "exported-1280x800.png")


@pytest.mark.study
def test_a_picture_can_be_downloaded(
    runs: tuple[Path, Path], served: Serve, opened: Opened, tmp_path: Path
) -> None:
    view = served("view", str(runs[0]), "--port", "0", "--frame", "20")
    page = opened(view.url)
    ready(page)
    page.get_by_text("Share", exact=True).click()
    with page.expect_download() as download:
        page.get_by_role("button", name="PNG of this view").click()
    assert download.value.suggested_filename == "first-20.png"
    download.value.save_as(tmp_path / "view.png")
    with Image.open(tmp_path / "view.png") as picture:
        assert min(picture.size) > 300


def test_a_page_that_was_there_first_looks_at_the_target(
    runs: tuple[Path, Path], opened: Opened
) -> None:
    server = LocalServer(LOOPBACK, 0, "early")
    try:
        page = opened(f"http://{LOOPBACK}:{server.get_port()}")
        # As long as it takes to read a run.
        wait_until(page, lambda: bool(server.get_clients()), "the page")
        show(server, finished(load_run(runs[0])))
        ready(page)
    finally:
        server.stop()


@pytest.mark.study
def test_other_plots_of_a_busy_page_replace_those_that_change(
    runs: tuple[Path, Path], served: Serve, opened: Opened
) -> None:
    view = served("view", str(runs[0]), "--port", "0")
    page = opened(view.url)
    ready(page)
    page.get_by_role("button", name="Play").click()
    for group in ("attitude", "rate"):
        page.get_by_role("combobox", name="plots").click()
        page.get_by_role("option", name=group, exact=True).click()
        # What comes in the meantime is worked off at once; the fixture sees any complaint.
        page.evaluate("const end = performance.now() + 800; while (performance.now() < end) {}")
        page.locator("b", has_text=group).wait_for()
    page.get_by_role("button", name="Play").wait_for()
