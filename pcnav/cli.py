"""The command line: each command parses, calls one function and prints its summary."""

import logging
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from pcnav import __version__
from pcnav.errors import InputError

if TYPE_CHECKING:  # heavy imports sit inside the commands, so that --help answers at once
    from pcnav.config import Pipeline

app = typer.Typer(
    help="Pose, motion, mass centre and inertia of a tumbling satellite from depth frames.",
    no_args_is_help=True,
    rich_markup_mode="markdown",
    pretty_exceptions_enable=False,
)

_Overwrite = Annotated[bool, typer.Option("--overwrite", help="Replace an existing output.")]
_Advance = Callable[[int, int], None]
_BAD_INPUT = 2


def main() -> None:
    """Entry point: bad input is one line on stderr and exit code 2, never a traceback."""
    logging.basicConfig(level=logging.WARNING, format="%(levelname)s: %(message)s")
    logging.getLogger("pcnav").setLevel(logging.INFO)
    try:
        app()
    except InputError as error:
        typer.echo(f"error: {error}", err=True)
        raise SystemExit(_BAD_INPUT) from None


def _print_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"pcnav {__version__}")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool,
        typer.Option(
            "--version", callback=_print_version, is_eager=True, help="Print the version."
        ),
    ] = False,
) -> None:
    """Options that stand before a command."""


@app.command()
def demo(
    out: Annotated[Path, typer.Option("-o", "--out", help="Where to put both folders.")] = Path(
        "runs/demo"
    ),
) -> None:
    """Simulate the shipped satellite, navigate, print the table and write the report.

    Example: `pcnav demo`
    """
    sequence, result = out / "sequence", out / "result"
    _simulate("demo", sequence, overwrite=True)
    _run(sequence, None, "demo", result, overwrite=True)


@app.command()
def simulate(
    pipeline: Annotated[str, typer.Argument(help="Pipeline file, or the name of a shipped one.")],
    out: Annotated[Path, typer.Option("-o", "--out", help="Folder of the sequence.")],
    overwrite: _Overwrite = False,
) -> None:
    """Write the depth sequence and the truth of a pipeline's scenario.

    Example: `pcnav simulate boxsat -o runs/boxsat`
    """
    _simulate(pipeline, out, overwrite)


@app.command()
def run(
    sequence: Annotated[Path, typer.Argument(help="Folder of a depth sequence.")],
    out: Annotated[Path, typer.Option("-o", "--out", help="Result folder.")],
    target: Annotated[
        str | None, typer.Option(help="Mesh of the target, or the name of a shipped one.")
    ] = None,
    pipeline: Annotated[
        str | None, typer.Option(help="Pipeline file, or the name of a shipped one.")
    ] = None,
    overwrite: _Overwrite = False,
) -> None:
    """Estimate pose, motion, mass centre and inertia ratios from a depth sequence.

    Example: `pcnav run runs/boxsat -o runs/boxsat-result`
    """
    _run(sequence, target, pipeline, out, overwrite)


@app.command()
def target(
    mesh: Annotated[str, typer.Argument(help="STL, PLY, OBJ or GLB file, or a shipped name.")],
    out: Annotated[
        Path | None, typer.Option("-o", "--out", help="Also write the catalogue as TOML.")
    ] = None,
) -> None:
    """Print the rectangle catalogue, symmetry group and mass properties of a mesh.

    Example: `pcnav target boxsat -o boxsat.toml`
    """
    from rich.console import Console

    from pcnav.target import describe, load_target, write_target_toml

    satellite = load_target(_mesh(mesh))
    Console().print(describe(satellite))
    if out is not None:
        write_target_toml(satellite, out)
        typer.echo(f"catalogue: {out}")


@app.command()
def study(
    name: Annotated[str, typer.Argument(help="yu2019")],
    out: Annotated[Path, typer.Option("-o", "--out", help="Folder of tables and figures.")],
    runs: Annotated[
        int | None, typer.Option(help="Monte Carlo runs, instead of the study's own number.")
    ] = None,
    overwrite: _Overwrite = False,
) -> None:
    """Rebuild a paper's tables and figures, the paper's value beside ours.

    Example: `pcnav study yu2019 -o runs/yu2019`
    """
    from rich.console import Console

    from pcnav.studies import run_study

    with _progress(f"study {name}") as advance:
        summary = run_study(name, out, runs=runs, overwrite=overwrite, on_progress=advance)
    console = Console()
    for table in summary.tables:
        console.print(table)
    typer.echo(f"tables and figures: {summary.page}")


def _simulate(pipeline: str, out: Path, overwrite: bool) -> None:
    from pcnav.simulation.recording import simulate as write_sequence
    from pcnav.target import load_target

    path, content = _pipeline(pipeline)
    if content.target_mesh is None:
        raise InputError(path, "target_mesh", "expected the mesh of the satellite to simulate")
    satellite = load_target(_mesh(content.target_mesh, path.parent))
    with _progress("simulate") as advance:
        summary = write_sequence(content, satellite, out, overwrite, advance, path)
    typer.echo(f"sequence: {summary.path} ({summary.frames} frames)")


def _run(
    sequence: Path, target_mesh: str | None, pipeline: str | None, out: Path, overwrite: bool
) -> None:
    from rich.console import Console

    from pcnav.config import Pipeline
    from pcnav.evaluation.summary import summary_table
    from pcnav.pipeline import run as run_sequence

    content = Pipeline() if pipeline is None else _pipeline(pipeline)[1]
    mesh = None if target_mesh is None else _mesh(target_mesh)
    with _progress("run") as advance:
        summary = run_sequence(
            sequence,
            out,
            content,
            target_mesh=mesh,
            overwrite=overwrite,
            on_estimate=lambda estimate, total: advance(estimate.index + 1, total),
        )
    Console().print(summary_table(summary.metrics))
    typer.echo(f"report: {summary.report}")
    typer.echo(f"web view: pcnav view {summary.folder}")


def _pipeline(name: str) -> "tuple[Path, Pipeline]":
    """A pipeline by path or shipped name."""
    from pcnav.config import read_pipeline
    from pcnav.shipped import shipped_pipeline, shipped_pipeline_names

    path = Path(name)
    if not path.is_file():
        shipped = shipped_pipeline(name)
        if shipped is None:
            known = ", ".join(shipped_pipeline_names())
            raise InputError(path, "pipeline", f"expected a TOML file or one of: {known}")
        path = shipped
    return path, read_pipeline(path)


def _mesh(name: str, folder: Path = Path()) -> Path:
    """A mesh by path, relative to a folder, or by shipped name."""
    from pcnav.shipped import shipped_mesh, shipped_mesh_names

    path = folder / name
    if path.is_file():
        return path
    shipped = shipped_mesh(name)
    if shipped is None:
        known = ", ".join(shipped_mesh_names())
        raise InputError(path, "mesh", f"expected a mesh file or one of: {known}")
    return shipped


@contextmanager
def _progress(title: str) -> Iterator[_Advance]:
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeRemainingColumn,
    )

    columns = (TextColumn(title), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(title, total=None)

        def advance(done: int, total: int) -> None:
            bar.update(task, completed=done, total=total)

        yield advance
