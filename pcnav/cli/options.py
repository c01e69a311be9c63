"""Options that more than one command has."""

from typing import Annotated

import typer

from pcnav.config.length_unit import LengthUnit

Overwrite = Annotated[bool, typer.Option("--overwrite", help="Replace an existing output.")]

Jobs = Annotated[
    int | None,
    typer.Option("--jobs", help="Processes of this machine; one per core (at most 8) if not told."),
]
Scheduler = Annotated[
    str | None,
    typer.Option(
        "--scheduler", help="Use the workers of a dask scheduler instead: tcp://host:8786."
    ),
]
MeshUnit = Annotated[
    LengthUnit | None,
    typer.Option("--mesh-unit", help="Unit of the mesh; else as its file says, else m."),
]
Port = Annotated[
    int,
    typer.Option("--port", min=0, max=65535, help="Of the view; a taken port moves up, 0 is any."),
]
