"""A run as it goes on: estimates are taken in as they come, frames read again to be looked at."""

import threading
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, Protocol, TypeVar

import numpy as np
import numpy.typing as npt

from pcnav.config.pipeline_file import Pipeline
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


class _Rows:
    """The numbers of a run that grows, about 700 bytes a frame."""

    def __init__(self, name: str, pipeline: Pipeline, output: Output) -> None:
        self._name, self._pipeline, self._output = name, pipeline, output
        self.blocks = tuple(block for block in STORED_COVARIANCES if block in output.layout)
        numbers = ("time_s", "nis", "nis_dof", "window_nis", *output.notes)
        shapes: dict[str, tuple[int, ...]] = dict.fromkeys(numbers, ())
        shapes |= {b.name: (3, 3) if b is ATTITUDE else (b.size,) for b in output.blocks}
        shapes |= {f"P_{block.name}": (block.size, block.size) for block in self.blocks}
        shapes |= {"sd": (output.layout.size,), "T_cam_target": (4, 4)}
        self._type = np.dtype([(field, np.float64, shape) for field, shape in shapes.items()])
        self._rows = self._unknown(_FIRST_ROWS)
        self._status: list[str] = []

    def __len__(self) -> int:
        return len(self._status)

    def _unknown(self, n: int) -> npt.NDArray[Any]:
        return np.full(n, np.nan, self._type)

    def add(self, estimate: Estimate) -> None:
        """Take in a frame. What was handed out keeps the old array where there is no room."""
        if len(self) == len(self._rows):
            self._rows = np.concatenate([self._rows, self._unknown(len(self))])
        row, P = self._rows[len(self)], estimate.covariance
        row["time_s"], row["nis"], row["nis_dof"] = estimate.time_s, estimate.nis, estimate.nis_dof
        if estimate.window_nis is not None:
            row["window_nis"] = estimate.window_nis
        for name in self._output.notes:
            value = estimate.notes.get(name)
            row[name] = value if isinstance(value, float | int) else np.nan
        for name, values in estimate.values.items():
            row[name] = values
        if estimate.T_cam_target is not None:
            row["T_cam_target"] = estimate.T_cam_target
        if P is not None:
            row["sd"] = np.sqrt(np.maximum(np.diagonal(P), 0.0))
            for block in self.blocks:
                at = self._output.layout.slice_of(block)
                row[f"P_{block.name}"] = P[at, at]
        self._status.append(str(estimate.status))

    def __getitem__(self, field: str) -> npt.NDArray[np.float64]:
        """(n, ...) of all frames so far."""
        return self._rows[field][: len(self)]

    def run(self) -> Run:
        """All frames so far."""
        output = self._output
        trajectory = Trajectory(
            time_s=self["time_s"],
            layout=output.layout,
            values={block.name: self[block.name] for block in output.blocks},
            sd=self["sd"],
            T_cam_target=self["T_cam_target"] if output.has_poses else None,
        )
        return Run(
            name=self._name,
            folder=None,
            estimator=str(self._pipeline.estimator.kind),
            pipeline=self._pipeline,
            trajectory=trajectory,
            status=tuple(self._status),
            nis=self["nis"],
            nis_dof=np.nan_to_num(self["nis_dof"]).astype(np.intp),
            window_nis=self["window_nis"],
            notes={name: self[name] for name in output.notes},
            is_finished=False,
        )


class LiveView:
    """The view of a run on this machine; it is served from the first frame on.

    What it is given costs the run next to nothing: the newest frames are there for whoever asks,
    nobody is waited for.
    """

    def __init__(self, port: int, on_served: Callable[[LocalServer], None]) -> None:
        self._port, self._on_served = port, on_served
        self._rows: _Rows | None = None
        self._records: dict[float, tuple[RectangleRecord, ...]] = {}
        self._lock = threading.Lock()
        self.server: LocalServer | None = None
        """There from the first frame on."""

    def expect(self, name: str, pipeline: Pipeline, output: Output) -> None:
        """What is known of the run before its first frame; the pipeline is the one as run."""
        self._rows = _Rows(name, pipeline, output)
        self._newest = Snapshot((opened(self._rows.run()),), 0, is_live=True)

    def add(self, estimate: Estimate) -> None:
        """Take in a frame; called by the run."""
        if self._rows is None:
            raise RuntimeError("a frame before expect()")
        with self._lock:
            self._rows.add(estimate)
            self._records[estimate.time_s] = estimate.records
        self._served()

    def snapshot(self) -> Snapshot:
        """All frames so far, or the result folder."""
        rows = self._rows
        with self._lock:
            if rows is not None and self._newest.is_live and self._newest.number != len(rows):
                covariances = {block.name: rows[f"P_{block.name}"] for block in rows.blocks}
                loaded = replace(
                    self._newest.runs[0],
                    run=rows.run(),
                    records=self._records,
                    covariances=covariances,
                )
                self._newest = Snapshot((loaded,), len(rows), is_live=True)
            return self._newest

    def finish(self, loaded: LoadedRun) -> LocalServer:
        """From now on the result folder is shown; the caller keeps the process alive for it."""
        with self._lock:
            number = 0 if self._rows is None else len(self._rows) + 1
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
