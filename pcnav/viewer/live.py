"""A run as it goes on: estimates are taken in as they come, frames read again to be looked at."""

import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol, TypeVar

import numpy as np

from pcnav.core.arrays import FloatArray, IntArray
from pcnav.dynamics.state import STATE_SIZE
from pcnav.runs.results import RectangleRecord, Track
from pcnav.viewer.app import serve
from pcnav.viewer.loaded_run import LoadedRun, Snapshot, load_run
from pcnav.viewer.server import LOOPBACK, LocalServer

_FIELDS: dict[str, tuple[int, ...]] = {
    "time_s": (),
    "r_hill": (3,),
    "v_hill": (3,),
    "com_model": (3,),
    "R_world_body": (3, 3),
    "omega_body": (3,),
    "inertia_ratios": (5,),
    "sd": (STATE_SIZE,),
    "T_cam_model": (4, 4),
    "nis": (),
    "nis_dof": (),
    "window_nis": (),
    "inlier_ratio": (),
    "n_rectangles": (),
    "position_covariance": (3, 3),
    "com_covariance": (3, 3),
}
_FIRST_ROWS = 256


@dataclass(frozen=True)
class LiveRow:
    """A frame of any kind of run."""

    time_s: float
    status: str
    values: Mapping[str, FloatArray | float]
    """By field of `Track`, besides ``position_covariance`` and ``com_covariance`` (3, 3), m^2; nan
    is kept of what is not given."""
    records: tuple[RectangleRecord, ...] = ()


class LiveRun:
    """The source of a run that goes on: what it is given costs the run next to nothing.

    About 700 bytes of numbers a frame are kept, and the records of its rectangles. The newest
    frames are there for whoever asks; nobody is waited for. ``loaded`` tells what is known before
    the first frame; its track and records are made here.
    """

    def __init__(self, loaded: LoadedRun) -> None:
        self._rows = {
            field: np.full((_FIRST_ROWS, *shape), np.nan) for field, shape in _FIELDS.items()
        }
        self._status: list[str] = []
        self._records: dict[float, tuple[RectangleRecord, ...]] = {}
        self._lock = threading.Lock()
        self._finished: Snapshot | None = None
        self._empty = replace(loaded, track=empty_track(), records=self._records)
        self._newest = Snapshot((self._empty,), 0, is_live=True)

    def add(self, row: LiveRow) -> None:
        """Take in a frame; called by the run."""
        with self._lock:
            k = len(self._status)
            if k == len(self._rows["time_s"]):
                self._grow()
            self._rows["time_s"][k] = row.time_s
            for field, value in row.values.items():
                self._rows[field][k] = value
            self._records[row.time_s] = row.records
            self._status.append(row.status)

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
                loaded = replace(
                    self._empty,
                    track=self._track(n),
                    position_covariance=self._rows["position_covariance"][:n],
                    com_covariance=self._rows["com_covariance"][:n],
                )
                self._newest = Snapshot((loaded,), n, is_live=True)
            return self._newest

    def _grow(self) -> None:
        """Room for twice as many; what was handed out keeps the old arrays."""
        for field, rows in self._rows.items():
            grown = np.full((2 * len(rows), *rows.shape[1:]), np.nan)
            grown[: len(rows)] = rows
            self._rows[field] = grown

    def _track(self, n: int) -> Track:
        return _track_of({field: values[:n] for field, values in self._rows.items()}, self._status)


def empty_track() -> Track:
    """Of a run that has not begun."""
    return _track_of({field: np.empty((0, *shape)) for field, shape in _FIELDS.items()}, ())


def _track_of(rows: Mapping[str, FloatArray], status: Sequence[str]) -> Track:
    return Track(
        time_s=rows["time_s"],
        r_hill=rows["r_hill"],
        v_hill=rows["v_hill"],
        com_model=rows["com_model"],
        R_world_body=rows["R_world_body"],
        omega_body=rows["omega_body"],
        inertia_ratios=rows["inertia_ratios"],
        sd=rows["sd"],
        T_cam_model=rows["T_cam_model"],
        status=tuple(status),
        nis=rows["nis"],
        nis_dof=_counts(rows["nis_dof"]),
        window_nis=rows["window_nis"],
        inlier_ratio=rows["inlier_ratio"],
        n_rectangles=_counts(rows["n_rectangles"]),
    )


def _counts(values: FloatArray) -> IntArray:
    return np.nan_to_num(values).astype(np.intp)


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

    def expect(self, loaded: LoadedRun) -> None:
        """What is known of the run before its first frame; see `LiveRun`."""
        self._run = LiveRun(loaded)

    def add(self, row: LiveRow) -> None:
        """Show a frame."""
        if self._run is None:
            raise RuntimeError("a frame before expect()")
        self._run.add(row)
        self._served(self._run)

    @property
    def snapshot(self) -> Snapshot:
        """What is shown."""
        if self._run is None:
            raise RuntimeError("nothing is shown before expect()")
        return self._run.snapshot

    def finish(self, loaded: LoadedRun) -> LocalServer:
        """From now on the result folder is shown; the caller keeps the process alive for it."""
        run = self._run or LiveRun(loaded)
        run.finish(loaded)
        return self._served(run)

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
