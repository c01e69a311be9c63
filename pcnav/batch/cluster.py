"""Where runs are run: processes of this machine, or the workers of a dask scheduler."""

import asyncio
import logging
import os
import re
import warnings
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING
from urllib.parse import urlsplit

from pcnav.batch.worker_check import Requirements, check_workers
from pcnav.core.errors import InputError

if TYPE_CHECKING:
    from distributed import Client

_MAX_JOBS = 8
"""A process holds the libraries and a satellite, some 400 MB: more are not started unasked."""
_ADDRESS = re.compile(r"[a-z]+://.+:\d+/?")
_LOOPBACK = {"127.0.0.1", "localhost", "::1"}
_ANSWER_WITHIN_S = 5.0
_TELL_AFTER_S = 3.0
WORKERS_WITHIN_S = 30.0
"""How long a scheduler without workers is waited for at the beginning."""
_LIBRARIES = ("distributed", "tornado", "asyncio")

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Workers:
    """What runs are spread over.

    Raises `InputError` for a number of processes or an address that cannot be meant.
    """

    jobs: int | None = None
    """Processes of this machine: None takes one per usable core, 1 stays in this process."""
    scheduler: str | None = None
    """Address of a dask scheduler, like ``tcp://host:8786``, whose workers are used instead."""

    def __post_init__(self) -> None:
        if self.jobs is not None and self.jobs < 1:
            raise InputError("--jobs", "processes", f"expected at least 1, got {self.jobs}")
        if self.scheduler is None:
            return
        if self.jobs is not None:
            expected = "expected none beside --scheduler, whose workers are what they are"
            raise InputError("--jobs", "processes", expected)
        if not _ADDRESS.fullmatch(self.scheduler):
            expected = "expected the address of a dask scheduler, like tcp://host:8786"
            raise InputError(self.scheduler, "scheduler", expected)

    @property
    def processes(self) -> int:
        """How many of this machine."""
        return min(usable_cores(), _MAX_JOBS) if self.jobs is None else self.jobs


EVERY_CORE = Workers()
"""One process per usable core of this machine."""


def usable_cores() -> int:
    """Cores this process may run on."""
    try:
        return len(os.sched_getaffinity(0))
    except AttributeError:  # macOS and Windows do not say
        return os.cpu_count() or 1


@contextmanager
def connected(address: str, requirements: Requirements) -> "Iterator[Client]":
    """A client of a scheduler's workers.

    Whatever ends the block takes back what the scheduler has not begun. Raises `InputError` when
    it or its workers cannot be used.
    """
    if urlsplit(address).scheme != "tls" and urlsplit(address).hostname not in _LOOPBACK:
        _log.warning(
            "%s: without TLS whoever reaches this port runs code as you; tls:// lets in only those "
            "who have the key",
            address,
        )
    from distributed import Client
    from distributed.versions import VersionMismatchWarning

    with _quiet():
        try:
            _greet(address)
            with warnings.catch_warnings():
                # The workers are compared with this process below, by what matters.
                warnings.simplefilter("ignore", VersionMismatchWarning)
                client = Client(address, timeout=_ANSWER_WITHIN_S, set_as_default=False)
        # Whatever answers there, or nothing: distributed raises what it meets.
        except Exception as error:
            expected = f"expected a dask scheduler that answers within {_ANSWER_WITHIN_S:g} s"
            raise InputError(address, "scheduler", expected) from error
        with client:
            try:
                _wait_for_workers(client, address)
                check_workers(client, requirements)
            except OSError as error:
                expected = "expected it to stay while its workers are asked, it is gone"
                raise InputError(address, "scheduler", expected) from error
            yield client


def _greet(address: str) -> None:
    """Raises ``OSError`` unless something that speaks dask's protocol is there.

    A client would wait for ever for one that takes the connection and says nothing.
    """
    from distributed import Security
    from distributed.comm.core import connect

    arguments = Security().get_connection_args("client")

    async def greet() -> None:
        comm = await connect(address, timeout=_ANSWER_WITHIN_S, **arguments)
        await comm.close()

    async def within_time() -> None:
        await asyncio.wait_for(greet(), _ANSWER_WITHIN_S)

    # A thread of its own: this one may have an event loop that runs, as in a notebook.
    with ThreadPoolExecutor(1) as thread:
        thread.submit(asyncio.run, within_time()).result()


def _wait_for_workers(client: "Client", where: str) -> None:
    try:
        client.wait_for_workers(1, timeout=_TELL_AFTER_S)
        return
    except TimeoutError:
        _log.info("waiting for a worker of %s", where)
    try:
        client.wait_for_workers(1, timeout=WORKERS_WITHIN_S - _TELL_AFTER_S)
    except TimeoutError as error:
        expected = f"expected a worker within {WORKERS_WITHIN_S:g} s, none came"
        raise InputError(where, "workers", expected) from error


@contextmanager
def _quiet() -> Iterator[None]:
    """Within the block the libraries of the cluster keep to themselves what they log.

    Whatever matters comes back as a result or an exception, and is said in a line of ours.
    """
    # Dask gives some of its own loggers levels of their own.
    names = [name for name in logging.root.manager.loggerDict if name.split(".")[0] in _LIBRARIES]
    loggers = [logging.getLogger(name) for name in (*_LIBRARIES, *names)]
    before = [logger.level for logger in loggers]
    for logger in loggers:
        logger.setLevel(logging.CRITICAL + 1)
    try:
        yield
    finally:
        for logger, level in zip(loggers, before, strict=True):
            logger.setLevel(level)
