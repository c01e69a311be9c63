"""A result folder as loaded: one type for every estimator, finished or not."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from pcnav.config.pipeline_file import Pipeline
from pcnav.core.arrays import BoolArray, FloatArray, IntArray
from pcnav.dynamics.blocks import ATTITUDE, Block
from pcnav.dynamics.trajectory import Trajectory
from pcnav.runs.estimate import Estimate, Output
from pcnav.runs.nis_window import window_nis


@dataclass(frozen=True)
class Segment:
    """A frame from which on the body axes are new, as those of images of one camera may be."""

    time_s: float
    R_world_body: FloatArray
    """(3, 3) the attitude there, which defines the axes."""


@dataclass(frozen=True)
class Run:
    """All of a run that its tables tell, one row per frame."""

    name: str
    folder: Path | None
    """Where it was read from; None of one that was never written."""
    estimator: str
    """Key of the registry of estimators."""
    pipeline: Pipeline | None
    """As run; None where the folder does not tell."""
    trajectory: Trajectory
    """nan in frames without an estimate."""
    status: tuple[str, ...]
    nis: FloatArray
    """(n,) normalised innovation squared of what was used; nan without."""
    nis_dof: IntArray
    """(n,)"""
    window_nis: FloatArray
    """(n,) NIS per degree of freedom over the last frames, see `pcnav.runs.nis_window`."""
    notes: Mapping[str, FloatArray] = field(default_factory=dict)
    """(n,) the estimator's own numbers by column: inlier_ratio, n_rectangles, n_used, ..."""
    words: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    """n of the estimator's own words by column: outcome."""
    segments: tuple[Segment, ...] = ()
    """Empty where the body axes are given and stay."""
    is_finished: bool = True

    def __len__(self) -> int:
        return len(self.trajectory)

    @property
    def time_s(self) -> FloatArray:
        """(n,)"""
        return self.trajectory.time_s

    @property
    def has_estimate(self) -> BoolArray:
        """(n,) whether the frame has an estimate."""
        return self.trajectory.has_estimate


def collected(estimator: str, output: Output, estimates: Sequence[Estimate]) -> Run:
    """The run, with its covariances, of estimates that are at hand and were written nowhere."""
    n, layout = len(estimates), output.layout

    def stack(of: Callable[[Estimate], FloatArray | None], *shape: int) -> FloatArray:
        rows = np.full((n, *shape), np.nan)
        for k, estimate in enumerate(estimates):
            value = of(estimate)
            if value is not None:
                rows[k] = value
        return rows

    def values_of(block: Block) -> FloatArray:
        shape = (3, 3) if block is ATTITUDE else (block.size,)
        return stack(lambda estimate: estimate.values.get(block.name), *shape)

    def notes_of(name: str) -> FloatArray:
        notes = (estimate.notes.get(name) for estimate in estimates)
        return np.array([note if isinstance(note, float | int) else np.nan for note in notes])

    P = stack(lambda estimate: estimate.covariance, layout.size, layout.size)
    trajectory = Trajectory(
        time_s=np.array([estimate.time_s for estimate in estimates]),
        layout=layout,
        values={block.name: values_of(block) for block in output.blocks},
        sd=np.sqrt(np.maximum(np.diagonal(P, axis1=1, axis2=2), 0.0)),
        covariance=P,
        T_cam_target=stack(lambda estimate: estimate.T_cam_target, 4, 4),
    )
    nis = np.array([estimate.nis for estimate in estimates])
    dof = np.array([estimate.nis_dof for estimate in estimates], dtype=np.intp)
    window = window_nis(nis, dof, trajectory.has_estimate)
    for k, estimate in enumerate(estimates):
        if estimate.window_nis is not None:
            window[k] = estimate.window_nis
    return Run(
        name="",
        folder=None,
        estimator=estimator,
        pipeline=None,
        trajectory=trajectory,
        status=tuple(str(estimate.status) for estimate in estimates),
        nis=nis,
        nis_dof=dof,
        window_nis=window,
        notes={name: notes_of(name) for name in output.notes},
        segments=tuple(
            Segment(estimate.time_s, estimate.new_axes)
            for estimate in estimates
            if estimate.new_axes is not None
        ),
    )


@dataclass(frozen=True)
class PointTable:
    """Estimated points of a target without a model: one row a point of a frame."""

    time_s: FloatArray
    """(m,)"""
    feature: IntArray
    """(m,) its number."""
    p_body: FloatArray
    """(m, 3) from the mass centre, body axes, m."""


@dataclass(frozen=True)
class FeatureTable:
    """The features of a run, one row each: the points at its end and how often they were used."""

    feature: IntArray
    """(m,) numbers, increasing."""
    p_body: FloatArray
    """(m, 3) in the last estimate, m; nan where the point is not in it."""
    sd: FloatArray
    """(m, 3) m"""
    frames_seen: IntArray
    frames_rejected: IntArray
