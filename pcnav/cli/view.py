"""``pcnav view``: a run in the browser."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    pass


from contextlib import suppress


def view(
    result: Annotated[Path, typer.Argument(help="Result folder of a run.")],
    port: Annotated[int, typer.Option(help="A taken port moves up.")] = 8080,
    host: Annotated[
        str, typer.Option(help="Address to serve on; the default is this machine alone.")
    ] = "127.0.0.1",
) -> None:
    """Look at a run in the browser: cloud, rectangles and the estimated satellite over time.

    Example: `pcnav view runs/demo/result`
    """
    from pcnav.viewer.app import load_run, serve

    server = serve(load_run(result), host, port)
    if host != "127.0.0.1":
        typer.echo(f"open to every machine that reaches {host}: anyone there can look at this run")
    typer.echo(f"view: http://{host}:{server.get_port()}  (Ctrl-C ends it)")
    with suppress(KeyboardInterrupt):
        server.sleep_forever()
