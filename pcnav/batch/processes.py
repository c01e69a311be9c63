"""Runs over processes of this machine.

Each process talks to this one over a pair of sockets that have no address: no other user, and no
other program, can reach them. What is sent is code to be run, so nothing less will do.
"""

import multiprocessing
import os
import pickle
import signal
import threading
from collections import Counter, deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnProcess
from typing import Any, Generic, TypeVar, cast

from pcnav.batch.attempt import Failure, attempt

Item = TypeVar("Item")
Result = TypeVar("Result")

DEATHS_OF_A_RUN = 3
"""Processes that may end in the middle of a run before it counts as failed."""
_NOTHING = -1
"""What a process does that was just started."""

# Afresh, not forked: a fork copies the locks of whatever threads the libraries keep.
_SPAWN = multiprocessing.get_context("spawn")


class Processes(Generic[Item, Result]):
    """Keeps as many runs out at one time as there are processes."""

    def __init__(
        self, function: Callable[[Item], Result], items: Sequence[Item], jobs: int
    ) -> None:
        self._function, self._items = function, items
        self._idle = jobs
        """Processes that may be started yet."""
        self._waiting = deque(range(len(items)))
        self._deaths: Counter[int] = Counter()
        self._out: dict[Connection, tuple[SpawnProcess, int]] = {}

    def results(self) -> Iterator[tuple[int, Result | Failure]]:
        """Index and result of every item, or its failure, as they end.

        A run whose process ends abruptly is done again by another, a few times. Closing it ends
        all processes in the middle of what they do.
        """
        try:
            while self._waiting or self._out:
                while self._waiting and self._idle:
                    self._start()
                for ready in wait(list(self._out)):
                    yield from self._answer(cast(Connection, ready))
        finally:
            for connection in list(self._out):
                self._end(connection)

    def _start(self) -> None:
        """One more process, with the next item to do."""
        ours, theirs = _SPAWN.Pipe()
        process = _SPAWN.Process(target=_serve, args=(theirs,), daemon=True)
        with _interrupts_kept_from_processes():
            process.start()
            self._out[ours] = (process, _NOTHING)
        # The end of the process is then the end of what can be read here.
        theirs.close()
        self._idle -= 1
        self._send(ours)

    def _send(self, connection: Connection) -> None:
        """Give a process the next item, or end it where none is left."""
        if not self._waiting:
            self._end(connection)
            return
        k = self._waiting.popleft()
        self._out[connection] = (self._out[connection][0], k)
        task = pickle.dumps((self._function, self._items[k]))
        try:
            connection.send_bytes(task)
        except OSError:
            # It is gone, which is what will be read.
            return

    def _answer(self, connection: Connection) -> Iterator[tuple[int, Result | Failure]]:
        _, k = self._out[connection]
        try:
            answer = connection.recv_bytes()
        except (EOFError, OSError):
            self._end(connection)
            self._idle += 1
            self._deaths[k] += 1
            if self._deaths[k] < DEATHS_OF_A_RUN:
                self._waiting.appendleft(k)
                return
            summary = (
                f"its process ended abruptly, each of the {DEATHS_OF_A_RUN} times that it was run"
            )
            yield k, Failure(summary, summary)
        else:
            self._send(connection)
            yield k, pickle.loads(answer)

    def _end(self, connection: Connection) -> None:
        """End a process at once: asked politely, it finishes its run."""
        process, _ = self._out.pop(connection)
        process.kill()
        connection.close()
        process.join()
        process.close()


def _serve(connection: Connection) -> None:
    """What a process does: one item after the other, until there are no more."""
    threading.Thread(target=_end_with_parent, daemon=True).start()
    while True:
        try:
            task = connection.recv_bytes()
        except (EOFError, OSError):
            return
        # What cannot be loaded here, or sent back, is the failure of that run.
        answer = attempt(lambda task: pickle.dumps(attempt(_done, task)), task)
        connection.send_bytes(pickle.dumps(answer) if isinstance(answer, Failure) else answer)


def _done(task: bytes) -> Any:
    function, item = pickle.loads(task)
    return function(item)


def _end_with_parent() -> None:
    """A run may take an hour, which nobody would wait for any more."""
    parent = multiprocessing.parent_process()
    assert parent is not None, "it was started as a process of another one"
    parent.join()
    os._exit(1)


@contextmanager
def _interrupts_kept_from_processes() -> Iterator[None]:
    """Processes started within never see the interrupt key.

    The terminal interrupts every process; this one tells the others. An interrupt that comes
    within the block is delivered at its end.
    """
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    # Whichever thread starts it first has its interrupts let through again, and so have the
    # processes that this thread starts.
    resource_tracker.ensure_running()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
