"""``pcnav target``: what a mesh offers to be recognised by."""

import logging
from pathlib import Path
from typing import Annotated

import typer

from pcnav.cli.names import named_mesh
from pcnav.cli.options import MeshUnit, Overwrite
from pcnav.core.errors import InputError

_LOG = logging.getLogger("pcnav")


def target(
    mesh: Annotated[str, typer.Argument(help="Mesh of any common format, or a shipped name.")],
    out: Annotated[
        Path | None, typer.Option("-o", "--out", help="Also write the catalogue as TOML.")
    ] = None,
    mesh_unit: MeshUnit = None,
    overwrite: Overwrite = False,
) -> None:
    """Print the rectangle catalogue, symmetry group and mass properties of a mesh.

    Example: `pcnav target boxsat -o boxsat.toml`
    """
    from rich.console import Console

    from pcnav.target.satellite import describe, load_target, write_target_toml

    if out is not None and out.exists() and not (overwrite and out.is_file()):
        raise InputError(out, "file", "expected a new file; --overwrite replaces an existing one")
    satellite = load_target(named_mesh(mesh), mesh_unit)
    if out is not None:
        out.parent.mkdir(parents=True, exist_ok=True)
        write_target_toml(satellite, out)
    Console().print(*describe(satellite), sep="\n")
    if out is not None:
        typer.echo(f"catalogue: {out}")
    if satellite.mesh_origin.unit_doubt is not None:
        _LOG.warning("%s: the mesh is %s", mesh, satellite.mesh_origin.unit_doubt)
