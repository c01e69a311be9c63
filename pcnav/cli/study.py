"""``pcnav study``: a study's tables and figures."""

from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from pkgutil import iter_modules
from typing import Annotated

import typer

from pcnav.cli.options import Jobs, Overwrite, Scheduler
from pcnav.cli.progress import progress
from pcnav.cli.verbosity import is_quiet
from pcnav.core._extras import require_batch

_STUDIES = "pcnav.studies" if find_spec("pcnav.studies") else "studies"
"""They stand on the package: inside a wheel, or beside it in a checkout. They are found by name, so
that nothing in the package depends on them."""


def _names() -> str:
    """The studies there are: every folder among them is one."""
    found = find_spec(_STUDIES)
    places = found.submodule_search_locations if found else ()
    return ", ".join(sorted(module.name for module in iter_modules(places) if module.ispkg))


def study(
    name: Annotated[str, typer.Argument(help=_names())],
    out: Annotated[Path, typer.Option("-o", "--out", help="Folder of tables and figures.")],
    runs: Annotated[
        int | None, typer.Option(help="Monte Carlo runs, instead of the study's own number.")
    ] = None,
    jobs: Jobs = None,
    scheduler: Scheduler = None,
    overwrite: Overwrite = False,
) -> None:
    """Rebuild a study's tables and figures: a paper's, or the tracker's own.

    Example: `pcnav study yu2019 -o runs/yu2019`
    """
    require_batch("pcnav study")
    from rich.console import Console

    from pcnav.batch.cluster import Workers

    workers = Workers(jobs, scheduler)
    with progress(f"study {name}") as advance:
        summary = import_module(_STUDIES).run_study(
            name, out, runs=runs, workers=workers, overwrite=overwrite, on_progress=advance
        )
    if is_quiet():
        return
    # Numbers cut short would be worse than lines that wrap.
    console = Console(width=max(Console().width, 120))
    for table in summary.tables:
        console.print(table)
    typer.echo(f"tables and figures: {summary.page}")
