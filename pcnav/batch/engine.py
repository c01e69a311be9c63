"""Many independent runs, each a task of its own, over processes or a cluster."""

import time
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import closing, suppress
from functools import partial
from queue import Empty, SimpleQueue
from secrets import token_hex
from typing import TYPE_CHECKING, Generic, TypeVar

from pcnav.batch.attempt import Failure, attempt, one_line
from pcnav.batch.cluster import Workers, connected
from pcnav.batch.process import one_thread_each
from pcnav.batch.processes import Processes
from pcnav.batch.worker_check import Requirements, UnfitWorkerError, here, refuse_unfit
from pcnav.core.errors import InputError

if TYPE_CHECKING:
    from distributed import Client, Future

Item = TypeVar("Item")
Result = TypeVar("Result")

_LOOK_EVERY_S = 1.0
"""How often the workers are counted; they come and go."""
_ANSWER_WITHIN_S = 5.0
_ALONE_FOR_S = 180.0
"""How long a batch waits for a worker when the last one is gone, or for a silent scheduler."""


class RunError(RuntimeError):
    """A run that failed; the message names it."""


def results(
    function: Callable[[Item], Result], items: Sequence[Item], workers: Workers
) -> Generator[tuple[int, Result], None, None]:
    """Index and result of every item, in the order in which they end; to be closed.

    Args:
        function: defined at the top of a module, so that another process can find it.
        items: what it is called with; ``str(item)`` names a run that fails.
        workers: what to spread over.

    Each process does its linear algebra on one thread. Raises `RunError` when a run fails,
    which ends all others, and `InputError` when a cluster cannot be used.
    """
    with closing(outcomes(function, items, workers, here())) as ended:
        for k, outcome in ended:
            if isinstance(outcome, Failure):
                failed = RunError(f"{items[k]}: {outcome.summary}")
                failed.add_note(outcome.details)
                raise failed
            yield k, outcome


def outcomes(
    function: Callable[[Item], Result],
    items: Sequence[Item],
    workers: Workers,
    requirements: Requirements,
) -> Generator[tuple[int, Result | Failure], None, None]:
    """Index and result of every item, or its failure, in the order in which they end.

    A run whose process ends abruptly is done again by another, a few times. Only as many runs as
    there are workers are out at once, so that memory here does not grow with their number. To be
    closed, which ends what is out. Raises `InputError` for workers or a scheduler that cannot be
    used, or are gone.
    """
    if workers.scheduler is not None:
        with connected(workers.scheduler, requirements) as client:
            task = partial(_on_worker, function, requirements)
            yield from _Dispatch(client, workers.scheduler, task, items).results()
        return
    jobs = min(workers.processes, len(items))
    with one_thread_each():
        if jobs > 1:
            yield from Processes(function, items, jobs).results()
            return
        for k, item in enumerate(items):
            yield k, attempt(function, item)


def _on_worker(
    function: Callable[[Item], Result], requirements: Requirements, item: Item
) -> Result | Failure:
    refuse_unfit(requirements)
    return attempt(function, item)


class _Dispatch(Generic[Item, Result]):
    """Keeps as many runs out at one time as there are workers."""

    def __init__(
        self,
        client: "Client",
        scheduler: str,
        function: Callable[[Item], Result | Failure],
        items: Sequence[Item],
    ) -> None:
        self._client, self._function, self._items = client, function, items
        self._where = scheduler
        self._group = f"run-{token_hex(8)}"
        self._ended: SimpleQueue[Future[Result | Failure]] = SimpleQueue()
        self._out: dict[object, int] = {}
        self._room = 1
        self._looked = self._manned = self._answered = -float("inf")

    def results(self) -> Iterator[tuple[int, Result | Failure]]:
        """Index and outcome, as they end."""
        self._manned = self._answered = time.monotonic()
        begun = 0
        while begun < len(self._items) or self._out:
            self._look()
            while begun < len(self._items) and len(self._out) < self._room:
                self._submit(begun)
                begun += 1
            with suppress(Empty):
                future = self._ended.get(timeout=_LOOK_EVERY_S)
                try:
                    outcome = self._outcome(future)
                except TimeoutError:
                    # The worker that had it is gone; another one is at it, or there is none.
                    self._ended.put(future)
                else:
                    yield self._out.pop(future.key), outcome

    def _submit(self, k: int) -> None:
        key = (self._group, k)
        future = self._client.submit(self._function, self._items[k], key=key, pure=False)
        self._out[key] = k
        future.add_done_callback(self._ended.put)

    def _look(self) -> None:
        """Count the workers from time to time. Raises `InputError` when they stay away."""
        now = time.monotonic()
        if now - self._looked < _LOOK_EVERY_S:
            return
        self._looked = now
        try:
            if self._client.status != "running":
                raise self._gone()
            self._room = len(self._client.nthreads(callback_timeout=_ANSWER_WITHIN_S))
        except TimeoutError as error:
            # A scheduler may be busy; one that is gone is noticed by the client, one that hangs
            # or whose machine does is not.
            if now - self._answered > _ALONE_FOR_S:
                raise self._gone() from error
            return
        except OSError as error:
            raise self._gone() from error
        self._answered = now
        if self._room:
            self._manned = now
        elif now - self._manned > _ALONE_FOR_S:
            expected = (
                f"expected one to come back within {_ALONE_FOR_S:g} s; finished runs are kept"
            )
            raise InputError(self._where, "workers", expected)

    def _outcome(self, future: "Future[Result | Failure]") -> Result | Failure:
        """Raises ``TimeoutError`` when the answer is lost and the run is being done again."""
        from distributed import KilledWorker
        from distributed.client import FutureCancelledError

        try:
            return future.result(timeout=_ANSWER_WITHIN_S)
        except TimeoutError:
            raise
        except UnfitWorkerError as error:
            raise InputError(*error.args) from error
        except KilledWorker as error:
            deaths = error.allowed_failures + 1
            summary = f"its process ended abruptly, each of the {deaths} times that it was run"
            return Failure(summary, str(error))
        except FutureCancelledError as error:
            raise self._gone() from error
        # The run itself raises nothing: a worker could not load it, or not send back its result.
        except Exception as error:
            item = self._items[self._out[future.key]]
            raise RunError(f"{item}: {one_line(error)}") from error

    def _gone(self) -> InputError:
        expected = "expected it to stay to the end, it is gone; finished runs are kept"
        return InputError(self._where, "scheduler", expected)
