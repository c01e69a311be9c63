"""``pcnav config``: a pipeline file with every key explained."""

from difflib import get_close_matches
from pathlib import Path
from typing import Annotated

import typer


def config(
    name: Annotated[
        str | None,
        typer.Argument(
            help="A shipped pipeline or a file, whose values are shown; or one table, as filter."
        ),
    ] = None,
) -> None:
    """Print a pipeline file with every key, its value and what it means.

    Examples: `pcnav config > my.toml`, `pcnav config boxsat`, `pcnav config filter`
    """
    from pcnav.cli.names import named_pipeline
    from pcnav.config.commented import commented_toml
    from pcnav.config.pipeline_file import Pipeline
    from pcnav.config.shipped import shipped_pipeline_names
    from pcnav.core.errors import InputError
    from pcnav.files.toml_file import tables_of

    if name is None or name in tables_of(Pipeline):
        typer.echo(commented_toml(Pipeline(), name), nl=False)
        return
    known = (*tables_of(Pipeline), *shipped_pipeline_names())
    near = get_close_matches(name, known, n=1)
    if near and name not in known and not Path(name).exists():
        expected = f"expected a file, a pipeline or a table; did you mean {near[0]}?"
        raise InputError(name, "name", expected)
    path, pipeline = named_pipeline(name)
    typer.echo(commented_toml(pipeline, values=f"the value of {path.name}"), nl=False)
