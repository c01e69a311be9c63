"""Runs a batch and prints time and peak memory of this process as JSON: ``KIND RUNS JOBS``."""

import json
import sys
import tempfile
from pathlib import Path
from time import perf_counter

from pcnav.batch.process import one_thread_each


def main(kind: str, count: int, jobs: int) -> None:
    """Run so many runs over so many processes, their start included in the time."""
    # Before the libraries are loaded: one process and two then do the same work.
    with one_thread_each(), tempfile.TemporaryDirectory(prefix="pcnav-bench-") as name:
        from benchmarks.scaling_runs import cheap_runs, real_runs
        from pcnav.batch.cluster import Workers
        from pcnav.batch.process import peak_memory_mb
        from pcnav.batch.store import new_store, run_stored

        folder = Path(name)
        function, runs = {"real": real_runs, "cheap": cheap_runs}[kind](count, folder)
        store = new_store(folder / "batch", kind, runs)
        started = perf_counter()
        run_stored(function, runs, store, Workers(jobs=jobs), str)
        seconds = perf_counter() - started
        failed = [header.failure for header in store.headers() if header.failure is not None]
        if failed or store.missing:
            raise SystemExit(f"runs without a result: {failed or store.missing}")
    print(json.dumps({"seconds": seconds, "peak_mb": peak_memory_mb()}))


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]), int(sys.argv[3]))
