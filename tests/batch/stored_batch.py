"""A made-up batch, stored, with tables made of it."""

import csv
import io
from pathlib import Path

from pcnav.batch.axes import GridRun
from pcnav.batch.record import write_record
from pcnav.batch.store import RunStore, new_store
from tests.batch.made_up import records, some_runs

RUNS = some_runs(3, satellites=("boxsat",))
FAILURE = "InputError: x_1 & 50 % of <frames> are empty"
MESSAGES = {RUNS[4].key: FAILURE}


def stored(folder: Path, runs: list[GridRun], **made) -> RunStore:
    found = new_store(folder, '[batch]\nname = "made up"\n', runs)
    for each in records(runs, **made):
        write_record(found.runs_folder, each)
    return found


def rows_of(text: str) -> list[dict[str, str]]:
    return list(csv.DictReader(io.StringIO(text)))
