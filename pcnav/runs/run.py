"""A result folder as loaded: one type for every estimator, finished or not."""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from pcnav.config.pipeline_file import Pipeline
from pcnav.core.arrays import BoolArray, FloatArray, IntArray
from pcnav.dynamics.trajectory import Trajectory
from pcnav.runs.status import CLAIMED


@dataclass(frozen=True)
class Segment:
    """A frame from which on the body axes are new, as those of images of one camera may be."""

    time_s: float
    R_world_body: FloatArray
    """(3, 3) the attitude there, which defines the axes."""


@dataclass(frozen=True, repr=False)
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

    def __repr__(self) -> str:
        counts = ", ".join(f"{n} {word}" for word, n in Counter(self.status).items())
        state = "" if self.is_finished else ", unfinished"
        told = f" ({counts})" if counts else ""
        return f"<Run {self.name}: {len(self)} frames of {self.estimator}{told}{state}>"

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

    @property
    def claimed(self) -> BoolArray:
        """(n,) frames whose estimate the estimator stands for."""
        stands = np.array([word in CLAIMED for word in self.status], dtype=np.bool_)
        return stands & self.has_estimate

    @property
    def final_frame(self) -> int | None:
        """The last that the estimator stands for, else the last with an estimate; None without one:
        the frame of which all that is said of the end of a run is said."""
        claimed = self.claimed
        known = np.flatnonzero(claimed if claimed.any() else self.has_estimate)
        return int(known[-1]) if known.size else None


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
