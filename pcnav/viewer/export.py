"""What is shown as a file: a picture, a page of one frame, a recording that plays."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from enum import StrEnum

import numpy as np
import viser

from pcnav.core.errors import InputError
from pcnav.viewer.annotate import annotated, overlaid
from pcnav.viewer.assessment import Opening, opening_frame
from pcnav.viewer.browser import opened_page, picture, png_bytes, settled_picture
from pcnav.viewer.layers import RunLayers, shot_of
from pcnav.viewer.loaded_run import LoadedRun
from pcnav.viewer.palette import RUNS
from pcnav.viewer.render_options import CAMERA_FOV_RAD, RenderOptions, vector
from pcnav.viewer.rerun_file import rerun_recording
from pcnav.viewer.server import UP, LocalServer

MAX_RECORDED_FRAMES = 300
RECORDED_HZ = 20.0
_MAX_RECORDED_POINTS = 4000
_PICTURE_SIZE = (1280, 800)

OnFrame = Callable[[int, int], None]


class Share(StrEnum):
    """A kind of file."""

    PNG = "PNG of this view"
    HTML = "HTML of this frame"
    RECORDING = "recording (.viser)"
    RRD = "recording (.rrd, rerun)"


SUFFIXES = {
    Share.PNG: (".png",),
    Share.HTML: (".html", ".htm"),
    Share.RECORDING: (".viser",),
    Share.RRD: (".rrd",),
}
"""Of the files of each kind; the first is what pcnav gives them."""


def exported(
    share: Share,
    runs: tuple[LoadedRun, ...],
    frame: int,
    options: RenderOptions,
    client: viser.ClientHandle | None = None,
    on_frame: OnFrame | None = None,
) -> bytes:
    """The content of a file of some kind.

    The picture is that of a ``client``'s view, else of a browser without a window. ``on_frame`` is
    told how many frames of a recording are done, and of how many.
    """
    if share is Share.HTML:
        return scene_html(runs, frame, options)
    if share is Share.RECORDING:
        return recording(runs, options, on_frame)
    if share is Share.RRD:
        return rerun_recording(runs, options, on_frame)
    shot = shot_of(runs[0], frame, options.max_points)
    if client is not None:
        size = client.camera.image_width, client.camera.image_height
        return png_bytes(annotated(picture(client, *size), runs, frame, options, shot))
    with _still(runs, frame, options) as server, opened_page(server, *_PICTURE_SIZE) as page:
        settled = settled_picture(page, *_PICTURE_SIZE)
    return png_bytes(annotated(settled, runs, frame, options, shot))


def file_name(share: Share, runs: tuple[LoadedRun, ...], frame: int) -> str:
    """What a downloaded file is called."""
    stem = "-".join(loaded.name for loaded in runs)
    return (
        f"{stem}{'' if share in (Share.RECORDING, Share.RRD) else f'-{frame}'}{SUFFIXES[share][0]}"
    )


def scene_html(runs: tuple[LoadedRun, ...], frame: int, options: RenderOptions) -> bytes:
    """A page of its own that shows one frame and can be turned; it opens without a network."""
    with _still(runs, frame, options) as server:
        html = server.get_scene_serializer().as_html(dark_mode=True)
    shot = shot_of(runs[0], frame, options.max_points)
    return overlaid(html, runs, frame, options, shot).encode("utf-8")


def recorded_frames(loaded: LoadedRun) -> tuple[int, ...]:
    """The frames of a recording: all of them, or so many evenly spread ones."""
    count = len(loaded)
    step = max(1, -(-count // MAX_RECORDED_FRAMES))
    return tuple(range(0, count, step))


def recording(
    runs: tuple[LoadedRun, ...], options: RenderOptions, on_frame: OnFrame | None = None
) -> bytes:
    """A .viser recording of a run, 20 frames a second, clouds thinned to 4000 points."""
    frames = recorded_frames(runs[0])
    with _scene(runs, runs[0].opening_frame) as (server, layers, caption):
        serializer = server.get_scene_serializer()
        for done, frame in enumerate(frames, start=1):
            layers.show(frame, shot_of(runs[0], frame, _MAX_RECORDED_POINTS), options)
            caption.text = _title(runs, frame)
            serializer.insert_sleep(1.0 / RECORDED_HZ)
            if on_frame is not None:
                on_frame(done, len(frames))
        return serializer.serialize()


def shown_frame(loaded: LoadedRun, asked: int | Opening) -> int:
    """The frame asked for, or looked for. Raises `InputError` beyond the run."""
    count = len(loaded)
    if not isinstance(asked, Opening) and asked >= count:
        expected = f"expected a frame below {count}, got {asked}"
        raise InputError(loaded.name, "--frame", expected)
    if not count:
        raise InputError(loaded.name, "frames", "expected at least one frame")
    return opening_frame(loaded, asked) if isinstance(asked, Opening) else asked


@contextmanager
def _still(
    runs: tuple[LoadedRun, ...], frame: int, options: RenderOptions
) -> Iterator[LocalServer]:
    """A scene in which a frame is drawn."""
    with _scene(runs, frame) as (server, layers, _):
        layers.show(frame, shot_of(runs[0], frame, options.max_points), options)
        yield server


@contextmanager
def _scene(
    runs: tuple[LoadedRun, ...], frame: int
) -> Iterator[tuple[LocalServer, RunLayers, viser.LabelHandle]]:
    """A server for its scene alone, seen as a frame is, on a free port of this machine."""
    server = LocalServer("127.0.0.1", 0, runs[0].name)
    try:
        position, centre = runs[0].viewpoint(frame)
        camera = server.initial_camera
        camera.position, camera.look_at = vector(position), vector(centre)
        camera.up, camera.fov = UP, CAMERA_FOV_RAD
        layers = RunLayers(server.scene, runs, RUNS)
        above = vector(centre - np.array([0.0, 0.55 * runs[0].size_m, 0.0]))
        caption = server.scene.add_label(
            "/caption", _title(runs, frame), position=above, anchor="center-center"
        )
        yield server, layers, caption
    finally:
        server.stop()


def _title(runs: tuple[LoadedRun, ...], frame: int) -> str:
    names = " and ".join(loaded.name for loaded in runs)
    run = runs[0].run
    return f"{names}: frame {frame}, {run.time_s[frame]:.2f} s, {run.status[frame]}"
