"""The runs of a study: planned part by part, made together, told in one count."""

from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Generic, TypeVar

from pcnav.batch.cluster import EVERY_CORE, Workers
from pcnav.batch.engine import results
from pcnav.batch.monte_carlo import Case, Run, RunBatch, runs_of

Item = TypeVar("Item")
Result = TypeVar("Result")

OnProgress = Callable[[int, int], None]
"""Told how many units of work are done, and of how many."""


@dataclass(frozen=True)
class Planned(Generic[Result]):
    """Runs of one kind, which have results when `Work.run` has made them."""

    items: Sequence[Any]
    results: list[Result] = field(default_factory=list)
    """In the order of the items."""

    @property
    def by_case(self) -> dict[str, list[Result]]:
        """The results by the name of the case, when the items are runs or batches of runs."""
        found: dict[str, list[Result]] = {}
        for item, result in zip(self.items, self.results, strict=True):
            found.setdefault(item.case.name, []).append(result)
        return found


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
        self._workers, self._on_progress = workers, on_progress
        self._calls: list[_Call] = []
        self._planned: list[Planned[Any]] = []

    def plan(
        self, function: Callable[[Item], Result], items: Sequence[Item], work: float = 1.0
    ) -> Planned[Result]:
        """``function`` of every item, mostly runs of `pcnav.batch.monte_carlo`.

        ``work`` is that of an item in units that all parts of a study share; a run has its own.
        The function is defined at the top of a module, so that another process can find it;
        ``str(item)`` names a run that fails.
        """
        planned = Planned[Result](items)
        self._planned.append(planned)
        self._calls += [
            _Call(function, item, item.work if isinstance(item, Run | RunBatch) else work)
            for item in items
        ]
        return planned

    def repeat(
        self,
        function: Callable[..., Result],
        name: str,
        cases: Mapping[str, tuple[object, ...]],
        count: int,
        work: float,
    ) -> Planned[Result]:
        """``function`` of the arguments of every case and a seed, so many times.

        The seeds follow from the name: all cases meet the same draws.
        """
        runs = runs_of(name, [Case(case, given, work) for case, given in cases.items()], count)
        return self.plan(partial(_seeded, function), runs)

    def run(self) -> None:
        """Make all that is planned, the first planned first. Raises `RunError` when a run fails."""
        total, done = max(1, round(sum(call.work for call in self._calls))), 0.0
        found: dict[int, Any] = {}
        with closing(results(_made, self._calls, self._workers)) as ended:
            for k, result in ended:
                found[k] = result
                done += self._calls[k].work
                self._on_progress(min(round(done), total), total)
        ordered = iter([found[k] for k in range(len(self._calls))])
        for planned in self._planned:
            planned.results.extend(next(ordered) for _ in planned.items)
        self._calls, self._planned = [], []


@dataclass(frozen=True)
class _Call:
    """What goes to another process."""

    function: Callable[[Any], Any]
    item: Any
    work: float

    def __str__(self) -> str:
        return str(self.item)


def _seeded(function: Callable[..., Result], run: Run[tuple[object, ...]]) -> Result:
    return function(*run.case.settings, run.seed)


def _made(call: _Call) -> Any:
    return call.function(call.item)
