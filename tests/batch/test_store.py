"""The folder of a batch: it goes on where it ended, and takes in nothing of another batch."""

import json
import os
import time
from dataclasses import replace
from pathlib import Path

import pytest

import pcnav
from pcnav.batch.record import write_record
from pcnav.batch.store import RunStore, new_store, open_store
from pcnav.core.errors import InputError
from tests.batch.cheap_runs import planned, record_of

GRID = "[batch]\nname = 'cheap'\n"
RUNS = planned(6)


@pytest.fixture
def store(tmp_path: Path) -> RunStore:
    """An empty one."""
    return new_store(tmp_path / "out", GRID, RUNS)


def test_records_come_in_the_order_of_the_grid_whatever_the_order_of_writing(
    store: RunStore,
) -> None:
    for k in (4, 0, 5, 2):
        write_record(store.runs_folder, record_of(RUNS[k]))
    assert [record.run for record in store.headers()] == [RUNS[k] for k in (0, 2, 4, 5)]
    assert store.missing == (RUNS[1].key, RUNS[3].key)
    assert store.finished(RUNS[4]) and not store.finished(RUNS[1])
    with pytest.raises(InputError, match="there is none yet"):
        store.record(RUNS[1].key)


def test_a_batch_goes_on_in_its_folder(store: RunStore) -> None:
    write_record(store.runs_folder, record_of(RUNS[0]))
    again = new_store(store.folder, GRID, RUNS)
    assert again == store and again.identity == store.identity
    assert again.missing == tuple(run.key for run in RUNS[1:])
    assert open_store(store.folder) == store


def test_another_grid_and_another_version_are_refused(
    store: RunStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    for grid, runs in ((GRID + "# changed\n", RUNS), (GRID, RUNS[:-1])):
        with pytest.raises(InputError, match=r"grid\.toml: grid: expected the grid of this batch"):
            new_store(store.folder, grid, runs)
    monkeypatch.setattr(pcnav, "__version__", "99.0")
    with pytest.raises(InputError, match=r"version of pcnav: expected 99\.0 as now, found"):
        new_store(store.folder, GRID, RUNS)
    monkeypatch.undo()
    other = replace(record_of(RUNS[0]), versions={**record_of(RUNS[0]).versions, "scipy": "0.1"})
    write_record(store.runs_folder, other)
    with pytest.raises(InputError, match=r"version of scipy: expected .* as now, found 0\.1"):
        new_store(store.folder, GRID, RUNS)
    monkeypatch.setattr(pcnav, "__version__", "99.0")
    # To be tabulated it may be of any version, as long as it is one.
    assert open_store(store.folder).version != "99.0"


def test_records_of_mixed_versions_are_refused(store: RunStore) -> None:
    record = record_of(RUNS[1])
    write_record(store.runs_folder, record_of(RUNS[0]))
    path = write_record(store.runs_folder, replace(record, versions={"pcnav": "0.0.1"}))
    expected = rf"{path.name}: version of pcnav: expected .*, found 0\.0\.1"
    with pytest.raises(InputError, match=expected):
        list(store.headers())
    with pytest.raises(InputError, match=expected):
        new_store(store.folder, GRID, RUNS)
    write_record(store.runs_folder, record).rename(store.path(RUNS[2].key))
    with pytest.raises(InputError, match="expected that of the file's name"):
        list(store.headers())


def test_what_a_process_left_half_written_is_ignored_and_removed(store: RunStore) -> None:
    left = store.runs_folder / f".{RUNS[0].key}-0123.part"
    fresh = store.runs_folder / f".{RUNS[1].key}-4567.part"
    for path in (left, fresh):
        path.write_bytes(b"PAR1")
    hours_ago = time.time() - 7200.0
    os.utime(left, (hours_ago, hours_ago))
    assert list(store.headers()) == [] and len(store.missing) == len(RUNS)
    new_store(store.folder, GRID, RUNS)
    # The other one may be a worker's that is about to finish it.
    assert not left.exists() and fresh.exists()


def test_folders_that_are_no_batch_are_refused_and_left_alone(tmp_path: Path) -> None:
    thesis = tmp_path / "thesis"
    thesis.mkdir()
    (thesis / "chapter.txt").write_text("years of work")
    with pytest.raises(InputError, match=r"this has chapter\.txt"):
        new_store(thesis, GRID, RUNS)
    with pytest.raises(InputError, match=r"expected that of a batch, with batch\.json"):
        open_store(thesis)
    assert [path.name for path in thesis.iterdir()] == ["chapter.txt"]
    file = tmp_path / "file"
    file.write_text("")
    with pytest.raises(InputError, match="this is a file"):
        new_store(file, GRID, RUNS)
    with pytest.raises(InputError, match="expected a place that can be written"):
        new_store(file / "below", GRID, RUNS)
    with pytest.raises(InputError, match="expected every run once"):
        new_store(tmp_path / "twice", GRID, [*RUNS, RUNS[0]])


def test_a_batch_interrupted_before_its_first_file_begins_anew(tmp_path: Path) -> None:
    out = tmp_path / "out"
    (out / "runs").mkdir(parents=True)
    (out / ".grid.toml.part").write_text("[bat")
    assert new_store(out, GRID, RUNS).missing == tuple(run.key for run in RUNS)
    (out / "batch.json").write_text("{")
    with pytest.raises(InputError, match=r"batch\.json: file: expected"):
        open_store(out)
    (out / "batch.json").write_text(
        json.dumps({"format": 9, "pcnav": "9", "runs": [], "identity": "0"})
    )
    with pytest.raises(InputError, match="format: expected 2, found 9"):
        open_store(out)
