"""What a worker must be so that its numbers are those of any other: asked once and in every run."""

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from pcnav.core.errors import InputError
from pcnav.runs.provenance import library_versions_with_peers

if TYPE_CHECKING:
    from distributed import Client

# Sums over several threads depend on their number.
_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS")
_Answer = tuple[dict[str, str], dict[str, str], str | None]
"""Versions of the libraries, variables of the environment, identity of the folder."""


@dataclass(frozen=True)
class Requirements:
    """What a worker is compared with."""

    versions: Mapping[str, str]
    """Of pcnav and the libraries, as in the process that asks."""
    identity_file: Path | None = None
    """In the folder of the batch, to be seen by every worker."""
    identity: str | None = None
    """What tells that folder from another one of its name."""


class UnfitWorkerError(Exception):
    """A worker that must not take part: its address, what is wrong, and what was expected."""


def here(identity_file: Path | None = None, identity: str | None = None) -> Requirements:
    """What this process is, as the requirements of others."""
    return Requirements(library_versions_with_peers(), identity_file, identity)


def refuse_unfit(requirements: Requirements) -> None:
    """Called on a worker in every run, because workers join at any time.

    Raises `UnfitWorkerError`.
    """
    from distributed import get_worker

    worker = get_worker()
    answer = _question()(_path(requirements))
    unmet = _unmet(requirements, answer, worker.state.nthreads)
    if unmet is not None:
        raise UnfitWorkerError(worker.address, *unmet)


def check_workers(client: "Client", requirements: Requirements) -> None:
    """Ask all present workers at once. Raises `InputError` for the first that is not fit."""
    threads = client.nthreads()
    answers = client.run(_question(), _path(requirements), on_error="return")
    for address, answer in sorted(answers.items()):
        if isinstance(answer, Exception):
            expected = f"expected one that can be asked ({type(answer).__name__}: {answer})"
            raise InputError(address, "worker", expected)
        unmet = _unmet(requirements, answer, threads.get(address, 1))
        if unmet is not None:
            raise InputError(address, *unmet)


def _path(requirements: Requirements) -> str | None:
    return None if requirements.identity_file is None else str(requirements.identity_file)


def _unmet(requirements: Requirements, answer: _Answer, threads: int) -> tuple[str, str] | None:
    """The field and what was expected there."""
    versions, environment, identity = answer
    for name, ours in requirements.versions.items():
        theirs = versions.get(name, "not installed")
        if theirs != ours:
            return f"version of {name}", f"expected {ours} as here, found {theirs}"
    if threads != 1:
        return "threads", f"expected 1 (dask worker --nthreads 1), found {threads}"
    for name in _THREADS:
        if environment.get(name) != "1":
            return name, f"expected 1 where the worker starts, found {environment.get(name)}"
    file = requirements.identity_file
    if file is not None and identity != requirements.identity:
        expected = f"expected to see {file.parent} as it is here (a folder that all machines share)"
        return "folder", expected
    return None


def _question() -> Callable[[str | None], _Answer]:
    """A function that goes to a worker by value: one of another version lacks this module."""

    def answer(identity_file: str | None) -> _Answer:
        import json

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
        identity = None
        if identity_file is not None:
            try:
                with open(identity_file, encoding="utf-8") as file:  # noqa: PTH123
                    identity = json.load(file).get("identity")
            except (OSError, ValueError, AttributeError):
                identity = None
        return versions, dict(os.environ), identity

    return answer
