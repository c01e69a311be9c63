"""A run as a recording of rerun (extra ``rerun``): cloud, image, mesh, numbers, events by time."""

from collections.abc import Callable
from typing import Any

import numpy as np

from pcnav.core import _extras
from pcnav.core.arrays import FloatArray
from pcnav.target.mesh import wireframe_edges
from pcnav.viewer.assessment import error_over_sigma, inlier_ratio, nis_over_bound
from pcnav.viewer.curves import groups_of
from pcnav.viewer.events import Kind
from pcnav.viewer.layers import shot_of
from pcnav.viewer.loaded_run import LoadedRun, all_events
from pcnav.viewer.palette import RUNS, TRUTH
from pcnav.viewer.panels import frame_picture
from pcnav.viewer.render_options import RenderOptions
from pcnav.viewer.timeline import text_of

_MAX_POINTS = 20_000
OnFrame = Callable[[int, int], None]


def rerun_recording(
    runs: tuple[LoadedRun, ...], options: RenderOptions, on_frame: OnFrame | None = None
) -> bytes:
    """The content of an .rrd file, on the timelines ``frame`` and ``time`` (s).

    The space ``camera`` has x right, y down, z forward, metres. Raises `InputError` without the
    extra.
    """
    rr = _extras.rerun("--rrd")
    stream = rr.RecordingStream("pcnav", make_default=False)
    memory = stream.memory_recording()
    stream.log("camera", rr.ViewCoordinates.RDF, static=True)
    for k, loaded in enumerate(runs):
        _log_mesh(rr, stream, f"camera/run_{k + 1}", loaded, RUNS[k])
    if runs[0].errors is not None and runs[0].target is not None:
        _log_mesh(rr, stream, "camera/truth", runs[0], TRUTH)
    numbers = [_numbers(loaded) for loaded in runs]
    count = len(runs[0])
    for frame in range(count):
        _at(rr, stream, frame, float(runs[0].run.time_s[frame]))
        _log_frame(rr, stream, runs, frame, options)
        for loaded, columns in zip(runs, numbers, strict=True):
            own = loaded.nearest_frame(float(runs[0].run.time_s[frame]))
            for name, values in columns.items():
                if own is not None and np.isfinite(values[own]):
                    place = rr.new_entity_path(["plots", loaded.name, *name])
                    stream.log(place, rr.Scalars(float(values[own])))
        if on_frame is not None:
            on_frame(frame + 1, count)
    for event in all_events(runs):
        _at(rr, stream, event.frame, float(runs[0].run.time_s[event.frame]))
        level = "WARN" if event.kind in (Kind.LOSS, Kind.FLIP) else "INFO"
        stream.log("events", rr.TextLog(text_of(event, runs), level=level))
    stream.flush()
    return bytes(memory.drain_as_bytes())


def _at(rr: Any, stream: Any, frame: int, time_s: float) -> None:
    stream.set_time("frame", sequence=frame)
    stream.set_time("time", duration=time_s)


def _log_mesh(
    rr: Any, stream: Any, place: str, loaded: LoadedRun, colour: tuple[int, int, int]
) -> None:
    if loaded.target is not None:
        edges = wireframe_edges(loaded.target.mesh).astype(np.float32)
        stream.log(f"{place}/edges", rr.LineStrips3D(edges, colors=[colour]), static=True)


def _log_frame(
    rr: Any, stream: Any, runs: tuple[LoadedRun, ...], frame: int, options: RenderOptions
) -> None:
    first = runs[0]
    shot = shot_of(first, frame, min(options.max_points, _MAX_POINTS))
    if shot is not None and first.frames is not None:
        scale_m = options.residual_scale_m or first.frames.scale_m
        colours = np.broadcast_to(shot.colours(options.colour_by, scale_m), shot.points.shape)
        stream.log("camera/points", rr.Points3D(shot.points, colors=colours))
        picture = frame_picture(shot, first.records_at(frame), options.colour_by, scale_m)
        stream.log("image", rr.Image(picture).compress(jpeg_quality=85))
    time_s = float(first.run.time_s[frame])
    for k, loaded in enumerate(runs):
        own = loaded.nearest_frame(time_s)
        _log_pose(rr, stream, f"camera/run_{k + 1}", None if own is None else loaded.pose(own))
    _log_pose(rr, stream, "camera/truth", first.true_pose(frame))
    stream.log("status", rr.TextLog(first.run.status[frame]))


def _log_pose(rr: Any, stream: Any, place: str, T: Any) -> None:
    if T is None:
        stream.log(place, rr.Clear(recursive=False))
        return
    stream.log(place, rr.Transform3D(translation=T[:3, 3], mat3x3=T[:3, :3]))


def _numbers(loaded: LoadedRun) -> dict[tuple[str, ...], FloatArray]:
    """(n,) by name: all that the view plots with a value a frame."""
    judged: dict[tuple[str, ...], FloatArray | None] = {
        ("NIS over its 95 % bound",): nis_over_bound(loaded),
        ("error over sigma",): error_over_sigma(loaded),
        ("inlier ratio",): inlier_ratio(loaded),
    }
    plotted: dict[tuple[str, ...], FloatArray] = {
        (group, chart.label): chart.values
        for group, make in groups_of(loaded).items()
        for chart in make().charts
        if len(chart.values) == len(loaded)
    }
    return {name: values for name, values in judged.items() if values is not None} | plotted
