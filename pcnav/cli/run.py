"""``pcnav run``: estimate a motion from a recording."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from pcnav.cli.names import mesh_of_pipeline, named_mesh, named_pipeline
from pcnav.cli.options import Overwrite
from pcnav.cli.progress import progress
from pcnav.errors import InputError

if TYPE_CHECKING:
    from pcnav.config import Pipeline


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
        bool, typer.Option("--view", help="Look at a depth run in the browser while it goes on.")
    ] = False,
    port: Annotated[int, typer.Option(help="Of the view; a taken port moves up.")] = 8080,
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
    from rich.console import Console

    from pcnav.config import Pipeline
    from pcnav.config_features import EstimatorKind
    from pcnav.evaluation.summary import summary_table
    from pcnav.image_source import is_seen_by_one_camera
    from pcnav.sequences.attitudes import ATTITUDES_FILE, is_attitude_recording
    from pcnav.sequences.monocular import CAMERA_FILE
    from pcnav.sequences.track_files import TRACKS_FILE, is_track_recording

    path, content = Path("pipeline"), Pipeline()
    if pipeline is not None:
        path, content = named_pipeline(pipeline)
    seen_otherwise = (
        is_seen_by_one_camera(sequence)
        or is_track_recording(sequence)
        or is_attitude_recording(sequence)
    )
    if view_port is not None and seen_otherwise:
        expected = "expected a depth sequence; look at the result with pcnav view"
        raise InputError(sequence, "--view", expected)
    if content.estimator.kind is EstimatorKind.ATTITUDE_INERTIA:
        if target_mesh is not None:
            raise InputError(sequence, "--target", "expected none: attitudes need no mesh")
        if not (is_seen_by_one_camera(sequence) or is_attitude_recording(sequence)):
            expected = f"expected a table of attitudes, a folder with {ATTITUDES_FILE}, or images"
            raise InputError(sequence, "recording", expected)
        _run_attitudes(sequence, content, out, overwrite)
        return
    by_images = content.estimator.kind is EstimatorKind.IMAGE_MOTION
    if by_images or is_seen_by_one_camera(sequence):
        if pipeline is not None and not by_images:
            expected = f'expected "{EstimatorKind.IMAGE_MOTION}" for images of one camera'
            raise InputError(path, "estimator.kind", f'{expected}, got "{content.estimator.kind}"')
        if target_mesh is not None:
            raise InputError(sequence, "--target", "expected none: images of one camera need none")
        _run_images(sequence, content, out, overwrite)
        return
    if is_track_recording(sequence):
        if pipeline is None:
            expected = "expected one with an estimator for stereo tracks, as hu2024 or segal2011"
            beside = f"; tracks of one camera have {CAMERA_FILE} beside them"
            raise InputError(sequence, "--pipeline", expected + beside)
        if target_mesh is not None:
            raise InputError(sequence, "--target", "expected none: feature tracks need no mesh")
        _run_tracks(sequence, path, content, out, overwrite)
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
    from pcnav.pipeline import run as run_sequence

    if content.target_mesh is not None and target_mesh is None:
        mesh = mesh_of_pipeline(path, content.target_mesh)
        content = content.model_copy(update={"target_mesh": str(mesh)})
    mesh_path = None if target_mesh is None else named_mesh(target_mesh)
    if view_port is not None:
        _run_in_view(sequence, mesh_path, content, out, overwrite, view_port)
        return
    with progress("run") as advance:
        summary = run_sequence(
            sequence,
            out,
            content,
            target_mesh=mesh_path,
            overwrite=overwrite,
            on_estimate=lambda estimate, total: advance(estimate.index + 1, total),
        )
    Console().print(summary_table(summary.metrics, summary.knowledge))
    typer.echo(f"report: {summary.report}")
    typer.echo(f"web view: pcnav view {summary.folder}")


def _run_in_view(
    sequence: Path, mesh: Path | None, pipeline: "Pipeline", out: Path, overwrite: bool, port: int
) -> None:
    """The same run, seen by whoever opens the page; the page stays when it has ended."""
    from rich.console import Console

    from pcnav.cli.view import serve_until_interrupted, tell_address
    from pcnav.evaluation.summary import summary_table
    from pcnav.viewer.live import run_live
    from pcnav.viewer.server import LOOPBACK

    with progress("run") as advance:
        summary, server = run_live(
            sequence,
            out,
            pipeline,
            mesh,
            overwrite=overwrite,
            port=port,
            on_served=lambda server: tell_address(server, LOOPBACK, port),
            on_progress=advance,
        )
    Console().print(summary_table(summary.metrics, summary.knowledge))
    typer.echo(f"report: {summary.report}")
    serve_until_interrupted(server)


def _run_tracks(
    recording: Path, path: Path, pipeline: "Pipeline", out: Path, overwrite: bool
) -> None:
    from rich.console import Console

    from pcnav.evaluation.summary import summary_table
    from pcnav.feature_pipeline import run_features

    with progress("run") as advance:
        summary = run_features(
            recording,
            out,
            pipeline,
            overwrite=overwrite,
            on_estimate=lambda _, done, total: advance(done, total),
            source=path,
        )
    Console().print(summary_table(summary.metrics))
    typer.echo(f"report: {summary.report}")


def _run_images(recording: Path, pipeline: "Pipeline", out: Path, overwrite: bool) -> None:
    from rich.console import Console

    from pcnav.evaluation.summary import summary_table
    from pcnav.image_pipeline import run_images

    with progress("run") as advance:
        summary = run_images(
            recording,
            out,
            pipeline,
            overwrite=overwrite,
            on_frame=lambda _, done, total: advance(done, total),
        )
    Console().print(summary_table(summary.metrics))
    typer.echo(f"report: {summary.report}")


def _run_attitudes(recording: Path, pipeline: "Pipeline", out: Path, overwrite: bool) -> None:
    from rich.console import Console

    from pcnav.attitude_pipeline import run_attitudes
    from pcnav.evaluation.summary import summary_table

    with progress("run") as advance:
        summary = run_attitudes(recording, out, pipeline, overwrite=overwrite, on_frame=advance)
    Console().print(summary_table(summary.metrics))
    typer.echo(f"report: {summary.report}")
