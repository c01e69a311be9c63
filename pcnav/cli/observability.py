"""``pcnav observability``: what a motion lets one know."""

from pathlib import Path
from typing import Annotated

import typer

from pcnav.cli.names import mesh_of_pipeline, named_pipeline


def observability(
    subject: Annotated[
        str, typer.Argument(help="Result folder, pipeline file, or the name of a shipped pipeline.")
    ],
    mass_centre_sd_m: Annotated[
        float | None, typer.Option(min=1e-9, help="Wanted standard deviation of the mass centre.")
    ] = None,
    attitude_sd_deg: Annotated[
        float | None, typer.Option(min=1e-9, help="Wanted of the attitude, about each axis.")
    ] = None,
    inertia_ratio_sd: Annotated[
        float | None, typer.Option(min=1e-9, help="Wanted of each inertia ratio.")
    ] = None,
) -> None:
    """Print which states a motion makes observable, the weakest directions, and how soon.

    Example: `pcnav observability boxsat`
    """
    import math

    from rich.console import Console

    from pcnav.evaluation.observability.sources import (
        observability_of_pipeline,
        observability_of_run,
    )

    wanted = {
        "mass centre": mass_centre_sd_m,
        "attitude": None if attitude_sd_deg is None else math.radians(attitude_sd_deg),
        "inertia ratios": inertia_ratio_sd,
    }
    goals = {name: value for name, value in wanted.items() if value is not None}
    if Path(subject).is_dir():
        report = observability_of_run(Path(subject), goals)
    else:
        path, content = named_pipeline(subject)
        mesh = content.target_mesh
        found = None if mesh is None else mesh_of_pipeline(path, mesh)
        report = observability_of_pipeline(content, path, found, wanted=goals)
    # Numbers cut short would be worse than lines that wrap.
    console = Console(width=max(Console().width, 120))
    for table in report.tables():
        console.print(table.to_rich())
