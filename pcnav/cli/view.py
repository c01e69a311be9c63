"""``pcnav view``: a run in the browser."""

from contextlib import suppress
from pathlib import Path
from typing import Annotated

import typer


def view(
    runs: Annotated[
        list[Path], typer.Argument(help="Result folder of a run; a second one is laid over it.")
    ],
    port: Annotated[int, typer.Option(help="A taken port moves up.")] = 8080,
    host: Annotated[
        str, typer.Option(help="Address to serve on; the default is this machine alone.")
    ] = "127.0.0.1",
    frame: Annotated[int | None, typer.Option(min=0, help="Frame to open at.")] = None,
) -> None:
    """Look at a run in the browser: cloud, rectangles and the estimated satellite over time.

    Example: `pcnav view runs/demo/result`
    """
    from pcnav.viewer.app import serve
    from pcnav.viewer.source import FinishedRuns
    from pcnav.viewer.story import load_story

    stories = tuple(load_story(run) for run in runs)
    for story in stories:
        for note in story.notes:
            typer.echo(f"{story.name}: {note}")
    server = serve(FinishedRuns(stories), host, port, frame)
    if host != "127.0.0.1":
        typer.echo(f"open to every machine that reaches {host}: anyone there can look at this run")
    typer.echo(f"view: http://{host}:{server.get_port()}  (Ctrl-C ends it)")
    with suppress(KeyboardInterrupt):
        server.sleep_forever()
