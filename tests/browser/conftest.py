"""A real browser, and runs to look at in it."""

import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import pytest
from playwright.sync_api import Browser, BrowserContext, ConsoleMessage, Page, sync_playwright

from pcnav.config.pipeline_file import Pipeline
from pcnav.pipeline import run
from pcnav.simulation.depth import Scene
from pcnav.target.satellite import load_target
from pcnav.viewer.browser import find_browser

FRAMES = 40
_ARGUMENTS = (
    *("--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"),
    *("--disable-background-networking", "--no-first-run", "--disable-quic"),
    # Without a graphics card pages are put together faster by the processor.
    *("--disable-component-update", "--disable-sync", "--disable-gpu-compositing"),
)
PATIENCE_MS = 20_000


@pytest.fixture(scope="session")
def report_folder(repository: Path) -> Path:
    """Where the screenshots of this run of the tests go."""
    folder = repository / "test-report"
    folder.mkdir(exist_ok=True)
    return folder


@pytest.fixture(scope="session")
def sequence(tmp_path_factory: pytest.TempPathFactory, repository: Path) -> Path:
    """A box satellite that turns before the camera."""
    folder = tmp_path_factory.mktemp("browser") / "sequence"
    pipeline = Pipeline.model_validate(
        {
            "scenario": {"frames": FRAMES},
            "orbit": {"r_hill_m": (20.0, 0.0, 0.0)},
            "camera": {"horizontal_fov_deg": 32.0},
            "body": {
                "omega_body_deg_s": (1.0, -1.0, 2.0),
                "attitude_rotvec_deg": (25.0, 40.0, -30.0),
            },
        }
    )
    Scene.showing(load_target(repository / "meshes" / "boxsat.obj"), pipeline).write(folder)
    return folder


@pytest.fixture(scope="session")
def runs(sequence: Path) -> tuple[Path, Path]:
    """Two runs on it, with other settings."""
    folders = (sequence.parent / "first", sequence.parent / "second")
    for folder, iterations in zip(folders, (5, 1), strict=True):
        run(sequence, folder, Pipeline.model_validate({"filter": {"iterations": iterations}}))
    return folders


@pytest.fixture(scope="session")
def chromium() -> Iterator[Browser]:
    """Debian's Chromium, or whatever is there; skips without one."""
    program = find_browser()
    if program is None:
        pytest.skip("no Chromium or Chrome on the PATH")
    with sync_playwright() as started:
        browser = started.chromium.launch(executable_path=program, args=list(_ARGUMENTS))
        yield browser
        browser.close()


Opened = Callable[..., Page]


def _note(complaints: list[str], message: ConsoleMessage) -> None:
    # viser puts its panels together anew when they are docked, and throws an image of them away
    # that is still being loaded; the new one has its own.
    is_viser_image = message.location.get("url", "").startswith("blob:")
    if message.type == "error" and not is_viser_image:
        complaints.append(message.text)


@pytest.fixture
def opened(chromium: Browser) -> Iterator[Opened]:
    """Opens pages; at the end none may have complained."""
    complaints: list[str] = []
    contexts: list[BrowserContext] = []

    def open_page(url: str, width: int = 1280, height: int = 800, *, offline: bool = False) -> Page:
        context = chromium.new_context(viewport={"width": width, "height": height}, offline=offline)
        contexts.append(context)
        page = context.new_page()
        page.set_default_timeout(PATIENCE_MS)
        page.on("pageerror", lambda error: complaints.append(str(error)))
        page.on("console", partial(_note, complaints))
        page.goto(url)
        return page

    yield open_page
    for context in contexts:
        context.close()
    assert complaints == []


class Served:
    """A `pcnav` command that serves a view."""

    def __init__(self, *arguments: str) -> None:
        command = [sys.executable, "-c", "from pcnav.cli import main; main()", *arguments]
        self.started_s = time.monotonic()
        self._process = subprocess.Popen(
            command,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            # Lines are to come as they are printed.
            env={**os.environ, "PYTHONUNBUFFERED": "1"},
        )
        self.lines: list[str] = []
        self.url = self.wait_for("view: ").split()[1]

    def wait_for(self, start: str) -> str:
        """The next line that starts so."""
        assert self._process.stdout is not None
        for line in self._process.stdout:
            self.lines.append(line)
            if line.startswith(start):
                return line
        raise AssertionError(f"ended without {start!r}: {''.join(self.lines)}")

    def stop(self) -> None:
        """End it as Ctrl-C does."""
        self._process.terminate()
        self._process.wait(20.0)
        assert self._process.stdout is not None
        self._process.stdout.close()


@pytest.fixture
def served() -> Iterator[Callable[..., Served]]:
    """Starts commands; all are ended."""
    started: list[Served] = []

    def serve(*arguments: str) -> Served:
        started.append(Served(*arguments))
        return started[-1]

    yield serve
    for each in started:
        each.stop()


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Say where the screenshots are."""
    folder = Path(__file__).resolve().parents[2] / "test-report"
    if folder.is_dir() and any(folder.iterdir()):
        terminalreporter.write_line(f"screenshots: {folder.name}/")
