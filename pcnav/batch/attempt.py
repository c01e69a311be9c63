"""A run's result, or why there is none."""

import traceback
from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

Item = TypeVar("Item")
Result = TypeVar("Result")


@dataclass(frozen=True)
class Failure:
    """What a run raised, as text: not every exception survives the way between processes."""

    summary: str
    """One line."""
    details: str


def attempt(function: Callable[[Item], Result], item: Item) -> Result | Failure:
    """The function of the item, or why there is none."""
    try:
        return function(item)
    # A library that wants to end the process must not end the worker.
    except (Exception, SystemExit) as error:
        return Failure(one_line(error), traceback.format_exc())


def one_line(error: BaseException) -> str:
    """An exception in one line."""
    return " ".join(f"{type(error).__name__}: {error}".split())
