"""The bar that long work shows."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Protocol


class Advance(Protocol):
    """Told of how much is done, of how much, and how much of it failed."""

    def __call__(self, done: int, total: int, failed: int = 0, /) -> None: ...


@contextmanager
def progress(title: str) -> Iterator[Advance]:
    """A bar on stderr, where that is a terminal; yields what moves it."""
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
    # What is not a terminal keeps every frame of a bar: a log file gets none.
    hidden = not sys.stderr.isatty()
    with Progress(*columns, console=Console(stderr=True), transient=True, disable=hidden) as bar:
        task = bar.add_task(title, total=None, failed="")

        def advance(done: int, total: int, failed: int = 0, /) -> None:
            told = f"{failed} failed" if failed else ""
            bar.update(task, completed=done, total=total, failed=told)

        yield advance
