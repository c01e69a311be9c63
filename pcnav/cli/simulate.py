"""``pcnav simulate``: write a recording."""

from pathlib import Path
from typing import Annotated

import typer

from pcnav.cli import completion
from pcnav.cli.names import mesh_of_pipeline, named_pipeline
from pcnav.cli.options import MeshUnit, Overwrite
from pcnav.cli.progress import progress
from pcnav.cli.verbosity import say
from pcnav.config.length_unit import LengthUnit


def simulate(
    pipeline: Annotated[
        str,
        typer.Argument(
            help="Pipeline file, or the name of a shipped one.",
            autocompletion=completion.pipelines,
        ),
    ],
    out: Annotated[Path, typer.Option("-o", "--out", help="Folder of the sequence.")],
    mesh_unit: MeshUnit = None,
    overwrite: Overwrite = False,
) -> None:
    """Write depth frames, feature tracks or shaded images, and the truth of a pipeline's scenario.

    Which of them follows from the estimator that the pipeline names, unless [scenario] says it.

    Example: `pcnav simulate boxsat -o runs/boxsat`
    """
    simulate_into(pipeline, out, overwrite, mesh_unit)


def simulate_into(
    pipeline: str, out: Path, overwrite: bool, mesh_unit: LengthUnit | None = None
) -> None:
    from pcnav.estimators.choice import simulated_kind
    from pcnav.simulation.simulate import simulate as simulate_pipeline

    path, content = named_pipeline(pipeline)
    if mesh_unit is not None:
        content = content.model_copy(update={"mesh_unit": mesh_unit})
    kind = simulated_kind(content, path)
    name = content.target_mesh
    mesh = None if name is None else mesh_of_pipeline(path, name)
    with progress("simulate") as advance:
        told = simulate_pipeline(content, path, mesh, kind).write(out, overwrite, advance)
    say(told)
