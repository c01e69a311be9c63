"""``pcnav run``: estimate a motion from a recording."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from pcnav.cli.names import mesh_of_pipeline, named_mesh, named_pipeline
from pcnav.cli.options import Overwrite, Port
from pcnav.cli.progress import progress
from pcnav.core.errors import InputError

if TYPE_CHECKING:
    from pcnav.cli.run_kinds import Work


def run(
    sequence: Annotated[
        Path,
        typer.Argument(
            help="Folder of a depth sequence, of feature tracks or of images of one camera; "
            "or a video."
        ),
    ],
    out: Annotated[Path, typer.Option("-o", "--out", help="Result folder.")],
    target: Annotated[
        str | None,
        typer.Option(
            help="Mesh of the target, or the name of a shipped one; "
            "without it the sequence's own, else the pipeline's."
        ),
    ] = None,
    pipeline: Annotated[
        str | None,
        typer.Option(
            help="File with the settings of the estimator, or the name of a shipped one; "
            "a result's pipeline.toml repeats its run."
        ),
    ] = None,
    overwrite: Overwrite = False,
    view: Annotated[
        bool, typer.Option("--view", help="Look at the run in the browser while it goes on.")
    ] = False,
    port: Port = 8080,
) -> None:
    """Estimate pose, motion and mass properties from depth frames, feature tracks or images.

    Stereo tracks need a pipeline with an estimator for them, as hu2024 and segal2011 have. Images
    and tracks of one camera, with its camera.toml, give attitude and rate.

    Example: `pcnav run runs/boxsat -o runs/boxsat-result`
    """
    run_into(sequence, target, pipeline, out, overwrite, port if view else None)


def run_into(
    sequence: Path,
    target_mesh: str | None,
    pipeline: str | None,
    out: Path,
    overwrite: bool,
    view_port: int | None = None,
) -> None:
    from pcnav.cli.run_kinds import attitudes_run, depth_run, images_run, tracks_run
    from pcnav.config.pipeline_file import EstimatorKind, Pipeline
    from pcnav.estimators.image_motion.source import is_seen_by_one_camera
    from pcnav.recordings.attitudes import ATTITUDES_FILE, is_attitude_recording
    from pcnav.recordings.monocular_tracks import CAMERA_FILE
    from pcnav.recordings.tracks import TRACKS_FILE, tracks_folder

    path, content = Path("pipeline"), Pipeline()
    if pipeline is not None:
        path, content = named_pipeline(pipeline)
    if content.estimator.kind is EstimatorKind.ATTITUDE_INERTIA:
        if target_mesh is not None:
            raise InputError(sequence, "--target", "expected none: attitudes need no mesh")
        if not (is_seen_by_one_camera(sequence) or is_attitude_recording(sequence)):
            expected = f"expected a table of attitudes, a folder with {ATTITUDES_FILE}, or images"
            raise InputError(sequence, "recording", expected)
        _carry_out(attitudes_run(sequence, content, out, overwrite), view_port)
        return
    by_images = content.estimator.kind is EstimatorKind.IMAGE_MOTION
    if by_images or is_seen_by_one_camera(sequence):
        if pipeline is not None and not by_images:
            expected = f'expected "{EstimatorKind.IMAGE_MOTION}" for images of one camera'
            raise InputError(path, "estimator.kind", f'{expected}, got "{content.estimator.kind}"')
        if target_mesh is not None:
            raise InputError(sequence, "--target", "expected none: images of one camera need none")
        _carry_out(images_run(sequence, content, out, overwrite), view_port)
        return
    if tracks_folder(sequence) is not None:
        if pipeline is None:
            expected = "expected one with an estimator for stereo tracks, as hu2024 or segal2011"
            beside = f"; tracks of one camera have {CAMERA_FILE} beside them"
            raise InputError(sequence, "--pipeline", expected + beside)
        if target_mesh is not None:
            raise InputError(sequence, "--target", "expected none: feature tracks need no mesh")
        _carry_out(tracks_run(sequence, path, content, out, overwrite), view_port)
        return
    if is_attitude_recording(sequence):
        expected = (
            f'expected one with the estimator "{EstimatorKind.ATTITUDE_INERTIA}" for attitudes'
        )
        raise InputError(sequence, "--pipeline", f"{expected}, as deng2024")
    if content.estimator.kind is not EstimatorKind.DEPTH:
        kind, expected = (
            content.estimator.kind,
            f"expected a folder with {TRACKS_FILE}, or that file",
        )
        raise InputError(sequence, "folder", f'{expected}, for the estimator "{kind}" of {path}')
    if content.target_mesh is not None and target_mesh is None:
        mesh = mesh_of_pipeline(path, content.target_mesh)
        content = content.model_copy(update={"target_mesh": str(mesh)})
    mesh_path = None if target_mesh is None else named_mesh(target_mesh)
    _carry_out(depth_run(sequence, mesh_path, content, out, overwrite), view_port)


def _carry_out(work: "Work", view_port: int | None) -> None:
    """Do it, seen by whoever opens the page if a port is given, and tell what was found."""
    from rich.console import Console

    from pcnav.cli.view import serve_until_interrupted, tell_address

    server = None
    with progress("run") as advance:
        if view_port is None:
            done = work(advance, None)
        else:
            from pcnav.viewer.live import run_live
            from pcnav.viewer.server import LOOPBACK

            done, server = run_live(
                lambda view: work(advance, view),
                view_port,
                lambda served: tell_address(served, LOOPBACK, view_port),
            )
    Console().print(done.table)
    typer.echo(f"report: {done.report}")
    if server is None:
        typer.echo(f"web view: pcnav view {done.folder}")
    else:
        serve_until_interrupted(server)
