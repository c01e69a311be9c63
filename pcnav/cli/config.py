"""``pcnav config``: a pipeline file with every key explained."""

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
    from pcnav.files.toml_file import tables_of

    if name is None or name in tables_of(Pipeline):
        typer.echo(commented_toml(Pipeline(), name), nl=False)
        return
    path, pipeline = named_pipeline(name)
    typer.echo(commented_toml(pipeline, values=f"the value of {path.name}"), nl=False)
