"""A run as it goes on: estimates are taken in as they come, frames read again to be looked at."""

import threading
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Protocol, TypeVar

from pcnav.config.pipeline_file import Pipeline
from pcnav.dynamics.blocks import Layout
from pcnav.runs.collector import RunCollector
from pcnav.runs.estimate import Estimate, Output
from pcnav.runs.feature_outcomes import FeatureOutcomes
from pcnav.runs.records import RectangleRecord
from pcnav.viewer.app import serve
from pcnav.viewer.loaded_run import STORED_COVARIANCES, LoadedRun, Snapshot
from pcnav.viewer.loading import load_run, opened
from pcnav.viewer.server import LOOPBACK, LocalServer


class LiveView:
    """The view of a run on this machine; it is served from the first frame on.

    What it is given costs the run next to nothing: the newest frames are there for whoever asks,
    nobody is waited for.
    """

    def __init__(self, port: int, on_served: Callable[[LocalServer], None]) -> None:
        self._port, self._on_served = port, on_served
        self._frames: RunCollector | None = None
        self._records: dict[float, tuple[RectangleRecord, ...]] = {}
        self._outcomes: dict[float, FeatureOutcomes] = {}
        self._lock = threading.Lock()
        self.server: LocalServer | None = None
        """There from the first frame on."""

    def expect(self, name: str, pipeline: Pipeline, output: Output) -> None:
        """What is known of the run before its first frame; the pipeline is the one as run."""
        kept = Layout(tuple(block for block in STORED_COVARIANCES if block in output.layout))
        kind = str(pipeline.estimator.kind)
        self._frames = RunCollector(output, kind, name=name, pipeline=pipeline, kept=kept)
        self._newest = Snapshot((opened(self._frames.run()),), 0, is_live=True)

    def add(self, estimate: Estimate) -> None:
        """Take in a frame; called by the run."""
        if self._frames is None:
            raise RuntimeError("a frame before expect()")
        with self._lock:
            self._frames.add(estimate)
            self._records[estimate.time_s] = estimate.records
            if estimate.features.outcomes is not None:
                self._outcomes[estimate.time_s] = estimate.features.outcomes
        self._served()

    def snapshot(self) -> Snapshot:
        """All frames so far, or the result folder."""
        with self._lock:
            frames, newest = self._frames, self._newest
            if frames is None or not newest.is_live or newest.number == len(frames):
                return newest
            covariances = {block.name: frames.covariance_of(block) for block in frames.kept.blocks}
            loaded = replace(
                newest.runs[0],
                run=frames.run(),
                records=self._records,
                outcomes=self._outcomes,
                covariances=covariances,
            )
            self._newest = Snapshot((loaded,), len(frames), is_live=True)
            return self._newest

    def finish(self, loaded: LoadedRun) -> LocalServer:
        """From now on the result folder is shown; the caller keeps the process alive for it."""
        with self._lock:
            number = 0 if self._frames is None else len(self._frames) + 1
            self._newest = Snapshot((loaded,), number, is_live=False)
        return self._served()

    def stop(self) -> None:
        """End it."""
        if self.server is not None:
            self.server.stop()

    def _served(self) -> LocalServer:
        if self.server is None:
            self.server = serve(self.snapshot, LOOPBACK, self._port)
            self._on_served(self.server)
        return self.server


class _Summary(Protocol):
    @property
    def folder(self) -> Path: ...


_S = TypeVar("_S", bound=_Summary)


def run_live(
    work: Callable[[LiveView], _S], port: int, on_served: Callable[[LocalServer], None]
) -> tuple[_S, LocalServer]:
    """Do a run that tells a view of its frames, and show its result folder when it has ended.

    ``on_served`` is told of the server when the first frame is there. A run that fails leaves no
    server; what it raises is raised.
    """
    view = LiveView(port, on_served)
    try:
        summary = work(view)
        server = view.finish(load_run(summary.folder))
    except BaseException:
        view.stop()
        raise
    return summary, server
