"""``pcnav target``: what a mesh offers to be recognised by."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from pcnav.cli.names import named_mesh
from pcnav.cli.options import Overwrite
from pcnav.core.errors import InputError

if TYPE_CHECKING:
    pass


def target(
    mesh: Annotated[str, typer.Argument(help="STL, PLY, OBJ or GLB file, or a shipped name.")],
    out: Annotated[
        Path | None, typer.Option("-o", "--out", help="Also write the catalogue as TOML.")
    ] = None,
    overwrite: Overwrite = False,
) -> None:
    """Print the rectangle catalogue, symmetry group and mass properties of a mesh.

    Example: `pcnav target boxsat -o boxsat.toml`
    """
    from rich.console import Console

    from pcnav.target.satellite import describe, load_target, write_target_toml

    if out is not None and out.exists() and not (overwrite and out.is_file()):
        raise InputError(out, "file", "expected a new file; --overwrite replaces an existing one")
    satellite = load_target(named_mesh(mesh))
    if out is not None:
        out.parent.mkdir(parents=True, exist_ok=True)
        write_target_toml(satellite, out)
    Console().print(*describe(satellite), sep="\n")
    if out is not None:
        typer.echo(f"catalogue: {out}")
