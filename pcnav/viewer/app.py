"""A run in the browser: the estimated target, the measured cloud and rectangles, over time."""

import threading
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import viser

from pcnav.arrays import FloatArray
from pcnav.camera import PinholeCamera, unproject
from pcnav.config import read_pipeline
from pcnav.errors import InputError
from pcnav.evaluation.overlay import rectangle_corners
from pcnav.mesh import wireframe_edges
from pcnav.results import (
    ACCEPTED,
    PIPELINE_FILE,
    RectangleRecord,
    Track,
    read_measurements,
    read_track,
)
from pcnav.sequences.opening import open_sequence
from pcnav.sequences.sequence import Frame, Sequence
from pcnav.spatial import xyzw_from_rotation
from pcnav.state import COM_MODEL, OMEGA_BODY, THETA_BODY
from pcnav.target import Target, load_target

_CLOUD, _MESH, _TRAIL = (90, 170, 255), (240, 200, 60), (150, 150, 150)
_USED, _UNUSED = (60, 200, 90), (230, 80, 80)


@dataclass(frozen=True)
class RunData:
    """All that the view shows of a run."""

    folder: Path
    track: Track
    records: dict[float, tuple[RectangleRecord, ...]]
    """By time."""
    target: Target
    sequence: Sequence | None
    """None when the frames are no longer on disk: the view then shows the states alone."""


class _LocalServer(viser.ViserServer):
    """A server that no client can open to the outside."""

    def request_share_url(self, verbose: bool = True) -> None:
        """Refuse the public tunnel that viser offers to any client."""


def load_run(folder: Path) -> RunData:
    """Read a result folder. Raises `InputError` when it is none."""
    track = read_track(folder)
    pipeline = read_pipeline(folder / PIPELINE_FILE)
    if pipeline.target_mesh is None:
        raise InputError(folder / PIPELINE_FILE, "target_mesh", "expected the mesh of the run")
    records: dict[float, list[RectangleRecord]] = {}
    for record in read_measurements(folder):
        records.setdefault(record.time_s, []).append(record)
    return RunData(
        folder=folder,
        track=track,
        records={time_s: tuple(rows) for time_s, rows in records.items()},
        target=load_target(Path(pipeline.target_mesh)),
        sequence=_sequence_of(pipeline.sequence),
    )


def _sequence_of(path: str | None) -> Sequence | None:
    try:
        return None if path is None else open_sequence(Path(path))
    except InputError:
        return None


def serve(run: RunData, host: str, port: int) -> viser.ViserServer:
    """Start the server and build the view; the caller keeps the process alive.

    A taken port moves up: read ``server.get_port()``.
    """
    server = _LocalServer(host=host, port=port, label=f"pcnav: {run.folder.name}", verbose=False)
    server.gui.configure_theme(show_share_button=False, show_logo=False)
    server.scene.set_up_direction("-y")  # the scene is the camera frame, y down
    _add_fixed(server, run)
    slider: viser.GuiInputHandle[int] = server.gui.add_slider(
        "frame", min=0, max=max(len(run.track) - 1, 1), step=1, initial_value=0
    )
    play = server.gui.add_checkbox("play", initial_value=False)
    facts = server.gui.add_markdown("")

    def show() -> None:
        index = min(int(slider.value), len(run.track) - 1)
        with server.atomic():
            _show_frame(server, run, index)
        facts.content = frame_facts(run, index)

    @slider.on_update
    def _(_: object) -> None:
        show()

    first = np.flatnonzero(run.track.has_estimate)
    # viser's handles type their value as read-only, though assigning is how it is set.
    slider.value = int(first[0]) if first.size else 0  # type: ignore[misc]
    show()
    _play_when_asked(slider, play, len(run.track))
    return server


def _play_when_asked(
    slider: viser.GuiInputHandle[int], play: viser.GuiCheckboxHandle, frames: int
) -> None:
    """Advance the slider ten times a second while the box is ticked."""

    def advance() -> None:
        while True:
            time.sleep(0.1)
            if play.value:
                slider.value = (int(slider.value) + 1) % frames  # type: ignore[misc]

    threading.Thread(target=advance, daemon=True, name="pcnav playback").start()


