"""The command line: each command parses, calls one function and prints its summary."""

import logging
import os
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, cast

import typer

from pcnav import __version__
from pcnav.errors import InputError

if TYPE_CHECKING:  # heavy imports sit inside the commands, so that --help answers at once
    from pcnav.config import Pipeline

app = typer.Typer(
    help="Pose, motion, mass centre and inertia of a tumbling satellite from depth frames.",
    context_settings={"help_option_names": ["-h", "--help"]},
    rich_markup_mode="markdown",
    pretty_exceptions_enable=False,
)

_Overwrite = Annotated[bool, typer.Option("--overwrite", help="Replace an existing output.")]
_Advance = Callable[[int, int], None]
_BAD_INPUT = 2
_INTERRUPTED = 130
# Typer exports this one class of usage errors; its parent stands for every wrong command line.
_UsageError = cast(type[typer.BadParameter], typer.BadParameter.__base__)


def main() -> None:
    """Entry point: whatever goes wrong is one line on stderr and an exit code other than 0.

    2 for bad input, a wrong command line and a file system that refuses; 130 when interrupted.
    """
    # Matrices here are small: threads of the linear algebra cost more than they bring, by factors
    # when the cores are busy. NumPy reads this when it is first imported, inside the commands.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    # A batch system that ends a run must leave no more behind than a user who does.
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        with _log_lines():
            code = app(sys.argv[1:] or ["--help"], standalone_mode=False)
    except KeyboardInterrupt:
        code = _INTERRUPTED
    except _UsageError as error:
        command = "pcnav" if error.ctx is None else error.ctx.command_path
        message = " ".join(error.format_message().split()).rstrip(".")
        code = _failed(f"{message}; see {command} --help")
    except InputError as error:
        code = _failed(str(error))
    except OSError as error:
        expected = f"expected a file system that allows it ({error.strerror or error})"
        code = _failed(f"{error.filename or 'output'}: file: {expected}")
    if code == _INTERRUPTED:
        print("interrupted: nothing is left half-written", file=sys.stderr)
    raise SystemExit(code)


def _failed(message: str) -> int:
    print(f"error: {message}", file=sys.stderr)
    return _BAD_INPUT


class _LogLines(logging.Handler):
    """Log lines on stderr, above the progress bar where there is one."""

    def emit(self, record: logging.LogRecord) -> None:
        # Looked up anew each time: a progress bar puts its own stream there while it is shown.
        print(self.format(record), file=sys.stderr)


@contextmanager
def _log_lines() -> Iterator[None]:
    logger, lines = logging.getLogger("pcnav"), _LogLines()
    lines.setFormatter(logging.Formatter("%(levelname)s: %(message)s"))
    logger.setLevel(logging.INFO)
    logger.addHandler(lines)
    try:
        yield
    finally:
        logger.removeHandler(lines)


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
    overwrite: _Overwrite = False,
) -> None:
    """Simulate the shipped satellite, navigate, print the table and write the report.

    Example: `pcnav demo`
    """
    sequence, result = out / "sequence", out / "result"
    # Found out before half of the work is done.
    if result.is_dir() and any(result.iterdir()) and not overwrite:
        raise InputError(result, "folder", "expected a new folder; --overwrite replaces this one")
    _simulate("demo", sequence, overwrite)
    _run(sequence, None, "demo", result, overwrite)


@app.command()
def simulate(
    pipeline: Annotated[str, typer.Argument(help="Pipeline file, or the name of a shipped one.")],
    out: Annotated[Path, typer.Option("-o", "--out", help="Folder of the sequence.")],
    overwrite: _Overwrite = False,
) -> None:
    """Write depth frames, feature tracks or shaded images, and the truth of a pipeline's scenario.

    Which of them follows from the estimator that the pipeline names.

    Example: `pcnav simulate boxsat -o runs/boxsat`
    """
    _simulate(pipeline, out, overwrite)


@app.command()
def run(
    sequence: Annotated[
        Path,
        typer.Argument(
            help="Folder of a depth sequence, of feature tracks or of images of one camera; "
            "or a video."
        ),
    ],
    out: Annotated[Path, typer.Option("-o", "--out", help="Result folder.")],
    target: Annotated[
        str | None,
        typer.Option(
            help="Mesh of the target, or the name of a shipped one; "
            "without it the sequence's own, else the pipeline's."
        ),
    ] = None,
    pipeline: Annotated[
        str | None,
        typer.Option(
            help="File with the settings of the estimator, or the name of a shipped one; "
            "a result's pipeline.toml repeats its run."
        ),
    ] = None,
    overwrite: _Overwrite = False,
) -> None:
    """Estimate pose, motion and mass properties from depth frames, feature tracks or images.

    Stereo tracks need a pipeline with an estimator for them, as hu2024 and segal2011 have. Images
    and tracks of one camera, with its camera.toml, give attitude and rate.

    Example: `pcnav run runs/boxsat -o runs/boxsat-result`
    """
    _run(sequence, target, pipeline, out, overwrite)


