"""A run as it goes on: estimates are taken in as they come, frames read again to be looked at."""

import threading
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Protocol, TypeVar

import numpy as np

from pcnav.config.pipeline_file import Pipeline
from pcnav.core.arrays import FloatArray
from pcnav.dynamics.blocks import ATTITUDE
from pcnav.dynamics.trajectory import Trajectory
from pcnav.runs.estimate import Estimate, Output
from pcnav.runs.records import RectangleRecord
from pcnav.runs.run import Run
from pcnav.viewer.app import serve
from pcnav.viewer.loaded_run import STORED_COVARIANCES, LoadedRun, Snapshot
from pcnav.viewer.loading import load_run, opened
from pcnav.viewer.server import LOOPBACK, LocalServer

_FIRST_ROWS = 256


class LiveRun:
    """The source of a run that goes on: what it is given costs the run next to nothing.

    About 700 bytes of numbers a frame are kept, and the records of its rectangles. The newest
    frames are there for whoever asks; nobody is waited for. ``pipeline`` is the one as run, which
    names the recording.
    """

    def __init__(self, name: str, pipeline: Pipeline, output: Output) -> None:
        self._output = output
        self._blocks = tuple(block for block in STORED_COVARIANCES if block in output.layout)
        self._rows = {
            field: np.full((_FIRST_ROWS, *shape), np.nan) for field, shape in self._shapes().items()
        }
        self._status: list[str] = []
        self._records: dict[float, tuple[RectangleRecord, ...]] = {}
        self._lock = threading.Lock()
        self._finished: Snapshot | None = None
        self._empty = opened(self._run_of(name, pipeline))
        self._newest = Snapshot((self._empty,), 0, is_live=True)

    def add(self, estimate: Estimate) -> None:
        """Take in a frame; called by the run."""
        with self._lock:
            k = len(self._status)
            if k == len(self._rows["time_s"]):
                self._grow()
            for field, value in self._numbers(estimate).items():
                self._rows[field][k] = value
            self._records[estimate.time_s] = estimate.records
            self._status.append(str(estimate.status))

    def finish(self, loaded: LoadedRun) -> None:
        """The run has ended: from now on its result folder is shown."""
        self._finished = Snapshot((loaded,), len(self._status) + 1, is_live=False)

    @property
    def snapshot(self) -> Snapshot:
        """All frames so far."""
        if self._finished is not None:
            return self._finished
        with self._lock:
            n = len(self._status)
            if self._newest.number != n:
                empty = self._empty
                loaded = replace(
                    empty,
                    run=self._run_of(empty.name, empty.run.pipeline),
                    records=self._records,
                    covariances={b.name: self._rows[f"P_{b.name}"][:n] for b in self._blocks},
                )
                self._newest = Snapshot((loaded,), n, is_live=True)
            return self._newest

    def _shapes(self) -> dict[str, tuple[int, ...]]:
        """Of the numbers of a frame."""
        output = self._output
        numbers = ("time_s", "nis", "nis_dof", "window_nis", *output.notes)
        shapes: dict[str, tuple[int, ...]] = dict.fromkeys(numbers, ())
        shapes |= {b.name: (3, 3) if b is ATTITUDE else (b.size,) for b in output.blocks}
        shapes |= {f"P_{block.name}": (block.size, block.size) for block in self._blocks}
        return {**shapes, "sd": (output.layout.size,), "T_cam_target": (4, 4)}

    def _numbers(self, estimate: Estimate) -> dict[str, FloatArray | float]:
        """Those of a frame that are known."""
        told = {name: estimate.notes.get(name) for name in self._output.notes}
        notes = {name: value for name, value in told.items() if isinstance(value, float | int)}
        row: dict[str, FloatArray | float] = {**notes, **estimate.values}
        row |= {"time_s": estimate.time_s, "nis": estimate.nis, "nis_dof": estimate.nis_dof}
        if estimate.window_nis is not None:
            row["window_nis"] = estimate.window_nis
        if estimate.T_cam_target is not None:
            row["T_cam_target"] = estimate.T_cam_target
        P, layout = estimate.covariance, self._output.layout
        if P is not None:
            row["sd"] = np.sqrt(np.maximum(np.diagonal(P), 0.0))
            for block in self._blocks:
                rows = layout.slice_of(block)
                row[f"P_{block.name}"] = P[rows, rows]
        return row

    def _grow(self) -> None:
        """Room for twice as many; what was handed out keeps the old arrays."""
        for field, rows in self._rows.items():
            grown = np.full((2 * len(rows), *rows.shape[1:]), np.nan)
            grown[: len(rows)] = rows
            self._rows[field] = grown

    def _run_of(self, name: str, pipeline: Pipeline | None) -> Run:
        output, n = self._output, len(self._status)
        rows = {field: values[:n] for field, values in self._rows.items()}
        trajectory = Trajectory(
            time_s=rows["time_s"],
            layout=output.layout,
            values={block.name: rows[block.name] for block in output.blocks},
            sd=rows["sd"],
            T_cam_target=rows["T_cam_target"] if output.has_poses else None,
        )
        return Run(
            name=name,
            folder=None,
            estimator="" if pipeline is None else str(pipeline.estimator.kind),
            pipeline=pipeline,
            trajectory=trajectory,
            status=tuple(self._status),
            nis=rows["nis"],
            nis_dof=np.nan_to_num(rows["nis_dof"]).astype(np.intp),
            window_nis=rows["window_nis"],
            notes={name: rows[name] for name in output.notes},
            is_finished=False,
        )


class _Summary(Protocol):
    @property
    def folder(self) -> Path: ...


_S = TypeVar("_S", bound=_Summary)


class LiveView:
    """The view of a run on this machine; it is served from the first frame on."""

    def __init__(self, port: int, on_served: Callable[[LocalServer], None]) -> None:
        self._port, self._on_served = port, on_served
        self._run: LiveRun | None = None
        self._server: LocalServer | None = None

    def expect(self, name: str, pipeline: Pipeline, output: Output) -> None:
        """What is known of the run before its first frame; see `LiveRun`."""
        self._run = LiveRun(name, pipeline, output)

    def add(self, estimate: Estimate) -> None:
        """Show a frame."""
        if self._run is None:
            raise RuntimeError("a frame before expect()")
        self._run.add(estimate)
        self._served(self._run)

    @property
    def snapshot(self) -> Snapshot:
        """What is shown."""
        if self._run is None:
            raise RuntimeError("nothing is shown before expect()")
        return self._run.snapshot

    def finish(self, loaded: LoadedRun) -> LocalServer:
        """From now on the result folder is shown; the caller keeps the process alive for it."""
        if self._run is None:
            raise RuntimeError("an end before expect()")
        self._run.finish(loaded)
        return self._served(self._run)

    def stop(self) -> None:
        """End it."""
        if self._server is not None:
            self._server.stop()

    def _served(self, run: LiveRun) -> LocalServer:
        if self._server is None:
            self._server = serve(run, LOOPBACK, self._port)
            self._on_served(self._server)
        return self._server


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
