"""A browser without a window, for a picture of the view."""

import io
import os
import shutil
import subprocess
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import numpy.typing as npt
import viser
from PIL import Image

from pcnav.core.errors import InputError
from pcnav.files.owned import collect, owned, owned_name
from pcnav.viewer.server import LocalServer

_NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")
_ARGUMENTS = (
    *("--headless=new", "--use-gl=angle", "--use-angle=swiftshader"),
    *("--enable-unsafe-swiftshader", "--disable-background-networking", "--no-first-run"),
    *("--disable-component-update", "--disable-sync", "--hide-scrollbars"),
)
_PATIENCE_S = 60.0
_MAX_PICTURES, _SAME_PICTURES, _BETWEEN_PICTURES_S = 20, 3, 0.3
BACKGROUND = (20, 20, 20)


def find_browser() -> str | None:
    """The program of a Chromium on this machine, None without one."""
    return next((path for path in map(shutil.which, _NAMES) if path is not None), None)


@contextmanager
def opened_page(server: LocalServer, width: int, height: int) -> Iterator[viser.ClientHandle]:
    """A page of a server in a browser without a window. Raises `InputError` without a browser."""
    program = find_browser()
    if program is None:
        expected = "expected a Chromium or Chrome on the PATH, which draws the picture; found none"
        raise InputError("pcnav view", "--png", expected)
    came = threading.Event()
    clients: list[viser.ClientHandle] = []

    @server.on_client_connect
    def _(client: viser.ClientHandle) -> None:
        clients.append(client)
        came.set()

    # Chromium's sandbox does not start as root, who runs what is in a container.
    as_root = ["--no-sandbox"] if hasattr(os, "geteuid") and os.geteuid() == 0 else []
    with _home() as (home, owner):
        command = [program, *_ARGUMENTS, *as_root, f"--user-data-dir={home}"]
        command += [f"--window-size={width},{height}", f"http://127.0.0.1:{server.get_port()}"]
        # The browser owns its folder, too: it may outlive a process that is killed.
        kept = (owner,) if os.name == "posix" else ()
        page = subprocess.Popen(
            command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, pass_fds=kept
        )
        try:
            if not came.wait(_PATIENCE_S):
                raise InputError(program, "browser", f"expected a page within {_PATIENCE_S:g} s")
            yield clients[0]
        finally:
            page.terminate()
            try:
                page.wait(10.0)
            except subprocess.TimeoutExpired:
                page.kill()
                page.wait()


@contextmanager
def _home() -> Iterator[tuple[Path, int]]:
    """A folder for what a browser keeps, and the descriptor that tells whose it is."""
    folder = Path(tempfile.gettempdir())
    collect(folder)
    home = folder / owned_name("pcnav-browser")
    home.mkdir(mode=0o700)
    try:
        with owned(home) as owner:
            yield home, owner
    finally:
        shutil.rmtree(home, ignore_errors=True)


def picture(client: viser.ClientHandle, width: int, height: int) -> npt.NDArray[np.uint8]:
    """(h, w, 3) what a browser shows of the scene, on its dark background."""
    drawn = client.get_render(height, width, transport_format="png", timeout=_PATIENCE_S)
    return on_background(drawn)


def settled_picture(client: viser.ClientHandle, width: int, height: int) -> npt.NDArray[np.uint8]:
    """The picture once it stays the same: letters and shaders take a browser some time."""
    last, same = picture(client, width, height), 0
    for _ in range(_MAX_PICTURES):
        time.sleep(_BETWEEN_PICTURES_S)
        newer = picture(client, width, height)
        same = same + 1 if np.array_equal(newer, last) else 0
        if same == _SAME_PICTURES:
            break
        last = newer
    return last


def on_background(image: npt.NDArray[np.uint8]) -> npt.NDArray[np.uint8]:
    """(h, w, 3) an image (h, w, 4) laid over the background of the view."""
    opacity = image[..., 3:].astype(np.float64) / 255.0
    laid = opacity * image[..., :3] + (1.0 - opacity) * np.array(BACKGROUND)
    return np.asarray(np.round(laid), dtype=np.uint8)


def png_bytes(image: npt.NDArray[np.uint8]) -> bytes:
    """An image (h, w, 3) as PNG."""
    stream = io.BytesIO()
    Image.fromarray(image).save(stream, format="PNG", optimize=True)
    return stream.getvalue()
