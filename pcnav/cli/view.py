"""``pcnav view``: a run in the browser."""

import socket
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from pcnav.cli.options import Overwrite, Port
from pcnav.cli.progress import progress
from pcnav.core._extras import require_view
from pcnav.core.errors import InputError

if TYPE_CHECKING:
    from pcnav.viewer.assessment import Opening
    from pcnav.viewer.loaded_run import LoadedRun
    from pcnav.viewer.server import LocalServer

_LOOPBACK = "127.0.0.1"
_THIS_MACHINE = {_LOOPBACK, "localhost", "::1"}
_MAX_RUNS = 2


def view(
    runs: Annotated[
        list[Path], typer.Argument(help="Result folder of a run; a second one is laid over it.")
    ],
    sequence: Annotated[
        Path | None,
        typer.Option(help="Where the recording is, if not where the result says; of the first."),
    ] = None,
    port: Port = 8080,
    host: Annotated[
        str, typer.Option(help="Address to serve on; the default is this machine alone.")
    ] = _LOOPBACK,
    frame: Annotated[
        int | None, typer.Option(min=0, help="Frame to open at, or to export.")
    ] = None,
    worst: Annotated[
        bool,
        typer.Option("--worst", help="Open at the largest error over sigma, not the last claim."),
    ] = False,
    html: Annotated[
        Path | None, typer.Option(help="Write a page of one frame that opens offline, and end.")
    ] = None,
    png: Annotated[
        Path | None, typer.Option(help="Write a picture of one frame, and end; needs a Chromium.")
    ] = None,
    recording: Annotated[
        Path | None, typer.Option(help="Write a recording (.viser) of the run, and end.")
    ] = None,
    rrd: Annotated[
        Path | None,
        typer.Option(help="Write a recording of rerun of the run, and end; needs the extra rerun."),
    ] = None,
    overwrite: Overwrite = False,
) -> None:
    """Look at a run in the browser: cloud, rectangles and the estimated satellite over time.

    Examples: `pcnav view runs/demo/result`, `pcnav view runs/old runs/new`,
    `pcnav view runs/demo/result --frame 100 --png frame.png`, `pcnav view run.viser`
    """
    require_view("pcnav view")
    _refuse_foreign(host)
    if len(runs) > _MAX_RUNS:
        raise InputError("pcnav view", "runs", f"expected at most {_MAX_RUNS}, got {len(runs)}")
    if worst and frame is not None:
        raise InputError("pcnav view", "--worst", "expected it or --frame, got both")
    exports = {"html": html, "png": png, "recording": recording, "rrd": rrd}
    asked = {kind: path for kind, path in exports.items() if path is not None}
    if len(runs) == 1 and runs[0].suffix == ".viser" and runs[0].is_file():
        if asked:
            expected = "expected a result folder: pictures and pages are made of runs"
            raise InputError(runs[0], f"--{next(iter(asked))}", expected)
        _play(runs[0], host, port)
        return
    for run in runs:
        refuse_what_is_no_run(run)
    from pcnav.viewer.assessment import Opening

    opening = frame if frame is not None else Opening.WORST if worst else Opening.LAST
    if asked:
        _export(runs, asked, opening, overwrite, sequence)
        return
    from pcnav.viewer.memory import give_back_large_arrays
    from pcnav.viewer.server import LocalServer, label_of

    give_back_large_arrays()
    # First of all, so that the page loads in the browser while the run is read.
    server = LocalServer(host, port, label_of([run.resolve().name for run in runs]))
    tell_address(server, host, port)
    try:
        from pcnav.viewer.app import show
        from pcnav.viewer.loaded_run import finished

        loaded = _loaded(runs, sequence)
        _tell_unknown_worst(loaded[0], opening)
        show(server, finished(*loaded), opening)
    except BaseException:
        server.stop()
        raise
    serve_until_interrupted(server)


