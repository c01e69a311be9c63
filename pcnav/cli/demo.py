"""``pcnav demo``: the shipped satellite from frames to report."""

from pathlib import Path
from typing import Annotated

import typer

from pcnav.cli.options import Overwrite
from pcnav.cli.run import NOTHING_FOUND, run_into
from pcnav.cli.simulate import simulate_into
from pcnav.files.new_folder import refuse_unless_replaceable
from pcnav.runs.result_files import STATES_FILE


def demo(
    out: Annotated[Path, typer.Option("-o", "--out", help="Where to put both folders.")] = Path(
        "runs/demo"
    ),
    overwrite: Overwrite = False,
) -> None:
    """Simulate the shipped satellite, navigate, print the table and write the report.

    Example: `pcnav demo`
    """
    sequence, result = out / "sequence", out / "result"
    # Found out before half of the work is done.
    refuse_unless_replaceable(result.resolve(), overwrite, STATES_FILE)
    simulate_into("demo", sequence, overwrite)
    if not run_into(sequence, None, "demo", result, overwrite):
        raise typer.Exit(NOTHING_FOUND)
