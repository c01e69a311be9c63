"""The application: what every command shares, and how whatever goes wrong is said."""

import logging
import os
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Annotated, cast

import typer

from pcnav import __version__
from pcnav.core.errors import InputError

app = typer.Typer(
    help="Pose, motion, mass centre and inertia of a tumbling satellite from depth frames.",
    context_settings={"help_option_names": ["-h", "--help"]},
    # Plain: boxes and Markdown take twice the time of all the rest of a help.
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
)

_BAD_INPUT = 2
_INTERRUPTED = 130
# Typer exports this one class of usage errors; its parent stands for every wrong command line.
_UsageError = cast(type[typer.BadParameter], typer.BadParameter.__base__)


def main() -> None:
    """Entry point: whatever goes wrong is one line on stderr and an exit code other than 0.

    2 for bad input, a wrong command line and a file system that refuses; 3 for a run that found
    nothing, whose warning stands before; 130 when interrupted.
    """
    # Matrices here are small: threads of the linear algebra cost more than they bring, by factors
    # when the cores are busy. NumPy reads this when it is first imported, inside the commands.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    # A batch system or a lost terminal that ends a run must leave no more behind than a user does.
    for name in ("SIGTERM", "SIGHUP"):
        number = getattr(signal, name, None)
        # nohup has a command stay when its terminal goes.
        if number is not None and signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, signal.default_int_handler)
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
        # The terminal may be what went.
        with suppress(OSError):
            print("interrupted: nothing is left half-written", file=sys.stderr, flush=True)
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
