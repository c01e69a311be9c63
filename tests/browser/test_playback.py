"""A recording in a browser: it is drawn under its policy, and no script of it runs."""

import io
import threading
import time
from pathlib import Path

import msgspec
import numpy as np
import pytest
import zstandard
from PIL import Image
from playwright.sync_api import Browser, Page

from pcnav.viewer import playback
from pcnav.viewer.playback import serve_recording
from tests.browser.conftest import PATIENCE_MS

SCRIPT = "globalThis.ran = true; document.title = 'ran'"


def recording(folder: Path) -> Path:
    """A red box, a label that tries to be a page, and a script."""
    box = {
        "type": "BoxMessage",
        "name": "/box",
        "props": {
            **{"dimensions": (3.0, 3.0, 3.0), "color": (255, 0, 0), "wireframe": False},
            **{"opacity": None, "flat_shading": True, "side": "front", "material": "standard"},
            **{"cast_shadow": False, "receive_shadow": False, "scale": 1.0},
        },
    }
    label = {
        "type": "LabelMessage",
        "name": "/label",
        "props": {
            **{"text": f'<img src=x onerror="{SCRIPT}">', "font_size_mode": "screen"},
            **{"font_screen_scale": 1.0, "font_scene_height": 0.1, "depth_test": False},
            **{"anchor": "center-center"},
        },
    }
    script = {"type": "RunJavascriptMessage", "source": SCRIPT}
    content = {
        "durationSeconds": 0.0,
        "messages": [(0.0, message) for message in (box, label, script)],
        "viserVersion": "1.1.1",
        "binaryBufferLengths": [],
    }
    payload = msgspec.msgpack.encode(content)
    inner = len(payload).to_bytes(8, "little") + payload
    path = folder / "a.viser"
    path.write_bytes(len(inner).to_bytes(8, "little") + zstandard.compress(inner))
    return path


def has_red_box(page: Page) -> bool:
    image = np.asarray(Image.open(io.BytesIO(page.screenshot())).convert("RGB"), dtype=float)
    return bool(((image[..., 0] > 150.0) & (image[..., 1] < 130.0)).mean() > 0.02)


@pytest.mark.study
@pytest.mark.parametrize("policy", [None, ""], ids=["with the policy", "without any"])
def test_a_recording_is_drawn_and_its_scripts_do_not_run(
    chromium: Browser, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, policy: str | None
) -> None:
    # The check is left out, so that the policy has to hold alone.
    monkeypatch.setattr(playback, "read_recording", Path.read_bytes)
    if policy is not None:
        monkeypatch.setattr(playback, "_POLICY", policy)
    server = serve_recording(recording(tmp_path), "127.0.0.1", 0)
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    try:
        page = chromium.new_page()
        page.goto(f"http://127.0.0.1:{server.server_port}/")
        page.wait_for_selector("canvas", timeout=PATIENCE_MS)
        # The red box is drawn in either case, at last after the script.
        deadline = time.monotonic() + PATIENCE_MS / 1000.0
        while not has_red_box(page):
            assert time.monotonic() < deadline
        ran, origin = page.evaluate("globalThis.ran"), page.evaluate("self.origin")
        page.close()
    finally:
        server.shutdown()
        server.server_close()
        thread.join()
    assert (ran, origin == "null") == ((None, True) if policy is None else (True, False))
