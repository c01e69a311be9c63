"""``pcnav run --follow``: frames are answered as they arrive."""

import os
import sys
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from pcnav.core.errors import InputError

if TYPE_CHECKING:
    from pcnav.config.first_pose import FirstPoseTable
    from pcnav.config.length_unit import LengthUnit
    from pcnav.config.pipeline_file import Pipeline
    from pcnav.following import Pace
    from pcnav.navigation import Inputs, RunSummary
    from pcnav.recordings.arriving import Arriving
    from pcnav.recordings.given_frames import DepthRecording

STREAM = Path("-")
"""Standard input."""

Follow = Annotated[
    bool,
    typer.Option(
        "--follow",
        help="Answer depth frames as they are written to the folder, or, of -, come on standard "
        "input as MCAP; an unfinished run in -o is gone on with. See docs/follow.md.",
    ),
]
Budget = Annotated[
    float | None,
    typer.Option(min=0.0, help="Of --follow: seconds after which an answer is late; 0.1."),
]
Idle = Annotated[
    float | None,
    typer.Option(
        min=0.0, help="Of --follow: end when no frame came for so many seconds; else by a file END."
    ),
]
DropLate = Annotated[
    bool,
    typer.Option(
        "--drop-late",
        help="Of --follow: pass over a frame that waited for longer than the budget, when there "
        "is a later one; else all are answered.",
    ),
]


def pace_of(
    follow: bool, budget: float | None, idle: float | None, drop_late: bool
) -> "Pace | None":
    """What the options say; None where a whole recording is run. Raises `InputError`."""
    if not follow:
        said = {"--budget": budget, "--idle": idle, "--drop-late": drop_late or None}
        for name, value in said.items():
            if value is not None:
                raise InputError("pcnav run", name, "expected --follow, which it is of")
        return None
    from pcnav.following import Pace

    return Pace(0.1 if budget is None else budget, idle, drop_late)


def follow_arriving(
    path: Path,
    out: Path,
    pipeline: "Pipeline | None",
    pace: "Pace",
    *,
    estimator: str | None,
    target_mesh: Path | None,
    mesh_unit: "LengthUnit | None",
    initial_pose: "FirstPoseTable | None",
    source: Path | str,
    **options: Any,
) -> "RunSummary":
    """Follow what is written to a folder, or comes on standard input: see `following.follow`."""
    from pcnav.config.pipeline_file import Pipeline
    from pcnav.estimators.choice import depth_estimator
    from pcnav.following import follow
    from pcnav.pipeline import inputs_of

    content = pipeline or Pipeline()
    kind = depth_estimator(estimator or str(content.estimator.kind), source)

    def inputs(recording: "DepthRecording") -> "Inputs":
        found = inputs_of(recording, out, content, kind, target_mesh, mesh_unit)
        return found if initial_pose is None else found.beginning_at(initial_pose)

    return follow(_source_of(path, content, target_mesh), out, inputs, pace, **options)


def _source_of(path: Path, pipeline: "Pipeline", target_mesh: Path | None) -> "Arriving":
    table = pipeline.recording
    if path == STREAM:
        from pcnav.recordings.bag_stream import BagStream
        from pcnav.recordings.mcap_messages import McapMessages
        from pcnav.recordings.region_files import gates_of
        from pcnav.recordings.sequence import SequenceInfo

        info = SequenceInfo("stream", 0.0, None, target_mesh)
        # A descriptor of its own: the thread that reads it must not hold up the process's end.
        stream = os.fdopen(os.dup(sys.stdin.fileno()), "rb")
        return BagStream(McapMessages(stream), info, table, gates_of(pipeline.region, path))
    from pcnav.recordings.depth_folder import with_more
    from pcnav.recordings.growing_folder import GrowingFolder
    from pcnav.recordings.opening import open_sequence

    if not path.is_dir():
        expected = "expected a folder that frames are written to, or - for standard input"
        raise InputError(path, "--follow", expected)
    opened = partial(open_sequence, path, target_mesh, True, table)
    # Which of the images are taken is counted from the first.
    adds = with_more if (table.start, table.every) == (0, 1) else lambda *_: None
    return GrowingFolder(path, opened, pipeline.region, table.frames, adds)
