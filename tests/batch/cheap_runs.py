"""Runs that cost nothing, for other processes to import: the engine is what is tested."""

import os
import resource
import threading
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pcnav.batch.axes import GridRun, grid_case
from pcnav.batch.grid import grid_runs
from pcnav.batch.record import RunRecord
from pcnav.runs.provenance import library_versions

FRAMES = 40
COMMAND = "pcnav table {run}"


def planned(count: int) -> list[GridRun]:
    """So many runs of two cases."""
    cases = [
        grid_case((("satellite", name), ("range_m", 10.0))) for name in ("boxsat", "cubesat6u")
    ]
    return grid_runs(cases, count // 2, 7)


def command_of(run: GridRun) -> str:
    """What stands in a record for the command that repeats it."""
    return COMMAND.format(run=run.key)


def executions(log: Path) -> list[str]:
    """Keys of the runs that were begun, in that order."""
    return log.read_text().split() if log.exists() else []


@dataclass(frozen=True)
class CheapRun:
    """A run whose errors are its seed's random numbers."""

    log: Path
    """A line is added for every beginning."""
    seconds: float = 0.0
    quick: str | None = None
    """Key of a run that takes no time."""
    fails: str | None = None
    """Key of a run that raises."""
    kills: str | None = None
    """Key of a run that ends its process, every time."""
    largest_file: int | None = None
    """Bytes above which the system refuses what this process writes."""

    def __call__(self, run: GridRun) -> RunRecord:
        with self.log.open("a") as file:
            file.write(f"{run.key}\n")
        time.sleep(0.0 if run.key == self.quick else self.seconds)
        if run.key == self.kills:
            os._exit(1)
        if run.key == self.fails:
            raise ValueError("no such\npose")
        if self.largest_file is not None:
            _, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
            resource.setrlimit(resource.RLIMIT_FSIZE, (self.largest_file, hard))
        return record_of(run)


def record_of(run: GridRun) -> RunRecord:
    """The record of a run: linear algebra and random numbers, nothing of the clock."""
    generator = np.random.default_rng(run.seed)
    matrix = generator.standard_normal((FRAMES, FRAMES))
    errors = np.asarray(
        np.linalg.solve(matrix, generator.standard_normal(FRAMES)), dtype=np.float64
    )
    errors[0] = np.nan
    return RunRecord(
        run,
        {
            "time_s": np.linspace(0.0, 4.0, FRAMES),
            "status": ["acquiring"] * 3 + ["locked"] * (FRAMES - 3),
            "position_error_m": errors,
        },
        {"ate_rmse_m": float(np.nanmean(errors)), "time_to_lock_s": float("nan")},
        None,
        library_versions(),
        command_of(run),
    )


def lock_of(_: int) -> object:
    """What cannot be sent to another process."""
    return threading.Lock()
