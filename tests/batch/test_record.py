"""One file a run: what comes back, what others read, and that there is never half of one."""

import errno
import json
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from pcnav.batch.axes import grid_case
from pcnav.batch.monte_carlo import Run
from pcnav.batch.record import RunRecord, read_header, read_record, write_record
from pcnav.core.errors import InputError

RUN = Run(grid_case((("satellite", "boxsat"), ("range_m", 10.0), ("resolution_px", 96))), 3, 2**63)
VALUES = {"time_to_lock_s": np.nan, "ate_rmse_m": 0.1 + 0.2, "worst": np.inf, "least": -np.inf}
RECORD = RunRecord(
    RUN,
    {
        "time_s": np.array([0.0, 0.1, 0.2]),
        "status": ["acquiring", "locked", "lost"],
        "position_error_m": np.array([np.nan, 1.0 / 3.0, -0.0]),
    },
    VALUES,
    None,
    {"pcnav": "0.1.0", "numpy": "2.2"},
    "pcnav table accuracy --case 'satellite=boxsat range_m=10' --run 3",
)
FAILED = replace(RECORD, columns={}, values={}, failure="ValueError: no such pose")


def test_all_of_a_record_comes_back_to_the_bit(tmp_path: Path) -> None:
    path = write_record(tmp_path, RECORD)
    assert path == tmp_path / f"{RUN.key}.parquet"
    found = read_record(path)
    assert found.run == RUN and found.run.key == RUN.key
    # Equal numbers of another kind would be another axis value to a table.
    assert [type(value) for _, value in found.run.case.settings] == [str, float, int]
    assert list(found.columns) == list(RECORD.columns)
    for name in ("time_s", "position_error_m"):
        assert (
            np.asarray(found.columns[name]).tobytes() == np.asarray(RECORD.columns[name]).tobytes()
        )
    assert found.columns["status"] == RECORD.columns["status"]
    assert found.frames == 3
    assert (
        np.array(list(found.values.values())).tobytes() == np.array(list(VALUES.values())).tobytes()
    )
    assert list(found.values) == list(VALUES)
    assert (found.failure, found.versions, found.command) == (
        None,
        RECORD.versions,
        RECORD.command,
    )


def test_a_failure_has_its_message_and_no_rows(tmp_path: Path) -> None:
    path = write_record(tmp_path, FAILED)
    found = read_record(path)
    assert found == FAILED and found.frames == 0
    assert read_header(path) == FAILED
    pd = pytest.importorskip("pandas")
    # Readers that want a column find one.
    assert len(pd.read_parquet(path)) == 0 and pq.read_table(path).num_columns == 1


def test_others_read_the_frames_and_the_values(tmp_path: Path) -> None:
    path = write_record(tmp_path, RECORD)
    pd = pytest.importorskip("pandas")
    frames = pd.read_parquet(path)
    np.testing.assert_array_equal(
        frames["position_error_m"], np.asarray(RECORD.columns["position_error_m"])
    )
    assert list(frames["status"]) == RECORD.columns["status"]
    about = json.loads(pq.read_schema(path).metadata[b"pcnav"])
    assert about["case"] == RUN.case.name and about["seed"] == RUN.seed
    assert about["values"]["ate_rmse_m"] == 0.1 + 0.2


def test_the_same_record_is_the_same_file(tmp_path: Path) -> None:
    once = write_record(tmp_path, RECORD).read_bytes()
    assert write_record(tmp_path, RECORD).read_bytes() == once
    assert [path.name for path in tmp_path.iterdir()] == [f"{RUN.key}.parquet"]


def test_a_full_disk_leaves_nothing_and_names_the_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    earlier = write_record(tmp_path, RECORD).read_bytes()

    def full(_: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError, match="No space left") as caught:
        write_record(tmp_path, FAILED)
    assert caught.value.filename == str(tmp_path / f"{RUN.key}.parquet")
    assert [path.read_bytes() for path in tmp_path.iterdir()] == [earlier]


def test_columns_of_different_lengths_are_no_record(tmp_path: Path) -> None:
    uneven = replace(RECORD, columns={"time_s": np.zeros(3), "status": ["locked"]})
    with pytest.raises(ValueError, match="differ in length"):
        write_record(tmp_path, uneven)
    assert not list(tmp_path.iterdir())


def test_what_is_not_a_record_is_refused_in_one_line(tmp_path: Path) -> None:
    whole = write_record(tmp_path, RECORD)
    broken = tmp_path / "broken.parquet"
    broken.write_bytes(whole.read_bytes()[:-100])
    foreign = tmp_path / "foreign.parquet"
    pq.write_table(pa.table({"time_s": [0.0]}), foreign)
    for path in (broken, foreign):
        with pytest.raises(InputError, match="expected the record of a run") as caught:
            read_record(path)
        assert path.name in str(caught.value) and "\n" not in str(caught.value)
        with pytest.raises(InputError):
            read_header(path)
    table = pq.read_table(whole)
    about = json.loads(table.schema.metadata[b"pcnav"]) | {"format": 99}
    later = tmp_path / "later.parquet"
    pq.write_table(table.replace_schema_metadata({b"pcnav": json.dumps(about).encode()}), later)
    with pytest.raises(InputError, match=r"later\.parquet: format: expected 2, found 99"):
        read_record(later)
