"""The command line: each command parses, calls one function and prints its summary."""

from pcnav.cli.application import app, main
from pcnav.cli.config import config
from pcnav.cli.convert import convert
from pcnav.cli.demo import demo
from pcnav.cli.export import export
from pcnav.cli.forecast import forecast
from pcnav.cli.info import info
from pcnav.cli.observability import observability
from pcnav.cli.run import run
from pcnav.cli.simulate import simulate
from pcnav.cli.study import study
from pcnav.cli.table import table
from pcnav.cli.target import target
from pcnav.cli.verbosity import with_verbosity
from pcnav.cli.view import view

# In the order in which the help lists them.
for _command in (
    *(
        demo,
        simulate,
        info,
        convert,
        run,
        view,
        forecast,
        export,
        target,
        table,
        study,
        observability,
    ),
    config,
):
    # Whole, where Typer would cut it to half a line.
    _summary = " ".join((_command.__doc__ or "").partition("\n\n")[0].split())
    app.command(short_help=_summary)(with_verbosity(_command))

__all__ = ["app", "main"]
