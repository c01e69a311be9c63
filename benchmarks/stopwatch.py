"""Time by stage of code that is not written for it, by wrapping functions while it runs."""

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from functools import wraps
from time import perf_counter
from typing import ParamSpec, TypeVar
from unittest.mock import patch

P = ParamSpec("P")
R = TypeVar("R")


class Stopwatch:
    """Seconds by stage; what a stage calls of another stage counts towards that one alone."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self._running: list[str] = []
        self._since = 0.0

    def timed(self, stage: str, function: Callable[P, R]) -> Callable[P, R]:
        """The function, counted towards a stage."""

        @wraps(function)
        def wrapper(*args: P.args, **kwargs: P.kwargs) -> R:
            self._switch()
            self._running.append(stage)
            try:
                return function(*args, **kwargs)
            finally:
                self._switch()
                self._running.pop()

        return wrapper

    def _switch(self) -> None:
        """Give the time since the last switch to the innermost stage."""
        now = perf_counter()
        if self._running:
            stage = self._running[-1]
            self.seconds[stage] = self.seconds.get(stage, 0.0) + now - self._since
        self._since = now

    @contextmanager
    def watching(self, places: dict[str, str]) -> Iterator[None]:
        """Within the block, time the functions named by dotted path, each for its stage.

        Raises ``AttributeError`` when a place no longer exists.
        """
        with ExitStack() as patches:
            for place, stage in places.items():
                owner_path, _, name = place.rpartition(".")
                owner = _resolve(owner_path)
                function = getattr(owner, name)
                patches.enter_context(patch.object(owner, name, self.timed(stage, function)))
            yield


def _resolve(path: str) -> object:
    """A module, or a class in one."""
    import importlib

    try:
        return importlib.import_module(path)
    except ModuleNotFoundError:
        module, _, name = path.rpartition(".")
        return getattr(importlib.import_module(module), name)