@app.command()
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


@app.command()
def target(
    mesh: Annotated[str, typer.Argument(help="STL, PLY, OBJ or GLB file, or a shipped name.")],
    out: Annotated[
        Path | None, typer.Option("-o", "--out", help="Also write the catalogue as TOML.")
    ] = None,
    overwrite: _Overwrite = False,
) -> None:
    """Print the rectangle catalogue, symmetry group and mass properties of a mesh.

    Example: `pcnav target boxsat -o boxsat.toml`
    """
    from rich.console import Console

    from pcnav.target import describe, load_target, write_target_toml

    if out is not None and out.exists() and not (overwrite and out.is_file()):
        raise InputError(out, "file", "expected a new file; --overwrite replaces an existing one")
    satellite = load_target(_mesh(mesh))
    if out is not None:
        out.parent.mkdir(parents=True, exist_ok=True)
        write_target_toml(satellite, out)
    Console().print(*describe(satellite), sep="\n")
    if out is not None:
        typer.echo(f"catalogue: {out}")


@app.command()
def study(
    name: Annotated[
        str, typer.Argument(help="applsci2022, deng2024, hu2024, segal2011, tracking or yu2019")
    ],
    out: Annotated[Path, typer.Option("-o", "--out", help="Folder of tables and figures.")],
    runs: Annotated[
        int | None, typer.Option(help="Monte Carlo runs, instead of the study's own number.")
    ] = None,
    overwrite: _Overwrite = False,
) -> None:
    """Rebuild a study's tables and figures: a paper's, or the tracker's own.

    Example: `pcnav study yu2019 -o runs/yu2019`
    """
    from rich.console import Console

    from pcnav.studies import run_study

    with _progress(f"study {name}") as advance:
        summary = run_study(name, out, runs=runs, overwrite=overwrite, on_progress=advance)
    # Numbers cut short would be worse than lines that wrap.
    console = Console(width=max(Console().width, 120))
    for table in summary.tables:
        console.print(table)
    typer.echo(f"tables and figures: {summary.page}")


@app.command()
def observability(
    subject: Annotated[
        str, typer.Argument(help="Result folder, pipeline file, or the name of a shipped pipeline.")
    ],
    mass_centre_sd_m: Annotated[
        float | None, typer.Option(min=1e-9, help="Wanted standard deviation of the mass centre.")
    ] = None,
    attitude_sd_deg: Annotated[
        float | None, typer.Option(min=1e-9, help="Wanted of the attitude, about each axis.")
    ] = None,
    inertia_ratio_sd: Annotated[
        float | None, typer.Option(min=1e-9, help="Wanted of each inertia ratio.")
    ] = None,
) -> None:
    """Print which states a motion makes observable, the weakest directions, and how soon.

    Example: `pcnav observability boxsat`
    """
    import math

    from rich.console import Console

    from pcnav.observability.sources import observability_of_pipeline, observability_of_run

    wanted = {
        "mass centre": mass_centre_sd_m,
        "attitude": None if attitude_sd_deg is None else math.radians(attitude_sd_deg),
        "inertia ratios": inertia_ratio_sd,
    }
    goals = {name: value for name, value in wanted.items() if value is not None}
    if Path(subject).is_dir():
        report = observability_of_run(Path(subject), goals)
    else:
        path, content = _pipeline(subject)
        mesh = content.target_mesh
        found = None if mesh is None else _mesh_of_pipeline(path, mesh)
        report = observability_of_pipeline(content, path, found, wanted=goals)
    # Numbers cut short would be worse than lines that wrap.
    console = Console(width=max(Console().width, 120))
    for table in report.tables():
        console.print(table.to_rich())


def _simulate(pipeline: str, out: Path, overwrite: bool) -> None:
    from pcnav.config_features import EstimatorKind

    path, content = _pipeline(pipeline)
    if content.estimator.kind is EstimatorKind.IMAGE_MOTION:
        _simulate_images(path, content, out, overwrite)
        return
    if content.estimator.kind is not EstimatorKind.DEPTH:
        from pcnav.simulation.feature_recording import simulate_tracks

        typer.echo(simulate_tracks(content, out, overwrite, path).text)
        return
    from pcnav.simulation.recording import simulate as write_sequence
    from pcnav.target import load_target

    if content.target_mesh is None:
        raise InputError(path, "target_mesh", "expected the mesh of the satellite to simulate")
    satellite = load_target(_mesh_of_pipeline(path, content.target_mesh))
    with _progress("simulate") as advance:
        summary = write_sequence(content, satellite, out, overwrite, advance, path)
    typer.echo(
        f"sequence: {summary.path} ({summary.frames} frames, {summary.median_returns} returns each)"
    )


def _simulate_images(path: Path, pipeline: "Pipeline", out: Path, overwrite: bool) -> None:
    from pcnav.simulation.image_recording import simulate_images

    name = pipeline.target_mesh
    mesh = None if name is None else _mesh_of_pipeline(path, name)
    with _progress("simulate") as advance:
        summary = simulate_images(pipeline, out, overwrite, path, mesh, advance)
    typer.echo(summary.text)


