"""Takes in a run frame by frame and keeps it in memory, where nothing is written or it is shown."""

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from pcnav.config.pipeline_file import Pipeline
from pcnav.core.arrays import FloatArray
from pcnav.dynamics.blocks import ATTITUDE, Block, Layout
from pcnav.dynamics.trajectory import Trajectory
from pcnav.runs.estimate import OWN_WORDS, Estimate, Output
from pcnav.runs.nis_window import NisWindow
from pcnav.runs.run import Run, Segment

_FIRST_ROWS = 256


class RunCollector:
    """The run so far, whenever it is asked for; what was handed out does not change.

    ``kept`` are the blocks whose joint covariance is kept, all of them unless given: that of 20
    states takes 3 kB a frame, all other numbers about 700 bytes.
    """

    def __init__(
        self,
        output: Output,
        estimator: str = "",
        *,
        name: str = "",
        pipeline: Pipeline | None = None,
        kept: Layout | None = None,
    ) -> None:
        self._output, self._estimator = output, estimator
        self._name, self._pipeline = name, pipeline
        self.kept = output.layout if kept is None else kept
        layout, size = output.layout, self.kept.size
        rows = [np.arange(layout.size)[layout.slice_of(block)] for block in self.kept.blocks]
        self._kept_rows = np.concatenate([np.zeros(0, dtype=np.intp), *rows])
        self._words: dict[str, list[str]] = {w: [] for w in output.notes if w in OWN_WORDS}
        self._numbers = tuple(name for name in output.notes if name not in OWN_WORDS)
        names = ("time_s", "nis", "nis_dof", "window_nis", *self._numbers)
        shapes: dict[str, tuple[int, ...]] = dict.fromkeys(names, ())
        shapes |= {b.name: (3, 3) if b is ATTITUDE else (b.size,) for b in output.blocks}
        shapes |= {"sd": (layout.size,), "covariance": (size, size), "T_cam_target": (4, 4)}
        self._type = np.dtype([(name, np.float64, shape) for name, shape in shapes.items()])
        self._rows = self._unknown(_FIRST_ROWS)
        self._status: list[str] = []
        self._segments: list[Segment] = []
        self._window = NisWindow()

    def __len__(self) -> int:
        return len(self._status)

    def add(self, estimate: Estimate) -> None:
        """Append a frame."""
        if len(self) == len(self._rows):
            # What was handed out keeps the old array.
            self._rows = np.concatenate([self._rows, self._unknown(len(self))])
        row, P = self._rows[len(self)], estimate.covariance
        row["time_s"], row["nis"], row["nis_dof"] = estimate.time_s, estimate.nis, estimate.nis_dof
        window = self._window.follow(estimate.has_estimate, estimate.nis, estimate.nis_dof)
        row["window_nis"] = window if estimate.window_nis is None else estimate.window_nis
        for name in self._numbers:
            note = estimate.notes.get(name)
            row[name] = note if isinstance(note, float | int) else np.nan
        for name, words in self._words.items():
            words.append(str(estimate.notes.get(name) or ""))
        for name, values in estimate.values.items():
            row[name] = values
        if P is not None:
            # Rounding may leave a variance that should be zero slightly below it.
            row["sd"] = np.sqrt(np.maximum(np.diagonal(P), 0.0))
            row["covariance"] = P[np.ix_(self._kept_rows, self._kept_rows)]
        if estimate.T_cam_target is not None:
            row["T_cam_target"] = estimate.T_cam_target
        if estimate.new_axes is not None:
            self._segments.append(Segment(estimate.time_s, estimate.new_axes))
        self._status.append(str(estimate.status))

    def run(self) -> Run:
        """All frames so far; its covariance where that of all blocks is kept."""
        output, rows = self._output, self._rows[: len(self)]
        has_sd, has_all = bool(output.layout.blocks), self.kept == output.layout
        trajectory = Trajectory(
            time_s=rows["time_s"],
            layout=output.layout,
            values={block.name: rows[block.name] for block in output.blocks},
            sd=rows["sd"] if has_sd else None,
            covariance=rows["covariance"] if has_sd and has_all else None,
            T_cam_target=rows["T_cam_target"] if output.has_poses else None,
        )
        return Run(
            name=self._name,
            folder=None,
            estimator=self._estimator,
            pipeline=self._pipeline,
            trajectory=trajectory,
            status=tuple(self._status),
            nis=rows["nis"],
            nis_dof=np.nan_to_num(rows["nis_dof"]).astype(np.intp),
            window_nis=rows["window_nis"],
            notes={name: rows[name] for name in self._numbers},
            words={name: tuple(words) for name, words in self._words.items()},
            segments=tuple(self._segments),
            is_finished=False,
        )

    def covariance_of(self, block: Block) -> FloatArray:
        """(n, k, k) of a block among those kept."""
        rows = self.kept.slice_of(block)
        return np.asarray(self._rows["covariance"][: len(self), rows, rows])

    def _unknown(self, n: int) -> npt.NDArray[Any]:
        return np.full(n, np.nan, self._type)


def collected(estimator: str, output: Output, estimates: Iterable[Estimate]) -> Run:
    """The run, with its covariances, of estimates that are at hand and were written nowhere."""
    collector = RunCollector(output, estimator)
    for estimate in estimates:
        collector.add(estimate)
    return replace(collector.run(), is_finished=True)
