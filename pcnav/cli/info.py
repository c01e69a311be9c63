"""``pcnav info``: what is in a recording."""

import json
import logging
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from pcnav.cli.names import named_mesh
from pcnav.cli.options import MeshUnit, Overwrite
from pcnav.cli.progress import progress
from pcnav.cli.recording_options import (
    Camera,
    CameraTopic,
    Every,
    Frames,
    Object,
    Rate,
    Start,
    Topic,
    Unit,
    options_of,
    recording_table,
)
from pcnav.cli.verbosity import say

if TYPE_CHECKING:
    from pcnav.recordings.sequence import Sequence
    from pcnav.report.recording_info import RecordingInfo

_LOG = logging.getLogger("pcnav")
_SHOWN = 6


def info(
    recording: Annotated[Path, typer.Argument(help="A recording of any kind and format.")],
    target: Annotated[
        str | None, typer.Option(help="Mesh of the target, or a shipped name, to compare with.")
    ] = None,
    mesh_unit: MeshUnit = None,
    png: Annotated[
        Path | None, typer.Option("--png", help="Also draw the first frames into this file.")
    ] = None,
    camera: Camera = None,
    unit: Unit = None,
    rate: Rate = None,
    topic: Topic = None,
    camera_topic: CameraTopic = None,
    object_: Object = None,
    start: Start = 0,
    frames: Frames = None,
    every: Every = 1,
    overwrite: Overwrite = False,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print it for programs, in one line.")
    ] = False,
) -> None:
    """Say what is in a recording: format, frames, times, camera, depths, and what looks wrong.

    Example: `pcnav info flight.mcap --target boxsat --png flight.png`
    """
    from rich.console import Console
    from rich.markup import escape

    from pcnav.core.errors import InputError
    from pcnav.files.new_file import refuse_existing, write_whole
    from pcnav.recordings.opening import format_of, open_recording
    from pcnav.recordings.sequence import Sequence
    from pcnav.recordings.truth import truth_of
    from pcnav.report.recording_info import recording_info
    from pcnav.target.satellite import load_target

    if png is not None:
        refuse_existing(png, overwrite)
    options = options_of(camera, unit, rate, topic, camera_topic, object_, start, frames, every)
    table = recording_table(**options)
    mesh = None if target is None else named_mesh(target)
    found = format_of(recording)
    opened = open_recording(recording, mesh, skip_bad_frames=True, table=table)
    assert found is not None, "it was opened"
    satellite = None
    if isinstance(opened, Sequence):
        mesh = mesh or opened.info.target_mesh
        stated = None if target is not None else opened.info.mesh_unit
        satellite = None if mesh is None else load_target(mesh, mesh_unit or stated)
    elif png is not None:
        raise InputError(recording, "--png", "expected none: only depth frames are drawn")
    has_truth = truth_of(opened) is not None
    with progress("info") as advance:
        said = recording_info(opened, found.name, satellite, has_truth, advance)
    if as_json:
        typer.echo(_as_json(said))
    else:
        width = max(len(what) for what, _ in said.rows)
        for what, of_it in said.rows:
            typer.echo(f"{what:<{width}}  {of_it}")
        if said.ranges is not None:
            Console().print(said.ranges.to_rich())
    for doubt in said.doubts:
        _LOG.warning("%s", doubt)
    if png is not None:
        assert isinstance(opened, Sequence)
        write_whole(png, _drawn(opened))
        if not as_json:
            say(f"picture: {escape(str(png))}")


def _as_json(said: "RecordingInfo") -> str:
    table = said.ranges
    ranges = [] if table is None else [dict(zip(table.header, r, strict=True)) for r in table.rows]
    whole = {**dict(said.rows), "ranges": ranges, "doubts": said.doubts}
    return json.dumps(whole, ensure_ascii=False)


def _drawn(sequence: "Sequence") -> bytes:
    """The first frames that can be read."""
    from pcnav.core.errors import InputError
    from pcnav.report.frames_picture import frames_picture

    shown, failure = [], None
    for index in range(len(sequence)):
        try:
            shown.append(sequence.frame(index))
        except InputError as error:
            failure = failure or error
        if len(shown) == _SHOWN:
            break
    if not shown:
        assert failure is not None
        raise failure
    return frames_picture(shown, sequence.name)
