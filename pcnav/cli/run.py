"""``pcnav run``: estimate a motion from a recording."""

from collections.abc import Mapping
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from pcnav.cli import completion
from pcnav.cli.dated_folder import dated_folder, link_latest
from pcnav.cli.follow import Budget, DropLate, Follow, Idle, pace_of
from pcnav.cli.frame_options import (
    Background,
    Box,
    Masks,
    MaxRange,
    MinRange,
    SkipBadFrames,
    with_frame_options,
)
from pcnav.cli.names import mesh_of_pipeline, named_mesh, named_pipeline
from pcnav.cli.options import MeshUnit, Overwrite, Port
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
    with_recording_options,
)
from pcnav.cli.several import folders_of, run_several
from pcnav.cli.verbosity import is_quiet, say
from pcnav.config.length_unit import LengthUnit
from pcnav.core._extras import require_view
from pcnav.files.new_folder import refuse_unless_replaceable
from pcnav.runs.result_files import STATES_FILE

if TYPE_CHECKING:
    from pcnav.config.first_pose import FirstPoseTable
    from pcnav.config.pipeline_file import Pipeline
    from pcnav.following import Pace
    from pcnav.navigation import RunSummary
    from pcnav.runs.estimate import Estimate, Output
    from pcnav.viewer.live import LiveView


NOTHING_FOUND = 3
"""Exit code of a run in which no estimate was claimed in any frame."""


def run(
    sequences: Annotated[
        list[Path],
        typer.Argument(
            help="Folder of a depth sequence, of depth images, of feature tracks or of images of "
            "one camera; a bag, an array file or a video: see docs/formats.md. Of several each "
            "gets a result folder of its own, in that of -o.",
        ),
    ],
    out: Annotated[
        Path | None,
        typer.Option(
            "-o",
            "--out",
            help="Result folder; without it a dated one in runs, to which runs/latest leads.",
            show_default=False,
        ),
    ] = None,
    target: Annotated[
        str | None,
        typer.Option(
            help="Mesh of the target, or the name of a shipped one; "
            "without it the sequence's own, else the pipeline's.",
            autocompletion=completion.meshes,
        ),
    ] = None,
    mesh_unit: MeshUnit = None,
    pipeline: Annotated[
        str | None,
        typer.Option(
            help="File with the settings of the estimator, or the name of a shipped one; "
            "a result's pipeline.toml repeats its run.",
            autocompletion=completion.pipelines,
        ),
    ] = None,
    estimator: Annotated[
        str | None,
        typer.Option(
            help="Another estimator than the pipeline's, like open3d_icp or kiss_icp.",
            autocompletion=completion.estimators,
        ),
    ] = None,
    initial_pose: Annotated[
        str | None,
        typer.Option(
            help="Pose of the target in the first frame, T_cam_model: 'tx ty tz qx qy qz qw' in m, "
            "or a TUM or JSON file with one pose. It shortens the start, and is dropped when the "
            "frames contradict it."
        ),
    ] = None,
    initial_pose_sd: Annotated[
        tuple[float, float] | None,
        typer.Option(
            help="Its standard deviations: of the position, m, and of the attitude, deg; "
            "2 % of the distance and 5 deg unless told."
        ),
    ] = None,
    masks: Masks = None,
    min_range: MinRange = None,
    max_range: MaxRange = None,
    box: Box = None,
    background: Background = None,
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
    follow: Follow = False,
    budget: Budget = None,
    idle: Idle = None,
    drop_late: DropLate = False,
    overwrite: Overwrite = False,
    report: Annotated[
        bool, typer.Option("--report/--no-report", help="Whether to draw the report page.")
    ] = True,
    view: Annotated[
        bool, typer.Option("--view", help="Look at the run in the browser while it goes on.")
    ] = False,
    port: Port = 8080,
    as_json: Annotated[
        bool,
        typer.Option("--json", help="Print summary.json of the result, one line each, not tables."),
    ] = False,
) -> None:
    """Estimate pose, motion and mass properties from depth frames, feature tracks or images.

    Stereo tracks need a pipeline with an estimator for them, as hu2024 and segal2011 have. Images
    and tracks of one camera, with its camera.toml, give attitude and rate.

    Exit code 3 when nothing was found in any frame; the result folder is written all the same, and
    a warning says why.

    Example: `pcnav run runs/boxsat -o runs/boxsat-result`, or
    `pcnav run --follow frames --target sat.stl -o runs/live`
    """
    from pcnav.core.errors import InputError

    if view:
        require_view("pcnav run --view")
    several, pace = len(sequences) > 1, pace_of(follow, budget, idle, drop_late)
    alone = {"--follow": follow, "--view": view, "--initial-pose": initial_pose}
    refused = [name for name, value in alone.items() if several and value]
    if refused:
        raise InputError("pcnav run", refused[0], "expected one recording, it is for one alone")
    now = datetime.now()
    folders = (
        folders_of(sequences, out, now) if several else [out or dated_folder(sequences[0], now)]
    )
    for folder in folders:
        if not overwrite and pace is None:
            # Before anything heavy is imported.
            refuse_unless_replaceable(folder.resolve(), overwrite, STATES_FILE)
    from pcnav.recordings.first_pose import parsed_first_pose

    first, sequence = None, sequences[0]
    if initial_pose is not None:
        first = parsed_first_pose(initial_pose, initial_pose_sd)
    elif initial_pose_sd is not None:
        raise InputError(sequence, "--initial-pose-sd", "expected --initial-pose, which it is of")
    frame_options = {
        **{"masks": masks, "min_range": min_range, "max_range": max_range, "box": box},
        **{"background": background, "skip_bad_frames": skip_bad_frames},
    }
    recording_options = options_of(
        camera, unit, rate, topic, camera_topic, object_, start, frames, every
    )

    def run_one(sequence: Path, folder: Path) -> bool:
        return run_into(
            *(sequence, target, pipeline, folder, overwrite, port if view else None, estimator),
            first,
            frame_options=frame_options,
            recording_options=recording_options,
            mesh_unit=mesh_unit,
            report=report,
            linked=out is None,
            pace=pace,
            as_json=as_json,
        )

    found = (
        run_several(sequences, folders, run_one, as_json)
        if several
        else run_one(sequence, folders[0])
    )
    if not found:
        raise typer.Exit(NOTHING_FOUND)


