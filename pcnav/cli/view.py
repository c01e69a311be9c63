"""``pcnav view``: a run in the browser."""

import socket
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from pcnav.cli.options import Overwrite, Port
from pcnav.cli.progress import progress
from pcnav.core.errors import InputError

if TYPE_CHECKING:
    from pcnav.viewer.server import LocalServer
    from pcnav.viewer.story import Story

_LOOPBACK = "127.0.0.1"
_MAX_RUNS = 2
_SUFFIXES = {"html": (".html", ".htm"), "png": (".png",), "recording": (".viser",)}


def view(
    runs: Annotated[
        list[Path], typer.Argument(help="Result folder of a run; a second one is laid over it.")
    ],
    port: Port = 8080,
    host: Annotated[
        str, typer.Option(help="Address to serve on; the default is this machine alone.")
    ] = _LOOPBACK,
    frame: Annotated[
        int | None, typer.Option(min=0, help="Frame to open at, or to export.")
    ] = None,
    html: Annotated[
        Path | None, typer.Option(help="Write a page of one frame that opens offline, and end.")
    ] = None,
    png: Annotated[
        Path | None, typer.Option(help="Write a picture of one frame, and end; needs a Chromium.")
    ] = None,
    recording: Annotated[
        Path | None, typer.Option(help="Write a recording (.viser) of the run, and end.")
    ] = None,
    overwrite: Overwrite = False,
) -> None:
    """Look at a run in the browser: cloud, rectangles and the estimated satellite over time.

    Examples: `pcnav view runs/demo/result`, `pcnav view runs/old runs/new`,
    `pcnav view runs/demo/result --frame 100 --png frame.png`, `pcnav view run.viser`
    """
    _refuse_foreign(host)
    if len(runs) > _MAX_RUNS:
        raise InputError("pcnav view", "runs", f"expected at most {_MAX_RUNS}, got {len(runs)}")
    exports = {"html": html, "png": png, "recording": recording}
    asked = {kind: path for kind, path in exports.items() if path is not None}
    if len(runs) == 1 and runs[0].suffix == ".viser" and runs[0].is_file():
        if asked:
            expected = "expected a result folder: pictures and pages are made of runs"
            raise InputError(runs[0], f"--{next(iter(asked))}", expected)
        _play(runs[0], host, port)
        return
    from pcnav.viewer.folder import refuse_what_is_no_run

    for run in runs:
        refuse_what_is_no_run(run)
    if asked:
        _export(runs, asked, frame, overwrite)
        return
    from pcnav.viewer.server import LocalServer, label_of

    # First of all, so that the page loads in the browser while the run is read.
    server = LocalServer(host, port, label_of([run.resolve().name for run in runs]))
    tell_address(server, host, port)
    try:
        from pcnav.viewer.app import show
        from pcnav.viewer.source import FinishedRuns

        show(server, FinishedRuns(_told(runs)), frame)
    except BaseException:
        server.stop()
        raise
    serve_until_interrupted(server)


def _refuse_foreign(host: str) -> None:
    """An address that this machine has not would never be served on."""
    try:
        address = socket.getaddrinfo(host, 0, type=socket.SOCK_STREAM)[0]
        with socket.socket(address[0], socket.SOCK_STREAM) as trial:
            trial.bind(address[4])
    except OSError as error:
        expected = f"expected an address of this machine, got {host} ({error.strerror})"
        raise InputError("pcnav view", "--host", expected) from error


def _told(runs: list[Path]) -> "tuple[Story, ...]":
    """Read the runs, and say what should be known before looking at them."""
    from pcnav.viewer.story import load_story

    stories = tuple(load_story(run) for run in runs)
    for story in stories:
        for note in story.notes:
            typer.echo(f"{story.name}: {note}")
    return stories


def tell_address(server: "LocalServer", host: str, asked_port: int) -> None:
    """Say where the view is, and to whom it is open."""
    if server.get_port() != asked_port:
        typer.echo(f"port {asked_port} is taken: {server.get_port()} instead")
    if host != _LOOPBACK:
        typer.echo(f"open to every machine that reaches {host}: anyone there can look at this run")
    typer.echo(f"view: http://{host}:{server.get_port()}  (Ctrl-C ends it)")


def serve_until_interrupted(server: "LocalServer") -> None:
    """Keep the process alive for its view."""
    typer.echo("the view stays open until Ctrl-C")
    with suppress(KeyboardInterrupt):
        server.sleep_forever()
    server.stop()


def _export(runs: list[Path], asked: dict[str, Path], frame: int | None, overwrite: bool) -> None:
    from pcnav.viewer.export import export, refuse_existing, shown_frame

    for kind, path in asked.items():
        if path.suffix.lower() not in _SUFFIXES[kind]:
            raise InputError(path, f"--{kind}", f"expected a name ending in {_SUFFIXES[kind][0]}")
        refuse_existing(path, overwrite)
    stories = _told(runs)
    at = shown_frame(stories[0], frame)
    with progress("view") as advance:
        for kind, path in asked.items():
            size = export(kind, stories, at, path, advance)
            typer.echo(f"{kind}: {path} ({size / 1e6:.1f} MB)")


def _play(recording: Path, host: str, port: int) -> None:
    """Show a recording."""
    from pcnav.viewer.playback import serve_recording

    server = serve_recording(recording, host, port)
    typer.echo(f"view: http://{host}:{server.server_port}  (Ctrl-C ends it)")
    with suppress(KeyboardInterrupt):
        server.serve_forever()
    server.server_close()
