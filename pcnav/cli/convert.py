"""``pcnav convert``: a recording of any format, written as one of our own."""

from pathlib import Path
from typing import Annotated

import typer

from pcnav.cli.frame_options import SkipBadFrames
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


def convert(
    recording: Annotated[Path, typer.Argument(help="Depth frames of any format.")],
    out: Annotated[Path, typer.Option("-o", "--out", help="Folder of the sequence.")],
    target: Annotated[
        str | None, typer.Option(help="Mesh of the target, or a shipped name, to go along.")
    ] = None,
    mesh_unit: MeshUnit = None,
    step: Annotated[
        float | None, typer.Option(help="Metres of a unit as it is stored; else the recording's.")
    ] = None,
    skip_bad_frames: SkipBadFrames = False,
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
) -> None:
    """Write depth frames of any format, with their truth where they have one, in our own format.

    Example: `pcnav convert flight.mcap --target boxsat -o runs/flight`
    """
    from dataclasses import replace

    from pcnav.core.errors import InputError
    from pcnav.recordings.converting import convert as convert_sequence
    from pcnav.recordings.opening import open_sequence

    if step is not None and not 0.0 < step < 1.0:
        raise InputError("pcnav convert", "--step", "expected metres of one unit, like 0.001")
    options = options_of(camera, unit, rate, topic, camera_topic, object_, start, frames, every)
    table = recording_table(**options)
    mesh = None if target is None else named_mesh(target)
    sequence = open_sequence(recording, mesh, skip_bad_frames, table)
    if out.resolve() == sequence.path.resolve():
        raise InputError(out, "--out", "expected another folder than the recording's own")
    if mesh_unit is not None:
        sequence = replace(sequence, info=replace(sequence.info, mesh_unit=mesh_unit))
    with progress("convert") as advance:
        step_m = convert_sequence(
            sequence,
            out,
            step_m=step,
            skip_bad_frames=skip_bad_frames,
            overwrite=overwrite,
            on_frame=advance,
        )
    say(f"sequence: {out} ({len(sequence)} frames, {1000.0 * step_m:g} mm a unit)")
