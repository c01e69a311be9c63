"""What an estimator that lives on feature tracks says after each frame, whatever its own state."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Protocol

from pcnav.core.arrays import FloatArray
from pcnav.recordings.tracks import TrackFrame


@dataclass(frozen=True)
class FeaturePoint:
    """A point of the target as estimated."""

    p_body: FloatArray
    """(3,) from the mass centre, body axes, m."""
    covariance: FloatArray
    """(3, 3) m^2."""


@dataclass(frozen=True)
class MotionEstimate:
    """Motion and mass properties of a target without a model.

    The body axes are the estimator's own: for Hu 2024 the unique principal ones.
    """

    r_hill: FloatArray
    """(3,) mass centre from the chaser's, Hill axes, m."""
    v_hill: FloatArray
    """(3,) its rate of change in Hill axes, m/s."""
    R_world_body: FloatArray
    """(3, 3)"""
    omega_body: FloatArray
    """(3,) inertial angular velocity, body axes, rad/s."""
    inertia_ratios: FloatArray
    """(5,) Iyy, Izz, Ixy, Ixz, Iyz over Ixx, body axes."""
    covariance: FloatArray
    """(17, 17) of r (m), v (m/s), attitude error theta in body axes (rad), omega, ratios: the order
    of the fields. Rows of what the estimator holds fixed are zero."""
    features: Mapping[int, FeaturePoint]


@dataclass(frozen=True)
class FeatureEstimate:
    """One frame's estimate."""

    time_s: float
    status: str
    """A `pcnav.runs.status.Status`: acquiring, locked, ambiguous, coasting, lost."""
    motion: MotionEstimate | None
    """None while acquiring."""
    used: tuple[int, ...] = ()
    """Features that the filter used."""
    rejected: tuple[int, ...] = ()
    """Features that failed the gate: wrong matches."""
    nis: float = float("nan")
    nis_dof: int = 0
    notes: Mapping[str, float] = field(default_factory=dict)
    """Numbers of the estimator's own, by column name with unit: hypothesis weights, p_x, ..."""


class FeatureEstimator(Protocol):
    """Takes in frames of tracks in order of time."""

    def step(self, frame: TrackFrame) -> FeatureEstimate:
        """Estimate at the time of the frame. Raises `InputError` for a frame that cannot be."""
