"""What an estimator on stereo tracks answers, whatever its own state."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from pcnav.core.arrays import FloatArray, IntArray
from pcnav.core.spatial import make_transform
from pcnav.dynamics.blocks import ATTITUDE, MOTION_LAYOUT, POSITION, RATE, RATIOS, VELOCITY
from pcnav.dynamics.kepler import KeplerOrbit
from pcnav.recordings.tracks import TrackFrame
from pcnav.runs.estimate import Estimate, FeaturePoint, FeatureUse, Output
from pcnav.runs.feature_outcomes import GATED, REFUSED, TRACKED, FeatureOutcomes
from pcnav.runs.records import ACCEPTED

_COUNTS = ("n_features", "n_used", "n_rejected")


@dataclass(frozen=True)
class Motion:
    """Motion and mass properties of a target without a model, in the estimator's own body axes."""

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
    """(17, 17) in the order of `MOTION_LAYOUT`; rows of what the estimator holds fixed are zero."""
    points: Mapping[int, FeaturePoint]


@dataclass(frozen=True)
class Used:
    """What became of the features of a frame, and of the innovation of those used."""

    used: tuple[int, ...] = ()
    rejected: tuple[int, ...] = ()
    nis: float = float("nan")
    nis_dof: int = 0
    squared: Mapping[int, float] = field(default_factory=dict)
    """From the prediction, over the covariance of the innovation, of those that were asked for."""
    gate: float = float("nan")
    """What it stays below of those used."""

    def outcomes(self, seen: IntArray) -> FeatureOutcomes:
        """Of all features (n,) of the frame."""
        words = dict.fromkeys(self.used, ACCEPTED)
        words |= {name: GATED if name in self.squared else REFUSED for name in self.rejected}
        names = seen.tolist()
        squared = np.array([self.squared.get(name, np.nan) for name in names])
        outcome = tuple(words.get(name, TRACKED) for name in names)
        return FeatureOutcomes(seen, outcome, squared, self.gate)


def stereo_output(notes: tuple[str, ...]) -> Output:
    """Of an estimator with notes of its own."""
    notes = (*_COUNTS, *notes)
    return Output(MOTION_LAYOUT, notes=notes, has_features=True, has_feature_outcomes=True)


def stereo_estimate(
    frame: TrackFrame,
    orbit: KeplerOrbit,
    status: str,
    motion: Motion | None = None,
    of: Used = Used(),
    notes: Mapping[str, float] | None = None,
) -> Estimate:
    """The answer at the time of a frame as recorded; ``motion`` is None without an estimate."""
    seen = tuple(frame.features.tolist())
    counts = dict(zip(_COUNTS, (len(seen), len(of.used), len(of.rejected)), strict=True))
    values, T_rig_body = {}, None
    if motion is not None:
        values = {
            POSITION.name: motion.r_hill,
            VELOCITY.name: motion.v_hill,
            ATTITUDE.name: motion.R_world_body,
            RATE.name: motion.omega_body,
            RATIOS.name: motion.inertia_ratios,
        }
        p_world = orbit.R_hill_world(frame.time_s).T @ motion.r_hill
        R = frame.R_cam_world
        T_rig_body = make_transform(R @ motion.R_world_body, np.asarray(R @ p_world))
    return Estimate(
        time_s=frame.time_s,
        status=status,
        values=values,
        covariance=None if motion is None else motion.covariance,
        T_cam_target=T_rig_body,
        nis=of.nis,
        nis_dof=of.nis_dof,
        notes={**counts, **(notes or {})},
        features=FeatureUse(
            *(seen, of.used, of.rejected, {} if motion is None else motion.points),
            of.outcomes(frame.features),
        ),
    )
