"""Batches over processes: speed-up of two workers over one, and memory of the process in charge."""

import json
import subprocess
import sys
from dataclasses import dataclass

from rich.table import Table

SPEED_UP_BAR = 1.7
MEMORY_BAR = 1.1
"""Memory over ten times the runs, relative."""
FEW, MANY = 200, 2000
"""Runs whose memory is compared."""


@dataclass(frozen=True)
class BatchCost:
    """What a batch took."""

    runs: int
    jobs: int
    seconds: float
    """From the first call to the last record, with the start of the processes."""
    peak_mb: float
    """Resident memory of the process in charge alone, MB of 1e6 bytes."""


def measure_batch(kind: str, runs: int, jobs: int) -> BatchCost:
    """Run a batch of ``real`` or ``cheap`` runs in a child process."""
    command = [sys.executable, "-m", "benchmarks.scaling_child", kind, str(runs), str(jobs)]
    done = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True)
    answer = json.loads(done.stdout)
    return BatchCost(runs, jobs, answer["seconds"], answer["peak_mb"])


def speed_table(one: BatchCost, two: BatchCost) -> Table:
    """Times of the same runs in one process and over two workers."""
    table = Table(
        title=f"{one.runs} runs of 80 frames, simulated and tracked",
        caption="Two workers: with the start of scheduler and processes.",
    )
    for name in ("workers", "s", "s a run", "speed-up", f">= {SPEED_UP_BAR:g}"):
        table.add_column(name, justify="right")
    for cost in (one, two):
        ratio = one.seconds / cost.seconds
        judged = ("-" if cost is one else _outcome(ratio >= SPEED_UP_BAR),)
        cells = (f"{cost.seconds:.1f}", f"{cost.seconds / cost.runs:.2f}", f"{ratio:.2f}")
        table.add_row(str(cost.jobs), *cells, *judged)
    return table


def memory_table(few: BatchCost, many: BatchCost) -> Table:
    """Peak memory of the process in charge over the number of runs."""
    table = Table(
        title=f"memory of the process in charge of {few.jobs} workers, runs that cost nothing",
        caption="Peak resident memory, libraries and scheduler included.",
    )
    for name in ("runs", "peak, MB", "ratio", f"<= {MEMORY_BAR:g}", "ms a run"):
        table.add_column(name, justify="right")
    for cost in (few, many):
        ratio = cost.peak_mb / few.peak_mb
        judged = "-" if cost is few else _outcome(ratio <= MEMORY_BAR)
        cells = (f"{cost.peak_mb:.1f}", f"{ratio:.3f}", judged)
        table.add_row(str(cost.runs), *cells, f"{1e3 * cost.seconds / cost.runs:.1f}")
    return table


def _outcome(met: bool) -> str:
    return "pass" if met else "fail"
