"""``pcnav target``: what a mesh offers to be recognised by."""

import logging
from pathlib import Path
from typing import Annotated

import typer

from pcnav.cli import completion
from pcnav.cli.names import named_mesh
from pcnav.cli.options import MeshUnit, Overwrite
from pcnav.core.errors import InputError

_LOG = logging.getLogger("pcnav")


_PICTURE, _CATALOGUE = ".png", ".toml"


def target(
    mesh: Annotated[
        str,
        typer.Argument(
            help="Mesh of any common format, or a shipped name.", autocompletion=completion.meshes
        ),
    ],
    out: Annotated[
        list[Path] | None,
        typer.Option(
            "-o", "--out", help="Also write the catalogue (.toml), or a picture (.png); repeatable."
        ),
    ] = None,
    mesh_unit: MeshUnit = None,
    overwrite: Overwrite = False,
) -> None:
    """Print the rectangle catalogue, symmetry group and mass properties of a mesh, and draw it.

    Example: `pcnav target boxsat -o boxsat.toml -o boxsat.png`
    """
    from rich.console import Console

    from pcnav.files.new_file import refuse_existing, write_whole
    from pcnav.target.satellite import describe, load_target, write_target_toml

    for path in out or ():
        refuse_existing(path, overwrite)
        if path.suffix.lower() not in (_PICTURE, _CATALOGUE):
            expected = f"expected a name ending in {_CATALOGUE} or {_PICTURE}"
            raise InputError(path, "--out", expected)
    satellite = load_target(named_mesh(mesh), mesh_unit)
    Console().print(*describe(satellite), sep="\n")
    for path in out or ():
        if path.suffix.lower() == _CATALOGUE:
            path.parent.mkdir(parents=True, exist_ok=True)
            write_target_toml(satellite, path)
            typer.echo(f"catalogue: {path}")
            continue
        from pcnav.report.target_picture import png_of, target_picture

        write_whole(path, png_of(target_picture(satellite)))
        typer.echo(f"picture: {path}")
    if satellite.mesh_origin.unit_doubt is not None:
        _LOG.warning("%s: the mesh is %s", mesh, satellite.mesh_origin.unit_doubt)
