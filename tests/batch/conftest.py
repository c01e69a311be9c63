"""Fixtures that several files of these tests share."""

from pathlib import Path

import pytest

from pcnav.batch.store import RunStore
from pcnav.batch.tabulate import tabulate
from tests.batch.stored_batch import MESSAGES, RUNS, stored


@pytest.fixture(scope="session")
def store(tmp_path_factory: pytest.TempPathFactory) -> RunStore:
    """Three distances, two noise levels, two estimators, three runs; one of them failed."""
    return stored(tmp_path_factory.mktemp("batch") / "made", RUNS, failures=MESSAGES)


@pytest.fixture(scope="session")
def tables(store: RunStore, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The standard tables of it."""
    out = tmp_path_factory.mktemp("tables") / "out"
    tabulate(store, out)
    return out