def frame_facts(run: RunData, index: int) -> str:
    """Markdown on one frame: time, status, estimate with standard deviations, what was used."""
    track = run.track
    time_s = float(track.time_s[index])
    lines = [f"**{time_s:.2f} s** · {track.status[index]}"]
    if track.has_estimate[index]:
        sd = track.sd[index]
        rate = np.rad2deg(track.omega_body[index])
        lines += [
            f"range {np.linalg.norm(track.T_cam_model[index, :3, 3]):.3f} m",
            f"attitude ± {np.rad2deg(np.linalg.norm(sd[THETA_BODY])):.3f} deg",
            f"rate {_vector(rate, 3)} ± {np.rad2deg(np.linalg.norm(sd[OMEGA_BODY])):.4f} deg/s",
            f"mass centre {_vector(track.com_model[index], 3)} "
            f"± {np.linalg.norm(sd[COM_MODEL]):.4f} m",
            f"inertia ratios {_vector(track.inertia_ratios[index], 3)}",
        ]
    lines += [
        f"{'✓' if record.outcome == ACCEPTED else '✗'} {record.rectangle or 'unrecognised'}"
        + ("" if record.outcome == ACCEPTED else f": {record.outcome}")
        for record in run.records.get(time_s, ())
    ]
    return "\n\n".join(lines)


def _vector(values: FloatArray, digits: int) -> str:
    return "(" + ", ".join(f"{value:.{digits}f}" for value in values) + ")"


def _add_fixed(server: viser.ViserServer, run: RunData) -> None:
    """What does not change with time: the chaser's camera and the trail of the target."""
    camera = run.sequence.frame(0).camera if run.sequence is not None else None
    if camera is not None:
        server.scene.add_camera_frustum(
            "/camera", fov=_vertical_fov(camera), aspect=camera.width / camera.height, scale=0.5
        )
    positions = run.track.T_cam_model[run.track.has_estimate, :3, 3]
    if len(positions) > 1:
        segments = np.stack([positions[:-1], positions[1:]], axis=1).astype(np.float32)
        server.scene.add_line_segments("/trail", segments, _TRAIL, thickness=0.01)
    distance = float(np.linalg.norm(positions[0])) if len(positions) else 10.0
    server.initial_camera.position = (0.35 * distance, -0.25 * distance, 0.55 * distance)
    server.initial_camera.look_at = tuple(positions[0]) if len(positions) else (0.0, 0.0, distance)


def _vertical_fov(camera: PinholeCamera) -> float:
    return float(2.0 * np.arctan(0.5 * camera.height / camera.fy))


def _show_frame(server: viser.ViserServer, run: RunData, index: int) -> None:
    """Cloud, mesh and rectangles of one frame; each replaces what stood under its name."""
    time_s = float(run.track.time_s[index])
    frame = _frame_of(run, index)
    if frame is not None:
        points = unproject(frame.camera, frame.depth_m)[frame.depth_m > 0.0]
        server.scene.add_point_cloud(
            "/cloud", points.astype(np.float32), _CLOUD, point_size=0.02, precision="float32"
        )
    _show_mesh(server, run, index)
    for used, colour in ((True, _USED), (False, _UNUSED)):
        outlines = [
            _closed(rectangle_corners(record))
            for record in run.records.get(time_s, ())
            if (record.outcome == ACCEPTED) is used and np.isfinite(record.T_cam_rect).all()
        ]
        lines = np.concatenate(outlines) if outlines else np.zeros((0, 2, 3))
        name = "/rectangles/used" if used else "/rectangles/unused"
        server.scene.add_line_segments(name, lines.astype(np.float32), colour, thickness=0.02)


def _frame_of(run: RunData, index: int) -> Frame | None:
    """The depth frame of a row of the run; None where the sequence no longer holds it."""
    if run.sequence is None or index >= len(run.sequence):
        return None
    try:
        frame = run.sequence.frame(index)
    except InputError:
        return None
    return frame if frame.time_s == run.track.time_s[index] else None


def _show_mesh(server: viser.ViserServer, run: RunData, index: int) -> None:
    known = bool(run.track.has_estimate[index])
    T = run.track.T_cam_model[index] if known else np.eye(4)
    x, y, z, w = xyzw_from_rotation(T[:3, :3])
    edges = wireframe_edges(run.target.mesh).astype(np.float32)
    server.scene.add_line_segments(
        "/target",
        edges,
        _MESH,
        thickness=0.015,
        wxyz=(float(w), float(x), float(y), float(z)),
        position=tuple(T[:3, 3].tolist()),
        visible=known,
    )


def _closed(corners: FloatArray) -> FloatArray:
    """(4, 2, 3) the sides of a rectangle with corners (4, 3)."""
    return np.stack([corners, np.roll(corners, -1, axis=0)], axis=1)
