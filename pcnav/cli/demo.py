"""``pcnav demo``: the shipped satellite from frames to report."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from pcnav.cli.options import Overwrite
from pcnav.core.errors import InputError

if TYPE_CHECKING:
    pass


from pcnav.cli.run import run_into
from pcnav.cli.simulate import simulate_into


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
    if result.is_dir() and any(result.iterdir()) and not overwrite:
        raise InputError(result, "folder", "expected a new folder; --overwrite replaces this one")
    simulate_into("demo", sequence, overwrite)
    run_into(sequence, None, "demo", result, overwrite)
