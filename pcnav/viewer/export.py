"""The view without its server: a page of one frame, and a recording that plays."""

import secrets
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import numpy as np
import viser

from pcnav.core.errors import InputError
from pcnav.viewer.browser import opened_page, settled_png
from pcnav.viewer.layers import StoryLayers, shot_of, thinned
from pcnav.viewer.look import Look, vector
from pcnav.viewer.palette import RUNS
from pcnav.viewer.server import UP, LocalServer
from pcnav.viewer.story import Story

MAX_RECORDED_FRAMES = 300
RECORDED_HZ = 20.0
_MAX_RECORDED_POINTS = 4000
_PICTURE_SIZE = (1280, 800)
_CAMERA_FOV_RAD = float(np.radians(40.0))

OnFrame = Callable[[int, int], None]


def scene_html(stories: tuple[Story, ...], frame: int, look: Look) -> bytes:
    """A page of its own that shows one frame and can be turned; it opens without a network."""
    server = _quiet_server(stories, frame)
    try:
        layers = StoryLayers(server.scene, stories, RUNS)
        layers.show(frame, shot_of(stories[0], frame), look)
        _caption(server.scene, stories, frame)
        html = server.get_scene_serializer().as_html(dark_mode=True)
        return html.encode("utf-8")
    finally:
        server.stop()


def recorded_frames(story: Story) -> tuple[int, ...]:
    """The frames of a recording: all of them, or so many evenly spread ones."""
    count = len(story.track)
    step = max(1, -(-count // MAX_RECORDED_FRAMES))
    return tuple(range(0, count, step))


def recording(stories: tuple[Story, ...], look: Look, on_frame: OnFrame | None = None) -> bytes:
    """A .viser recording of a run, 20 frames a second, clouds thinned to 4000 points."""
    frames = recorded_frames(stories[0])
    known = np.flatnonzero(stories[0].track.has_estimate)
    server = _quiet_server(stories, int(known[0]) if known.size else 0)
    try:
        layers = StoryLayers(server.scene, stories, RUNS)
        caption = _caption(server.scene, stories, 0)
        serializer = server.get_scene_serializer()
        for done, frame in enumerate(frames, start=1):
            shot = shot_of(stories[0], frame)
            thin = None if shot is None else thinned(shot, _MAX_RECORDED_POINTS)
            layers.show(frame, thin, look)
            caption.text = _told(stories, frame)
            serializer.insert_sleep(1.0 / RECORDED_HZ)
            if on_frame is not None:
                on_frame(done, len(frames))
        return serializer.serialize()
    finally:
        server.stop()


def shown_frame(story: Story, asked: int | None) -> int:
    """The frame asked for, else the first with an estimate. Raises `InputError` beyond the run."""
    count = len(story.track)
    if asked is not None and asked >= count:
        expected = f"expected a frame below {count}, got {asked}"
        raise InputError(story.name, "--frame", expected)
    if not count:
        raise InputError(story.name, "frames", "expected at least one frame")
    known = np.flatnonzero(story.track.has_estimate)
    return asked if asked is not None else int(known[0]) if known.size else 0


def export(kind: str, stories: tuple[Story, ...], frame: int, path: Path, on_frame: OnFrame) -> int:
    """Write a file of one kind: html, png or recording; its size in bytes."""
    makers: dict[str, Callable[[], bytes]] = {
        "html": lambda: scene_html(stories, frame, Look()),
        "png": lambda: scene_png(stories, frame),
        "recording": lambda: recording(stories, Look(), on_frame),
    }
    content = makers[kind]()
    write_whole(path, content)
    return len(content)


def scene_png(stories: tuple[Story, ...], frame: int) -> bytes:
    """A picture of one frame, drawn by a browser without a window."""
    server = _quiet_server(stories, frame)
    try:
        layers = StoryLayers(server.scene, stories, RUNS)
        layers.show(frame, shot_of(stories[0], frame), Look())
        _caption(server.scene, stories, frame)
        with opened_page(server, *_PICTURE_SIZE) as client:
            return settled_png(client, *_PICTURE_SIZE)
    finally:
        server.stop()


def refuse_existing(path: Path, overwrite: bool) -> None:
    """Raise `InputError` where a file would be replaced without having been told to."""
    if path.exists() and not (overwrite and path.is_file()):
        expected = "expected a new file; --overwrite replaces an existing one"
        raise InputError(path, "file", expected)


def write_whole(path: Path, content: bytes) -> None:
    """Write a file that is either whole or not there. Raises `InputError` where it cannot be."""
    part = path.with_name(f".{path.name}-{secrets.token_hex(4)}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        part.write_bytes(content)
        part.replace(path)
    except OSError as error:
        expected = f"expected a place that can be written ({error.strerror})"
        raise InputError(path, "file", expected) from error
    finally:
        with suppress(OSError):
            part.unlink()


def _quiet_server(stories: tuple[Story, ...], frame: int) -> LocalServer:
    """A server for its scene alone, on a free port of this machine; it is stopped right after."""
    server = LocalServer("127.0.0.1", 0, stories[0].name)
    position, centre = stories[0].viewpoint(frame)
    camera = server.initial_camera
    camera.position, camera.look_at = vector(position), vector(centre)
    camera.up, camera.fov = UP, _CAMERA_FOV_RAD
    return server


def _caption(scene: viser.SceneApi, stories: tuple[Story, ...], frame: int) -> viser.LabelHandle:
    centre = stories[0].centre(frame)
    above = centre - np.array([0.0, 0.55 * stories[0].size_m, 0.0])
    return scene.add_label(
        "/caption", _told(stories, frame), position=vector(above), anchor="center-center"
    )


def _told(stories: tuple[Story, ...], frame: int) -> str:
    names = " and ".join(story.name for story in stories)
    track = stories[0].track
    return f"{names}: frame {frame}, {track.time_s[frame]:.2f} s, {track.status[frame]}"
