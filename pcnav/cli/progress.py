"""How far long work is: a bar at a terminal, a line now and then elsewhere."""

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Protocol

from pcnav.cli.verbosity import is_quiet

_LINE_EVERY_S = 10.0


class Advance(Protocol):
    """Told of how much is done, of how much, and how much of it failed."""

    def __call__(self, done: int, total: int, failed: int = 0, /) -> None: ...


@contextmanager
def progress(title: str) -> Iterator[Advance]:
    """Yields what is told of progress, which goes to stderr unless the command is quiet."""
    if is_quiet():
        yield lambda _done, _total, _failed=0, /: None
    elif sys.stderr.isatty():
        with _bar(title) as advance:
            yield advance
    else:
        yield _Lines(title)


class _Lines:
    """What is no terminal keeps every frame of a bar: a log file gets a line every ten seconds."""

    def __init__(self, title: str, clock: Callable[[], float] = time.monotonic) -> None:
        self._title, self._clock = title, clock
        self._began_s = self._told_s = clock()

    def __call__(self, done: int, total: int, failed: int = 0, /) -> None:
        now_s = self._clock()
        if now_s - self._told_s < _LINE_EVERY_S or not 0 < done < total:
            return
        self._told_s = now_s
        left_s = (now_s - self._began_s) * (total - done) / done
        words = [f"{done} of {total}", f"{left_s:.0f} s left"]
        words += [f"{failed} failed"] if failed else []
        print(f"{self._title}: {', '.join(words)}", file=sys.stderr, flush=True)


@contextmanager
def _bar(title: str) -> Iterator[Advance]:
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeRemainingColumn,
    )

    columns = (
        TextColumn(title),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
        TextColumn("{task.fields[failed]}"),
    )
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(title, total=None, failed="")

        def advance(done: int, total: int, failed: int = 0, /) -> None:
            told = f"{failed} failed" if failed else ""
            bar.update(task, completed=done, total=total, failed=told)

        yield advance
