"""The runs of a study: planned part by part, made together, told in one count."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

from pcnav.batch.cluster import EVERY_CORE, Workers
from pcnav.batch.engine import run_all

Item = TypeVar("Item")
Result = TypeVar("Result")

OnProgress = Callable[[int, int], None]
"""Told how many units of work are done, and of how many."""


class Planned(Generic[Result]):
    """Runs of one kind, which have results when `Work.run` has made them."""

    def __init__(self) -> None:
        self.results: list[Result] = []
        """In the order of the items."""


class Work:
    """All runs of a study, spread over the same workers.

    A study plans the runs of every chapter first, so that the whole of the work is known and no
    core waits for the last run of a chapter.
    """

    def __init__(
        self,
        workers: Workers = EVERY_CORE,
        on_progress: OnProgress = lambda done, total: None,
    ) -> None:
        self.workers, self.on_progress = workers, on_progress
        self._tasks: list[_Task] = []

    def plan(
        self, function: Callable[[Item], Result], items: Sequence[Item], cost: float = 1.0
    ) -> Planned[Result]:
        """``function`` of every item, each at a cost in units that all parts of a study share.

        The function is defined at the top of a module, so that another process can find it;
        ``str(item)`` names a run that fails.
        """
        planned: Planned[Result] = Planned()
        self._tasks += [_Task(planned, function, item, cost) for item in items]
        return planned

    def run(self) -> None:
        """Make all that is planned, the first planned first. Raises `RunError` when a run fails."""
        tasks, self._tasks = self._tasks, []
        total = max(1, round(sum(task.cost for task in tasks)))
        # Runs end nearly in the order in which they begin.
        done, costs = 0.0, iter([task.cost for task in tasks])

        def count() -> None:
            nonlocal done
            done += next(costs)
            self.on_progress(min(round(done), total), total)

        calls = [_Call(task.function, task.item) for task in tasks]
        for task, result in zip(tasks, run_all(_made, calls, self.workers, count), strict=True):
            task.planned.results.append(result)


@dataclass(frozen=True)
class _Task:
    """A run and where its result belongs."""

    planned: Planned[Any]
    function: Callable[[Any], Any]
    item: Any
    cost: float


@dataclass(frozen=True)
class _Call:
    """What goes to another process."""

    function: Callable[[Any], Any]
    item: Any

    def __str__(self) -> str:
        return str(self.item)


def _made(call: _Call) -> Any:
    return call.function(call.item)