def refuse_what_is_no_run(folder: Path) -> None:
    """Raise `InputError` unless a folder holds a run, finished or not; at once, without reading."""
    from pcnav.runs.result_files import STATES_FILE

    if (folder / STATES_FILE).is_file():
        return
    if folder.is_dir():
        raise InputError(folder / STATES_FILE, "file", "expected a result folder, which has one")
    staged = sorted(folder.parent.glob(f".{folder.name}-*")) if folder.parent.is_dir() else []
    expected = "expected a result folder of pcnav run"
    if staged:
        expected = f"expected a result folder; an unfinished run of this name is {staged[-1]}"
    raise InputError(folder, "folder", expected)


def _refuse_foreign(host: str) -> None:
    """An address that this machine has not would never be served on."""
    try:
        address = socket.getaddrinfo(host, 0, type=socket.SOCK_STREAM)[0]
        with socket.socket(address[0], socket.SOCK_STREAM) as trial:
            trial.bind(address[4])
    except OSError as error:
        expected = f"expected an address of this machine, got {host} ({error.strerror})"
        raise InputError("pcnav view", "--host", expected) from error


def _loaded(runs: list[Path], sequence: Path | None) -> "tuple[LoadedRun, ...]":
    """Read the runs, and say what should be known before looking at them."""
    from pcnav.viewer.loading import load_run

    loaded = tuple(load_run(run, sequence if run is runs[0] else None) for run in runs)
    for run in loaded:
        for note in run.notes:
            typer.echo(f"{run.name}: {note}")
    return loaded


def _tell_unknown_worst(loaded: "LoadedRun", opening: "int | Opening") -> None:
    from pcnav.viewer.assessment import Opening, worst_frame

    if opening is Opening.WORST and worst_frame(loaded) is None:
        typer.echo(
            f"{loaded.name}: no error is known, so none is the worst: the last claim is shown"
        )


def tell_address(server: "LocalServer", host: str, asked_port: int) -> None:
    """Say where the view is, and to whom it is open."""
    if server.get_port() != asked_port:
        typer.echo(f"port {asked_port} is taken: {server.get_port()} instead")
    _tell_open_host(host)
    typer.echo(f"view: http://{host}:{server.get_port()}  (Ctrl-C ends it)")


def _tell_open_host(host: str) -> None:
    if host not in _THIS_MACHINE:
        typer.echo(f"open to every machine that reaches {host}: anyone there can look at this run")


def serve_until_interrupted(server: "LocalServer") -> None:
    """Keep the process alive for its view."""
    typer.echo("the view stays open until Ctrl-C")
    with suppress(KeyboardInterrupt):
        server.sleep_forever()
    server.stop()


def _export(
    runs: list[Path],
    asked: dict[str, Path],
    frame: "int | Opening",
    overwrite: bool,
    sequence: Path | None,
) -> None:
    from pcnav.files.new_file import refuse_existing, write_whole
    from pcnav.viewer.export import (
        SUFFIXES,
        Share,
        exported,
        shown_frame,
    )
    from pcnav.viewer.render_options import RenderOptions

    for kind, path in asked.items():
        suffixes = SUFFIXES[Share[kind.upper()]]
        if path.suffix.lower() not in suffixes:
            raise InputError(path, f"--{kind}", f"expected a name ending in {suffixes[0]}")
        refuse_existing(path, overwrite)
    loaded = _loaded(runs, sequence)
    _tell_unknown_worst(loaded[0], frame)
    at = shown_frame(loaded[0], frame)
    with progress("view") as advance:
        for kind, path in asked.items():
            share = Share[kind.upper()]
            content = exported(share, loaded, at, RenderOptions(), on_frame=advance)
            write_whole(path, content)
            typer.echo(f"{kind}: {path} ({len(content) / 1e6:.1f} MB)")


def _play(recording: Path, host: str, port: int) -> None:
    """Show a recording."""
    from pcnav.viewer.playback import serve_recording

    server = serve_recording(recording, host, port)
    if port and server.server_port != port:
        typer.echo(f"port {port} is taken: {server.server_port} instead")
    _tell_open_host(host)
    typer.echo(f"view: http://{host}:{server.server_port}  (Ctrl-C ends it)")
    with suppress(KeyboardInterrupt):
        server.serve_forever()
    server.server_close()
