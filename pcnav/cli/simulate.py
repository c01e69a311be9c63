"""``pcnav simulate``: write a recording."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from pcnav.cli.names import mesh_of_pipeline, named_pipeline
from pcnav.cli.options import Overwrite
from pcnav.cli.progress import progress
from pcnav.core.errors import InputError

if TYPE_CHECKING:
    from pcnav.config.pipeline_file import Pipeline


def simulate(
    pipeline: Annotated[str, typer.Argument(help="Pipeline file, or the name of a shipped one.")],
    out: Annotated[Path, typer.Option("-o", "--out", help="Folder of the sequence.")],
    overwrite: Overwrite = False,
) -> None:
    """Write depth frames, feature tracks or shaded images, and the truth of a pipeline's scenario.

    Which of them follows from the estimator that the pipeline names.

    Example: `pcnav simulate boxsat -o runs/boxsat`
    """
    simulate_into(pipeline, out, overwrite)


def simulate_into(pipeline: str, out: Path, overwrite: bool) -> None:
    from pcnav.config.pipeline_file import EstimatorKind

    path, content = named_pipeline(pipeline)
    if content.estimator.kind is EstimatorKind.IMAGE_MOTION:
        _simulate_images(path, content, out, overwrite)
        return
    if content.estimator.kind is EstimatorKind.ATTITUDE_INERTIA:
        from pcnav.simulation.attitude_recording import simulate_attitudes

        typer.echo(simulate_attitudes(content, out, overwrite, path))
        return
    if content.estimator.kind is not EstimatorKind.DEPTH:
        from pcnav.simulation.feature_recording import simulate_tracks

        typer.echo(simulate_tracks(content, out, overwrite, path).text)
        return
    from pcnav.simulation.recording import simulate as write_sequence
    from pcnav.target.satellite import load_target

    if content.target_mesh is None:
        raise InputError(path, "target_mesh", "expected the mesh of the satellite to simulate")
    satellite = load_target(mesh_of_pipeline(path, content.target_mesh))
    with progress("simulate") as advance:
        summary = write_sequence(content, satellite, out, overwrite, advance, path)
    typer.echo(
        f"sequence: {summary.path} ({summary.frames} frames, {summary.median_returns} returns each)"
    )


def _simulate_images(path: Path, pipeline: "Pipeline", out: Path, overwrite: bool) -> None:
    from pcnav.simulation.image_recording import simulate_images

    name = pipeline.target_mesh
    mesh = None if name is None else mesh_of_pipeline(path, name)
    with progress("simulate") as advance:
        summary = simulate_images(pipeline, out, overwrite, path, mesh, advance)
    typer.echo(summary.text)