def _run(
    sequence: Path, target_mesh: str | None, pipeline: str | None, out: Path, overwrite: bool
) -> None:
    from rich.console import Console

    from pcnav.config import Pipeline
    from pcnav.config_features import EstimatorKind
    from pcnav.evaluation.summary import summary_table
    from pcnav.image_pipeline import is_seen_by_one_camera
    from pcnav.sequences.monocular import CAMERA_FILE
    from pcnav.sequences.track_files import TRACKS_FILE, is_track_recording

    path, content = Path("pipeline"), Pipeline()
    if pipeline is not None:
        path, content = _pipeline(pipeline)
    by_images = content.estimator.kind is EstimatorKind.IMAGE_MOTION
    if by_images or is_seen_by_one_camera(sequence):
        if pipeline is not None and not by_images:
            expected = f'expected "{EstimatorKind.IMAGE_MOTION}" for images of one camera'
            raise InputError(path, "estimator.kind", f'{expected}, got "{content.estimator.kind}"')
        if target_mesh is not None:
            raise InputError(sequence, "--target", "expected none: images of one camera need none")
        _run_images(sequence, content, out, overwrite)
        return
    if is_track_recording(sequence):
        if pipeline is None:
            expected = "expected one with an estimator for stereo tracks, as hu2024 or segal2011"
            beside = f"; tracks of one camera have {CAMERA_FILE} beside them"
            raise InputError(sequence, "--pipeline", expected + beside)
        if target_mesh is not None:
            raise InputError(sequence, "--target", "expected none: feature tracks need no mesh")
        _run_tracks(sequence, path, content, out, overwrite)
        return
    if content.estimator.kind is not EstimatorKind.DEPTH:
        kind, expected = (
            content.estimator.kind,
            f"expected a folder with {TRACKS_FILE}, or that file",
        )
        raise InputError(sequence, "folder", f'{expected}, for the estimator "{kind}" of {path}')
    from pcnav.pipeline import run as run_sequence

    if content.target_mesh is not None and target_mesh is None:
        mesh = _mesh_of_pipeline(path, content.target_mesh)
        content = content.model_copy(update={"target_mesh": str(mesh)})
    with _progress("run") as advance:
        summary = run_sequence(
            sequence,
            out,
            content,
            target_mesh=None if target_mesh is None else _mesh(target_mesh),
            overwrite=overwrite,
            on_estimate=lambda estimate, total: advance(estimate.index + 1, total),
        )
    Console().print(summary_table(summary.metrics, summary.knowledge))
    typer.echo(f"report: {summary.report}")
    typer.echo(f"web view: pcnav view {summary.folder}")


def _run_tracks(
    recording: Path, path: Path, pipeline: "Pipeline", out: Path, overwrite: bool
) -> None:
    from rich.console import Console

    from pcnav.evaluation.summary import summary_table
    from pcnav.feature_pipeline import run_features

    with _progress("run") as advance:
        summary = run_features(
            recording,
            out,
            pipeline,
            overwrite=overwrite,
            on_estimate=lambda _, done, total: advance(done, total),
            source=path,
        )
    Console().print(summary_table(summary.metrics))
    typer.echo(f"report: {summary.report}")


def _run_images(recording: Path, pipeline: "Pipeline", out: Path, overwrite: bool) -> None:
    from rich.console import Console

    from pcnav.evaluation.summary import summary_table
    from pcnav.image_pipeline import run_images

    with _progress("run") as advance:
        summary = run_images(
            recording,
            out,
            pipeline,
            overwrite=overwrite,
            on_frame=lambda _, done, total: advance(done, total),
        )
    Console().print(summary_table(summary.metrics))
    typer.echo(f"report: {summary.report}")


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


def _mesh(name: str) -> Path:
    """A mesh by path or shipped name."""
    from pcnav.shipped import shipped_mesh

    path = Path(name)
    found = path if path.is_file() else shipped_mesh(name)
    if found is None:
        raise InputError(path, "mesh", _known_meshes())
    return found


def _mesh_of_pipeline(pipeline: Path, name: str) -> Path:
    """The mesh a pipeline file names: a path relative to the file, or a shipped name."""
    from pcnav.shipped import shipped_mesh

    path = pipeline.parent / name
    found = path if path.is_file() else shipped_mesh(name)
    if found is None:
        raise InputError(pipeline, "target_mesh", f"{_known_meshes()}, got {name}")
    return found


def _known_meshes() -> str:
    from pcnav.shipped import shipped_mesh_names

    return f"expected a mesh file or one of: {', '.join(shipped_mesh_names())}"


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
    # What is not a terminal keeps every frame of a bar: a log file gets none.
    hidden = not sys.stderr.isatty()
    with Progress(*columns, console=Console(stderr=True), transient=True, disable=hidden) as bar:
        task = bar.add_task(title, total=None)

        def advance(done: int, total: int) -> None:
            bar.update(task, completed=done, total=total)

        yield advance
