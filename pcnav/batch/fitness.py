"""What a worker must be so that its numbers are those of any other: asked once and in every run."""

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

from pcnav.batch.layout import BATCH_FILE, read_identity
from pcnav.core.errors import InputError
from pcnav.runs.provenance import library_versions_with_peers

if TYPE_CHECKING:
    from distributed import Client

# Sums over several threads depend on their number.
_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS")


@dataclass(frozen=True)
class Requirements:
    """What a worker is compared with."""

    versions: Mapping[str, str]
    """Of pcnav and the libraries, as in the process that asks."""
    folder: Path | None = None
    """Of the batch, to be seen by every worker."""
    identity: str | None = None
    """What tells that folder from another one of its name."""


class UnfitWorkerError(Exception):
    """A worker that must not take part: its address, what is wrong, and what was expected."""


def here(folder: Path | None = None, identity: str | None = None) -> Requirements:
    """What this process is, as the requirements of others."""
    return Requirements(_versions(), folder, identity)


def refuse_unfit(requirements: Requirements) -> None:
    """Called on a worker in every run, because workers join at any time.

    Raises `UnfitWorkerError`.
    """
    from distributed import get_worker

    worker = get_worker()
    threads = worker.state.nthreads
    unmet = _unmet(requirements, _versions(), dict(os.environ), threads)
    folder = requirements.folder
    if unmet is None and folder is not None:
        unmet = _unseen(folder, read_identity(folder), requirements.identity)
    if unmet is not None:
        raise UnfitWorkerError(worker.address, *unmet)


def check_workers(client: "Client", requirements: Requirements) -> None:
    """Ask all present workers at once. Raises `InputError` for the first that is not fit."""
    folder = requirements.folder
    batch_file = None if folder is None else str(folder / BATCH_FILE)
    threads = client.nthreads()
    answers = client.run(_question(), batch_file, on_error="return")
    for address, answer in sorted(answers.items()):
        if isinstance(answer, Exception):
            expected = f"expected one that can be asked ({type(answer).__name__}: {answer})"
            raise InputError(address, "worker", expected)
        versions, environment, identity = answer
        unmet = _unmet(requirements, versions, environment, threads.get(address, 1))
        if unmet is None and folder is not None:
            unmet = _unseen(folder, identity, requirements.identity)
        if unmet is not None:
            raise InputError(address, *unmet)


def _unmet(
    requirements: Requirements,
    versions: Mapping[str, str],
    environment: Mapping[str, str],
    threads: int,
) -> tuple[str, str] | None:
    """The field and what was expected there."""
    for name, ours in requirements.versions.items():
        theirs = versions.get(name, "not installed")
        if theirs != ours:
            return f"version of {name}", f"expected {ours} as here, found {theirs}"
    if threads != 1:
        return "threads", f"expected 1 (dask worker --nthreads 1), found {threads}"
    for name in _THREADS:
        if environment.get(name) != "1":
            return name, f"expected 1 where the worker starts, found {environment.get(name)}"
    return None


def _unseen(folder: Path, found: str | None, identity: str | None) -> tuple[str, str] | None:
    if found == identity:
        return None
    return "folder", f"expected to see {folder} as it is here (a folder that all machines share)"


def _question() -> Callable[[str | None], tuple[dict[str, str], dict[str, str], str | None]]:
    """A function that goes to a worker by value: one of another version lacks this module."""

    def answer(batch_file: str | None) -> tuple[dict[str, str], dict[str, str], str | None]:
        import json
        import os

        try:
            from pcnav.runs.provenance import library_versions_with_peers

            versions = library_versions_with_peers()
        except ImportError:
            versions = {}
        try:
            import pcnav

            versions["pcnav"] = pcnav.__version__
        except ImportError:
            pass
        threads = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS")
        environment = {name: os.environ[name] for name in threads if name in os.environ}
        identity = None
        if batch_file is not None:
            try:
                with open(batch_file, encoding="utf-8") as file:  # noqa: PTH123
                    identity = json.load(file).get("identity")
            except (OSError, ValueError, AttributeError):
                identity = None
        return versions, environment, identity

    return answer


@cache
def _versions() -> dict[str, str]:
    return library_versions_with_peers()