def run_into(
    sequence: Path,
    target_mesh: str | None,
    pipeline: str | None,
    out: Path,
    overwrite: bool,
    view_port: int | None = None,
    estimator: str | None = None,
    initial_pose: "FirstPoseTable | None" = None,
    *,
    frame_options: Mapping[str, Any] | None = None,
    recording_options: Mapping[str, Any] | None = None,
    mesh_unit: LengthUnit | None = None,
    report: bool = True,
    linked: bool = False,
    pace: "Pace | None" = None,
    as_json: bool = False,
) -> bool:
    """Run, show how far it is, and say what was found; whether anything was.

    ``linked``: `link_latest` to the result. ``pace``: follow the frames as they arrive.
    ``as_json``: print the answer for programs.
    """
    from pcnav.cli.follow import follow_arriving
    from pcnav.estimators.choice import chosen, refuse_mesh
    from pcnav.pipeline import run as run_recording
    from pcnav.recordings.recording import RecordingKind

    path, content = (Path("pipeline"), None) if pipeline is None else named_pipeline(pipeline)
    content = with_frame_options(content, path, **(frame_options or {}))
    content = with_recording_options(content, **(recording_options or {}))
    # Of what arrives there may be nothing yet: it is depth frames.
    kind = RecordingKind.DEPTH
    if pace is None:
        choice = chosen(sequence, content, estimator, path)
        kind = choice.kind
        if target_mesh is not None:
            refuse_mesh(sequence, choice)
    if target_mesh is None and kind is RecordingKind.DEPTH and content and content.target_mesh:
        mesh = mesh_of_pipeline(path, content.target_mesh)
        content = content.model_copy(update={"target_mesh": str(mesh)})
    mesh_path = None if target_mesh is None else named_mesh(target_mesh)

    with progress("run") as advance:

        def work(view: "LiveView | None") -> "RunSummary":
            def on_start(as_run: "Pipeline", output: "Output") -> None:
                if view is not None:
                    view.expect(out.name, as_run, output)

            def on_estimate(estimate: "Estimate", done: int, total: int) -> None:
                if view is not None:
                    view.add(estimate)
                advance(done, total)

            options: dict[str, Any] = {
                **{"estimator": estimator, "target_mesh": mesh_path, "mesh_unit": mesh_unit},
                **{"initial_pose": initial_pose, "overwrite": overwrite, "report": report},
                **{"source": path, "on_start": on_start, "on_estimate": on_estimate},
            }
            if pace is not None:
                return follow_arriving(sequence, out, content, pace, **options)
            return run_recording(sequence, out, content, **options)

        if view_port is None:
            summary, server = work(None), None
        else:
            from pcnav.cli.view import tell_address
            from pcnav.viewer.live import run_live
            from pcnav.viewer.memory import give_back_large_arrays
            from pcnav.viewer.server import LOOPBACK

            give_back_large_arrays()
            summary, server = run_live(
                work, view_port, lambda served: tell_address(served, LOOPBACK, view_port)
            )
    if linked:
        link_latest(summary.folder)
    if as_json:
        typer.echo(summary.answer.model_dump_json())
    elif not is_quiet():
        _tell(summary)
    if server is None and not as_json:
        say(f"web view: pcnav view {summary.folder}")
    if server is not None:
        from pcnav.cli.view import serve_until_interrupted

        serve_until_interrupted(server)
    return summary.diagnosis.found


def _tell(summary: "RunSummary") -> None:
    """Say what was found."""
    from rich.console import Console

    from pcnav.report.answer import terminal_answer
    from pcnav.report.summary import summary_table

    console = Console()
    console.print(terminal_answer(summary.answer))
    console.print(summary_table(summary.metrics, summary.gain))
    typer.echo(f"report: {summary.report}" if summary.has_report else f"result: {summary.folder}")
