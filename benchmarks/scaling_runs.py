"""Runs that processes elsewhere import: real ones of a small grid, and ones that cost nothing."""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from pcnav.batch.axes import GridRun, grid_case
from pcnav.batch.grid import grid_runs, named_grid
from pcnav.batch.one_run import OneRun
from pcnav.batch.record import RunRecord
from pcnav.runs.provenance import library_versions

GRID = """
[batch]
name = "scaling"
runs = {runs}
seed = 1
duration_s = 40.0
[base]
satellite = "boxsat"
range_m = 20.0
[[grid]]
cross = {{ estimator = ["pcnav"] }}
"""

RunFunction = Callable[[GridRun], RunRecord]
Planned = tuple[RunFunction, list[GridRun]]


def real_runs(count: int, folder: Path) -> Planned:
    """Simulated frames and the tracker on them, as `pcnav table` runs them; one case."""
    grid = folder / "scaling.toml"
    grid.write_text(GRID.format(runs=count), encoding="utf-8")
    plan = named_grid(str(grid))
    return OneRun(plan.basis), plan.runs


def cheap_runs(count: int, folder: Path) -> Planned:
    """Random numbers: what is left is the engine."""
    return cheap_run, grid_runs([grid_case((("range_m", 10.0),))], count, 1)


def cheap_run(run: GridRun) -> RunRecord:
    """As many numbers as a real record has."""
    generator = np.random.default_rng(run.seed)
    columns = {f"error_{k}_m": generator.standard_normal(100) for k in range(40)}
    return RunRecord(run, columns, {"frames": 100.0}, None, library_versions(), "")
