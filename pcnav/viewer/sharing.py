"""What a browser can download of what it shows."""

from collections.abc import Callable

import viser

from pcnav.viewer.browser import picture_png
from pcnav.viewer.controls import Share
from pcnav.viewer.export import recording, scene_html
from pcnav.viewer.look import Look
from pcnav.viewer.story import Story

_Maker = Callable[[viser.ClientHandle, tuple[Story, ...], int, Look], bytes]


def made(
    share: Share, client: viser.ClientHandle, stories: tuple[Story, ...], frame: int, look: Look
) -> tuple[str, bytes]:
    """File name and content."""
    suffix, make = _MAKERS[share]
    stem = "-".join(story.name for story in stories)
    name = f"{stem}{suffix}" if share is Share.RECORDING else f"{stem}-{frame}{suffix}"
    return name, make(client, stories, frame, look)


def _png(client: viser.ClientHandle, stories: tuple[Story, ...], frame: int, look: Look) -> bytes:
    camera = client.camera
    return picture_png(client, camera.image_width, camera.image_height)


def _html(client: viser.ClientHandle, stories: tuple[Story, ...], frame: int, look: Look) -> bytes:
    return scene_html(stories, frame, look)


def _recording(
    client: viser.ClientHandle, stories: tuple[Story, ...], frame: int, look: Look
) -> bytes:
    return recording(stories, look)


_MAKERS: dict[Share, tuple[str, _Maker]] = {
    Share.PNG: (".png", _png),
    Share.HTML: (".html", _html),
    Share.RECORDING: (".viser", _recording),
}
