"""How much a command says: every command takes ``--quiet`` and ``--verbose``."""

import inspect
import logging
from collections.abc import Callable
from functools import wraps
from typing import Annotated, Any

import typer

_LOG = logging.getLogger("pcnav")
_Quiet = Annotated[
    bool, typer.Option("--quiet", "-q", help="Say nothing but warnings, errors and results.")
]
_Verbose = Annotated[bool, typer.Option("--verbose", "-v", help="Log every frame, too.")]


def with_verbosity(command: Callable[..., None]) -> Callable[..., None]:
    """A command with both options, which set the level of the log for as long as it runs."""

    @wraps(command)
    def telling(*args: Any, quiet: bool = False, verbose: bool = False, **kwargs: Any) -> None:
        if quiet and verbose:
            raise typer.BadParameter("expected one of --quiet and --verbose")
        before = _LOG.level
        if quiet or verbose:
            _LOG.setLevel(logging.WARNING if quiet else logging.DEBUG)
        try:
            command(*args, **kwargs)
        finally:
            _LOG.setLevel(before)

    # Typer makes options of a signature.
    signature, only = inspect.signature(command), inspect.Parameter.KEYWORD_ONLY
    added = [
        inspect.Parameter(name, only, default=False, annotation=kind)
        for name, kind in (("quiet", _Quiet), ("verbose", _Verbose))
    ]
    parameters = [*signature.parameters.values(), *added]
    telling.__signature__ = signature.replace(parameters=parameters)  # type: ignore[attr-defined]
    telling.__annotations__ = {**command.__annotations__, "quiet": _Quiet, "verbose": _Verbose}
    return telling


def is_quiet() -> bool:
    """Whether the command that runs says nothing but warnings, errors and results."""
    return _LOG.level > logging.INFO


def say(text: str) -> None:
    """A line on standard output about what was done, unless the command is quiet."""
    if not is_quiet():
        typer.echo(text)
