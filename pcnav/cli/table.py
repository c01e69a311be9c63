"""``pcnav table``: accuracy tables over a grid of cases, and what changed from one to another."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from pcnav.batch.process import one_thread_each
from pcnav.cli.options import Jobs, MeshUnit, Overwrite, Scheduler
from pcnav.cli.progress import progress
from pcnav.cli.table_recordings import (
    BATCH_FILE,
    Estimators,
    Objects,
    PipelineOf,
    TargetOf,
    plan_of_recordings,
)
from pcnav.cli.verbosity import is_quiet
from pcnav.core._extras import require_batch
from pcnav.core.errors import InputError

if TYPE_CHECKING:
    from rich.console import Console

    from pcnav.batch.grid import GridPlan
    from pcnav.batch.metrics import EvaluationWindow
    from pcnav.batch.recordings import RecordingsPlan
    from pcnav.batch.standard_tables import Wanted
    from pcnav.batch.tabulate import TableSummary

_REGRESSION = 1
_MAX_FAILURES = 10
"""Printed; the page has all."""


def table(
    source: Annotated[
        str | None,
        typer.Argument(
            help="A grid: a file or a shipped name. Or a folder of recordings, like a BOP data "
            "set. Or a finished batch."
        ),
    ] = None,
    out: Annotated[
        Path | None, typer.Option("-o", "--out", help="Folder of the batch, or of its tables.")
    ] = None,
    rows: Annotated[
        str | None, typer.Option(help="Axes of the rows, like range_m,satellite")
    ] = None,
    columns: Annotated[str | None, typer.Option(help="Axes of the columns.")] = None,
    metrics: Annotated[
        str | None, typer.Option(help="What to show, like attitude_rms_deg,position_p95_m")
    ] = None,
    from_s: Annotated[
        float | None,
        typer.Option(
            "--from", min=0.0, help="Errors from so many seconds on, not the second half."
        ),
    ] = None,
    case: Annotated[str | None, typer.Option(help="One case alone: the words of its name.")] = None,
    run: Annotated[int | None, typer.Option(help="Which run of that case, from 0.")] = None,
    compare: Annotated[
        tuple[Path, Path] | None,
        typer.Option(metavar="OLD NEW", help="Two batches; exit code 1 where NEW is worse."),
    ] = None,
    estimator: Estimators = None,
    target: TargetOf = None,
    mesh_unit: MeshUnit = None,
    pipeline: PipelineOf = None,
    object_: Objects = None,
    jobs: Jobs = None,
    scheduler: Scheduler = None,
    overwrite: Overwrite = False,
) -> None:
    """Run a grid of cases, or recordings, and tabulate how accurate each estimator is; or tabulate
    again, or compare.

    Examples: `pcnav table accuracy -o runs/accuracy`,
    `pcnav table recordings --estimator depth,open3d_icp -o runs/recordings`,
    `pcnav table runs/accuracy --rows range_m --columns estimator --metrics attitude_rms_deg`,
    `pcnav table --compare runs/old runs/new`
    """
    require_batch("pcnav table")
    # Before the libraries are loaded: one process then sums in the same order as many.
    with one_thread_each():
        from pcnav.batch.metrics import EvaluationWindow
        from pcnav.batch.standard_tables import Wanted

        wanted = Wanted(_names(rows), _names(columns), _names(metrics))
        window = EvaluationWindow(from_s)
        where: dict[str, object] = {"--jobs": jobs, "--scheduler": scheduler}
        alone: dict[str, object] = {"--case": case, "--run": run}
        of_files: dict[str, object] = {
            **{"--estimator": estimator, "--target": target, "--mesh-unit": mesh_unit},
            **{"--pipeline": pipeline, "--object": object_},
        }
        if compare is not None:
            pivot = {"GRID": source, "--out": out, "--rows": rows, "--columns": columns}
            _refuse("--compare", {**pivot, **where, **alone, **of_files})
            _compare(*compare, wanted.metrics, window)
        elif source is None:
            expected = "expected a grid, a batch or --compare OLD NEW"
            raise InputError("pcnav table", "argument", expected)
        elif (Path(source) / BATCH_FILE).is_file():
            _refuse(f"{source} (a finished batch)", where | alone | of_files)
            _tabulate(Path(source), out, wanted, window, overwrite)
        else:
            plan: GridPlan | RecordingsPlan
            if Path(source).is_dir():
                plan = plan_of_recordings(Path(source), of_files)
            else:
                from pcnav.batch.grid import named_grid

                # A name that nobody knows is a more likely mistake than a folder left out.
                plan = named_grid(source)
                _refuse(f"{source} (a grid)", of_files)
            if out is None:
                raise InputError(source, "--out", "expected a folder for the batch: -o OUT")
            if case is not None:
                _refuse("--case", where)
                _run_alone(plan, case, run or 0, out)
            else:
                _refuse(source, {"--run": run})
                _run(plan, out, (jobs, scheduler), wanted, window)


def _refuse(what: str, options: Mapping[str, object]) -> None:
    """Say which options mean nothing here, instead of passing over them."""
    given = [name for name, value in options.items() if value is not None]
    if given:
        raise InputError(what, ", ".join(given), "expected none of these here")


def _run(
    plan: "GridPlan | RecordingsPlan",
    out: Path,
    where: tuple[int | None, str | None],
    wanted: "Wanted",
    window: "EvaluationWindow",
) -> None:
    """Run a grid, or go on with it, and tabulate."""
    from pcnav.batch.cluster import Workers
    from pcnav.batch.run_batch import run_batch

    workers = Workers(*where)
    with progress(f"table {plan.basis.source}") as advance:
        summary = run_batch(plan, out, workers, wanted, window, advance)
    _print_summary(summary)


def _run_alone(plan: "GridPlan | RecordingsPlan", case: str, index: int, out: Path) -> None:
    """One run of a grid, and its numbers."""
    from pcnav.batch.run_batch import run_alone
    from pcnav.batch.tabulate import single_run_table

    record = run_alone(plan, case, index, out)
    if record.failure is not None:
        typer.echo(f"failed: {record.run}: {record.failure}")
        raise typer.Exit(1)
    _wide_console().print(single_run_table(record).to_rich())


def _tabulate(
    folder: Path, out: Path | None, wanted: "Wanted", window: "EvaluationWindow", overwrite: bool
) -> None:
    """Tabulate a batch without running anything."""
    from pcnav.batch.store import open_store
    from pcnav.batch.tabulate import tabulate

    with progress("table") as advance:
        summary = tabulate(
            open_store(folder),
            out,
            wanted=wanted,
            window=window,
            overwrite=overwrite,
            on_progress=advance,
        )
    _print_summary(summary)


def _compare(
    old: Path, new: Path, metrics: tuple[str, ...] | None, window: "EvaluationWindow"
) -> None:
    """Print what changed; exit code 1 on a regression."""
    from pcnav.batch.compare import case_table, compare, overall_table, verdict_lines
    from pcnav.batch.store import open_store

    with progress("compare") as advance:
        found = compare(open_store(old), open_store(new), metrics, window, advance)
    console = _wide_console()
    tables = [overall_table(found), case_table(found, only_sure=bool(found.overall))]
    for table in tables:
        if table.rows:
            console.print(table.to_rich())
    for line in verdict_lines(found):
        typer.echo(line)
    if found.is_regression:
        raise typer.Exit(_REGRESSION)


def _print_summary(summary: "TableSummary") -> None:
    from pcnav.batch.pages import stacked

    if is_quiet():
        return
    console = _wide_console()
    for table in summary.tables:
        console.print(stacked(table).to_rich())
    for failure in summary.failures[:_MAX_FAILURES]:
        typer.echo(f"failed: {failure.run}: {failure.failure}")
    if len(summary.failures) > _MAX_FAILURES:
        typer.echo(f"{len(summary.failures)} runs failed; the page lists them")
    if summary.unfinished:
        typer.echo(f"{summary.unfinished} runs of the grid are not finished")
    typer.echo(f"tables and figures: {summary.page}")


def _wide_console() -> "Console":
    from rich.console import Console

    # Numbers cut short would be worse than lines that wrap.
    return Console(width=max(Console().width, 160))


def _names(text: str | None) -> tuple[str, ...] | None:
    """Names between commas; none at all is different from nothing said."""
    if text is None:
        return None
    return tuple(name.strip() for name in text.split(",") if name.strip())
