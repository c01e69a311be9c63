"""A run, and its errors, as the reports of the single kinds take them."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from pcnav.core.arrays import BoolArray, FloatArray, IntArray
from pcnav.dynamics.blocks import (
    ATTITUDE,
    CENTRE,
    MASS_CENTRE_LAYOUT,
    POSITION,
    RATE,
    RATIOS,
    VELOCITY,
    Layout,
)
from pcnav.estimators.image_motion.rates import continuous_xyzw
from pcnav.evaluation.errors import Errors
from pcnav.runs.reader import read_features
from pcnav.runs.run import FeatureTable, Run

R_HILL, V_HILL = slice(0, 3), slice(3, 6)
THETA_BODY, OMEGA_BODY, INERTIA_RATIOS = slice(6, 9), slice(9, 12), slice(12, 17)
"""Of the error state of a target without a model."""
ERROR_SIZE = 17


@dataclass(frozen=True)
class Track:
    """The columns of a run on depth frames; nan in frames without an estimate."""

    time_s: FloatArray
    r_hill: FloatArray
    v_hill: FloatArray
    com_model: FloatArray
    R_world_body: FloatArray
    omega_body: FloatArray
    inertia_ratios: FloatArray
    sd: FloatArray
    """(n, 20)"""
    T_cam_model: FloatArray
    status: tuple[str, ...]
    nis: FloatArray
    nis_dof: IntArray
    window_nis: FloatArray
    inlier_ratio: FloatArray
    n_rectangles: IntArray
    covariance: FloatArray | None = None

    def __len__(self) -> int:
        return len(self.time_s)

    @property
    def has_estimate(self) -> BoolArray:
        """(n,)"""
        return np.asarray(np.isfinite(self.r_hill[:, 0]))


@dataclass(frozen=True)
class TrackErrors:
    """Errors of such a run."""

    p_cam_m: FloatArray
    theta_model_rad: FloatArray
    state: FloatArray
    """(n, 20)"""

    @property
    def has_pose(self) -> BoolArray:
        """(n,)"""
        return np.asarray(np.isfinite(self.p_cam_m).all(axis=1))

    @property
    def has_state(self) -> BoolArray:
        """(n,)"""
        return np.asarray(np.isfinite(self.state).all(axis=1))


@dataclass(frozen=True, kw_only=True)
class FeatureTrack(Track):
    """A run on stereo tracks; its mass centre is 0."""

    sd17: FloatArray
    n_features: IntArray
    n_used: IntArray
    n_rejected: IntArray
    notes: Mapping[str, FloatArray]
    features: FeatureTable | None


@dataclass(frozen=True)
class ImageTrack:
    """A run on images of one camera."""

    time_s: FloatArray
    R_world_body: FloatArray
    omega_body: FloatArray
    sd: FloatArray
    status: tuple[str, ...]
    outcome: tuple[str, ...]
    segment: IntArray
    n_features: IntArray
    n_matches: IntArray
    n_agreeing: IntArray

    def __len__(self) -> int:
        return len(self.time_s)

    @property
    def has_attitude(self) -> BoolArray:
        """(n,)"""
        return np.asarray(np.isfinite(self.R_world_body[:, 0, 0]))

    @property
    def xyzw(self) -> FloatArray:
        """(n, 4) without jumps of sign within a segment."""
        values, known = np.full((len(self), 4), np.nan), self.has_attitude
        if known.any():
            values[known] = continuous_xyzw(self.R_world_body[known], self.segment[known])
        return values


@dataclass(frozen=True)
class AttitudeTrack:
    """A run on attitudes."""

    time_s: FloatArray
    omega_body: FloatArray
    inertia_ratios: FloatArray
    sd: FloatArray
    measured_sd: FloatArray

    def __len__(self) -> int:
        return len(self.time_s)

    @property
    def has_estimate(self) -> BoolArray:
        """(n,)"""
        return np.asarray(np.isfinite(self.omega_body[:, 0]))


def track_of(run: Run) -> Track:
    """Of any run; nan where it knows nothing."""
    return Track(**_fields(run))


def feature_track_of(run: Run) -> FeatureTrack:
    """Of a run on stereo tracks."""
    fields = _fields(run)
    fields["com_model"] = np.zeros((len(run), 3))
    names = ("n_features", "n_used", "n_rejected")
    counts: dict[str, Any] = {name: _counts(run, name) for name in names}
    assert run.trajectory.sd is not None, "such a run has deviations"
    own = {name: values for name, values in run.notes.items() if name not in counts}
    features = None if run.folder is None else read_features(run.folder)
    return FeatureTrack(**fields, **counts, sd17=run.trajectory.sd, notes=own, features=features)


def image_track_of(run: Run) -> ImageTrack:
    """Of a run on images."""
    trajectory = run.trajectory
    return ImageTrack(
        time_s=run.time_s,
        R_world_body=trajectory[ATTITUDE],
        omega_body=trajectory[RATE],
        sd=trajectory.sd_of(ATTITUDE),
        status=run.status,
        outcome=run.words["outcome"],
        segment=_counts(run, "segment"),
        n_features=_counts(run, "features"),
        n_matches=_counts(run, "matches"),
        n_agreeing=_counts(run, "agreeing"),
    )


def attitude_track_of(run: Run) -> AttitudeTrack:
    """Of a run on attitudes."""
    trajectory = run.trajectory
    assert trajectory.sd is not None, "such a run has deviations"
    return AttitudeTrack(
        time_s=run.time_s,
        omega_body=trajectory[RATE],
        inertia_ratios=trajectory[RATIOS],
        sd=trajectory.sd,
        measured_sd=run.notes["sd_measured_rad"],
    )


def track_errors_of(errors: Errors) -> TrackErrors:
    """Of any run."""
    return TrackErrors(errors.p_cam_m, errors.theta_model_rad, stacked(errors, MASS_CENTRE_LAYOUT))


def stacked(errors: Errors, layout: Layout) -> FloatArray:
    """(n, size) the errors of the blocks of a layout beside each other, nan of those missing."""
    state = np.full((len(errors.p_cam_m), layout.size), np.nan)
    for block in layout.blocks:
        if block.name in errors.state:
            state[:, layout.slice_of(block)] = errors[block]
    return state


def _fields(run: Run) -> dict[str, Any]:
    trajectory, n = run.trajectory, len(run)
    sd = np.full((n, MASS_CENTRE_LAYOUT.size), np.nan)
    values = {}
    for block in MASS_CENTRE_LAYOUT.blocks:
        sd[:, MASS_CENTRE_LAYOUT.slice_of(block)] = trajectory.sd_of(block)
        shape = (n, 3, 3) if block is ATTITUDE else (n, block.size)
        values[block] = trajectory.values.get(block.name, np.full(shape, np.nan))
    pose = trajectory.T_cam_target
    return {
        "time_s": run.time_s,
        "r_hill": values[POSITION],
        "v_hill": values[VELOCITY],
        "com_model": values[CENTRE],
        "R_world_body": values[ATTITUDE],
        "omega_body": values[RATE],
        "inertia_ratios": values[RATIOS],
        "sd": sd,
        "T_cam_model": np.full((n, 4, 4), np.nan) if pose is None else pose,
        "status": run.status,
        "nis": run.nis,
        "nis_dof": run.nis_dof,
        "window_nis": run.window_nis,
        "inlier_ratio": run.notes.get("inlier_ratio", np.full(n, np.nan)),
        "n_rectangles": _counts(run, "n_rectangles"),
        "covariance": trajectory.covariance,
    }


def _counts(run: Run, name: str) -> IntArray:
    return np.nan_to_num(run.notes.get(name, np.zeros(len(run)))).astype(np.intp)
