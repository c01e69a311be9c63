"""A run as it goes on: estimates are taken in as they come, frames read again to be looked at."""

import threading
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from pcnav.arrays import FloatArray
from pcnav.config import Pipeline
from pcnav.pipeline import RunSummary, run
from pcnav.results import FrameEstimate, RectangleRecord, Track
from pcnav.sequences.opening import open_sequence
from pcnav.sequences.sequence import Sequence
from pcnav.state import COM_MODEL, R_HILL, STATE_SIZE
from pcnav.target import Target, load_target
from pcnav.viewer.app import serve
from pcnav.viewer.frames import FrameStore
from pcnav.viewer.server import LOOPBACK, LocalServer
from pcnav.viewer.source import Edition
from pcnav.viewer.story import Story, load_story

_FIELDS = {
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
    "explained": (),
    "n_rectangles": (),
    "position_covariance": (3, 3),
    "com_covariance": (3, 3),
}
_FIRST_ROWS = 256


class LiveRun:
    """The source of a run that goes on: what it is given costs the run next to nothing.

    About 700 bytes of numbers a frame are kept, and the records of its rectangles. The newest
    frames are there for whoever asks; nobody is waited for.
    """

    def __init__(self, name: str, sequence: Sequence, target: Target, pipeline: Pipeline) -> None:
        # Opened and loaded anew: readers and ray caster of the run are not shared with threads
        # that draw.
        own_target = load_target(target.mesh_path)
        own_sequence = open_sequence(sequence.path, target.mesh_path)
        frames = FrameStore(own_sequence, own_target, pipeline.perception, pipeline.seed)
        self._rows = {
            field: np.full((_FIRST_ROWS, *shape), np.nan) for field, shape in _FIELDS.items()
        }
        self._status: list[str] = []
        self._records: dict[float, tuple[RectangleRecord, ...]] = {}
        self._lock = threading.Lock()
        self._finished: Edition | None = None
        self._empty = Story(
            name=name,
            track=self._track(0),
            counted="rectangles",
            records=self._records,
            frames=frames,
            target=own_target,
            mean_motion_rad_s=sequence.info.mean_motion_rad_s,
            evaluation=None,
            verdicts={},
        )
        self._newest = Edition((self._empty,), 0, is_live=True)

    def add(self, estimate: FrameEstimate) -> None:
        """Take in a frame; called by the run."""
        with self._lock:
            k = len(self._status)
            if k == len(self._rows["time_s"]):
                self._grow()
            for field, value in _values(estimate).items():
                self._rows[field][k] = value
            self._records[estimate.time_s] = estimate.records
            self._status.append(estimate.status)

    def finish(self, story: Story) -> None:
        """The run has ended: from now on its result folder is shown."""
        self._finished = Edition((story,), len(self._status) + 1, is_live=False)

    @property
    def edition(self) -> Edition:
        """All frames so far."""
        if self._finished is not None:
            return self._finished
        with self._lock:
            n = len(self._status)
            if self._newest.number != n:
                story = replace(
                    self._empty,
                    track=self._track(n),
                    position_covariance=self._rows["position_covariance"][:n],
                    com_covariance=self._rows["com_covariance"][:n],
                )
                self._newest = Edition((story,), n, is_live=True)
            return self._newest

    def _grow(self) -> None:
        """Room for twice as many; what was handed out keeps the old arrays."""
        for field, rows in self._rows.items():
            grown = np.full((2 * len(rows), *rows.shape[1:]), np.nan)
            grown[: len(rows)] = rows
            self._rows[field] = grown

    def _track(self, n: int) -> Track:
        rows = {field: values[:n] for field, values in self._rows.items()}
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
            status=tuple(self._status),
            nis=rows["nis"],
            nis_dof=rows["nis_dof"].astype(np.intp),
            window_nis=rows["window_nis"],
            explained=rows["explained"],
            n_rectangles=rows["n_rectangles"].astype(np.intp),
        )


def run_live(
    sequence: Path,
    out: Path,
    pipeline: Pipeline,
    target_mesh: Path | None,
    *,
    overwrite: bool,
    port: int,
    on_served: Callable[[LocalServer], None],
    on_progress: Callable[[int, int], None],
) -> tuple[RunSummary, LocalServer]:
    """Run a depth sequence as `pcnav.pipeline.run` does, with a view of it on this machine.

    The view shows the finished run once there is one; the caller keeps the process alive for it.
    Raises `InputError`.
    """
    begun: list[tuple[LiveRun, LocalServer]] = []

    def on_start(opened: Sequence, target: Target, as_run: Pipeline) -> None:
        live = LiveRun(out.name, opened, target, as_run)
        server = serve(live, LOOPBACK, port)
        begun.append((live, server))
        on_served(server)

    def on_estimate(estimate: FrameEstimate, total: int) -> None:
        begun[0][0].add(estimate)
        on_progress(estimate.index + 1, total)

    try:
        summary = run(
            sequence,
            out,
            pipeline,
            target_mesh=target_mesh,
            overwrite=overwrite,
            on_start=on_start,
            on_estimate=on_estimate,
        )
        live, server = begun[0]
        live.finish(load_story(summary.folder))
    except BaseException:
        for _, served in begun:
            served.stop()
        raise
    return summary, server


def _values(estimate: FrameEstimate) -> dict[str, FloatArray | float]:
    """The numbers of a frame by field; those of a state only where there is one."""
    values: dict[str, FloatArray | float] = {
        "time_s": estimate.time_s,
        "nis": estimate.nis,
        "nis_dof": float(estimate.nis_dof),
        "window_nis": estimate.window_nis,
        "explained": estimate.explained,
        "n_rectangles": float(estimate.n_rectangles),
    }
    state, P, T = estimate.state, estimate.covariance, estimate.T_cam_model
    if state is None or P is None or T is None:
        return values
    return values | {
        "r_hill": state.r_hill,
        "v_hill": state.v_hill,
        "com_model": state.com_model,
        "R_world_body": state.R_world_body,
        "omega_body": state.omega_body,
        "inertia_ratios": state.inertia_ratios,
        "sd": np.sqrt(np.maximum(np.diagonal(P), 0.0)),
        "T_cam_model": T,
        "position_covariance": P[R_HILL, R_HILL],
        "com_covariance": P[COM_MODEL, COM_MODEL],
    }
