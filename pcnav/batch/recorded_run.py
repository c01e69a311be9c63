"""What every run of a batch has in common: an estimator put to all frames, a record of what came
of it."""

import logging
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Protocol

import numpy as np

from pcnav.batch.axes import GridRun
from pcnav.batch.process import peak_memory_mb, reset_peak_memory
from pcnav.batch.record import RunRecord
from pcnav.batch.run_metrics import BOUNDED, Followed, RunMetrics
from pcnav.core.arrays import FloatArray
from pcnav.estimators.interface import Estimator
from pcnav.recordings.intake import Intake
from pcnav.recordings.recording import Recording
from pcnav.recordings.sequence import Frame
from pcnav.runs.collector import RunCollector, collected
from pcnav.runs.provenance import library_versions_with_peers


class Bound(Protocol):
    """The least errors that the frames of a recording allow."""

    def step(self, frame: Frame, /) -> FloatArray:
        """(5,) after the next frame, as in `BOUNDED`."""


def recorded(run: GridRun, command: str, measure: Callable[[], RunMetrics]) -> RunRecord:
    """The record of a run whose numbers ``measure`` finds: the same for the same run, but for times
    and memory. ``command`` repeats it alone."""
    reset_peak_memory()
    with _without_track_messages():
        found = measure()
    return RunRecord(
        run=run,
        columns=found.columns,
        values=found.values | {"peak_memory_mb": peak_memory_mb()},
        failure=None,
        versions=library_versions_with_peers(),
        command=command,
    )


def follow(
    recording: Recording | Intake, name: str, estimator: Estimator, bound: Bound | None = None
) -> Followed:
    """Put an estimator of a name to all frames of a recording; one frame at a time is in memory.

    What is kept of a frame is some 4 kB, most of it the covariance. Time is spent on the bound and
    on the frames themselves, too, but none of it counts.
    """
    collector, seconds, least = RunCollector(estimator.output, name), list[float](), []
    for frame in recording:
        started = time.process_time()
        estimate = estimator.step(frame)
        seconds.append(time.process_time() - started)
        collector.add(estimate)
        if bound is not None:
            least.append(bound.step(frame))
    revised = estimator.finish()
    run = collector.run() if revised is None else collected(name, estimator.output, revised)
    bounds = dict(zip(BOUNDED, np.array(least).T, strict=True)) if least else {}
    return Followed(run, np.array(seconds), bounds)


@contextmanager
def _without_track_messages() -> Iterator[None]:
    """Of hundreds of runs nobody wants to read when each was locked; the records have it."""
    logger = logging.getLogger("pcnav")
    before = logger.level
    logger.setLevel(logging.WARNING)
    try:
        yield
    finally:
        logger.setLevel(before)
