"""What a run comes to: errors of every frame against the truth, and values of the whole run."""

from dataclasses import dataclass

import numpy as np

from pcnav.batch.following import BOUNDED, Followed
from pcnav.core.arrays import BoolArray, FloatArray
from pcnav.core.spatial import rotation_angle, xyzw_from_rotation
from pcnav.dynamics.state import COM_MODEL, INERTIA_RATIOS, OMEGA_BODY, V_HILL
from pcnav.evaluation.metrics import BLOCKS, squared_normalised_errors
from pcnav.evaluation.model_distance import model_distances, surface_points
from pcnav.evaluation.track_errors import (
    TrackErrors,
    Truth,
    best_symmetry,
    relabelled,
    track_errors,
)
from pcnav.evaluation.trajectory import absolute_errors, relative_errors, root_mean_square
from pcnav.runs.results import Track
from pcnav.runs.status import Status
from pcnav.target.satellite import Target

CLAIMS = frozenset({str(Status.LOCKED), str(Status.AMBIGUOUS)})
"""The statuses that say that a pose can be relied on."""
RIGHT_FRACTION, RIGHT_DEG = 0.1, 10.0
"""A lock within this share of the target's diameter and this angle is right."""
_POSE_COLUMNS = ("tx_m", "ty_m", "tz_m", "qx", "qy", "qz", "qw")
_SCALE = {"position": 1.0, "attitude": np.rad2deg(1.0), "rate": np.rad2deg(1.0)}
_BOUND_COLUMNS = (
    "crb_position_m",
    "crb_attitude_deg",
    "crb_rate_deg_s",
    "crb_com_m",
    "crb_inertia_ratio",
)


@dataclass(frozen=True)
class Verdict:
    """The numbers of one run, as a record keeps them."""

    columns: dict[str, FloatArray | list[str]]
    """One value a frame, nan where there is none."""
    values: dict[str, float]


def judge(followed: Followed, truth: Truth, target: Target, *, remembers: bool = True) -> Verdict:
    """Compare what an estimator said with the truth.

    Up to symmetry means: with the one equivalent truth that fits the run best. An estimator that
    does not remember may take another in every frame.
    """
    track = followed.track
    if not remembers:
        nearest = _nearest_equivalent(track, truth, target.symmetry_transforms)
        told = Truth(truth.time_s, T_cam_model=nearest)
    else:
        symmetry = best_symmetry(track, truth, target.symmetry_transforms)
        told = relabelled(truth, target.symmetry_transforms[symmetry])
    assert truth.T_cam_model is not None and told.T_cam_model is not None, "of a simulated motion"
    errors = track_errors(track, told)
    distances = model_distances(
        surface_points(target.mesh, target.symmetry_transforms),
        truth.T_cam_model,
        track.T_cam_model,
    )
    columns: dict[str, FloatArray | list[str]] = {
        "time_s": track.time_s,
        "status": list(track.status),
        **_pose_errors(track_errors(track, truth), ""),
        **_pose_errors(errors, "sym_"),
        "add_m": distances.add_m,
        "add_s_m": distances.add_s_m,
        **_state_errors(errors),
        **_consistency(errors, track),
        **_bounds(followed.bound),
        "frame_ms": 1e3 * followed.frame_s,
        **_poses("est", track.T_cam_model),
        **_poses("true", truth.T_cam_model),
    }
    values = _trajectory(told.T_cam_model, track.T_cam_model) | _locking(track, errors, target)
    values["ms_per_frame"] = 1e3 * float(np.mean(followed.frame_s))
    values["frames"] = float(len(track))
    return Verdict(columns, values)


def _nearest_equivalent(track: Track, truth: Truth, symmetries: FloatArray) -> FloatArray:
    """(n, 4, 4) of the equivalent true poses those nearest in attitude, frame by frame."""
    assert truth.T_cam_model is not None, "of a simulated motion"
    options = truth.T_cam_model[:, None] @ symmetries
    between = np.swapaxes(track.T_cam_model[:, None, :3, :3], -1, -2) @ options[..., :3, :3]
    known = np.isfinite(between).all(axis=(1, 2, 3))
    choice = np.zeros(len(track), dtype=np.intp)
    choice[known] = rotation_angle(between[known]).argmin(axis=1)
    return np.asarray(options[np.arange(len(track)), choice])


def _pose_errors(errors: TrackErrors, told: str) -> dict[str, FloatArray]:
    return {
        f"position_{told}error_m": _norm(errors.p_cam_m),
        f"attitude_{told}error_deg": np.rad2deg(_norm(errors.theta_model_rad)),
    }


def _state_errors(errors: TrackErrors) -> dict[str, FloatArray]:
    return {
        "velocity_error_m_s": _norm(errors.state[:, V_HILL]),
        "rate_error_deg_s": np.rad2deg(_norm(errors.state[:, OMEGA_BODY])),
        "com_error_m": _norm(errors.state[:, COM_MODEL]),
        "inertia_ratio_error": _norm(errors.state[:, INERTIA_RATIOS]),
    }


def _consistency(errors: TrackErrors, track: Track) -> dict[str, FloatArray]:
    assert track.covariance is not None, "a followed track has them"
    nees = {
        f"nees_{name}": squared_normalised_errors(
            errors.state[:, block], track.covariance[:, block, block]
        )
        for name, block in BLOCKS.items()
    }
    return nees | {"nis": track.nis, "nis_dof": track.nis_dof.astype(np.float64)}


def _bounds(bound: FloatArray) -> dict[str, FloatArray]:
    return {
        column: _SCALE.get(name, 1.0) * bound[:, k]
        for k, (column, name) in enumerate(zip(_BOUND_COLUMNS, BOUNDED, strict=True))
    }


def _poses(whose: str, T: FloatArray) -> dict[str, FloatArray]:
    known = np.isfinite(T).all(axis=(1, 2))
    rows = np.full((len(T), len(_POSE_COLUMNS)), np.nan)
    rows[:, :3] = T[:, :3, 3]
    if known.any():
        rows[known, 3:] = xyzw_from_rotation(T[known, :3, :3])
    return {f"{whose}_{name}": rows[:, k].copy() for k, name in enumerate(_POSE_COLUMNS)}


def _trajectory(T_true: FloatArray, T_estimated: FloatArray) -> dict[str, float]:
    """Over the frames with a pose, as they follow each other; nothing is aligned."""
    known = np.isfinite(T_estimated).all(axis=(1, 2))
    relative = relative_errors(T_true[known], T_estimated[known])
    return {
        "ate_rmse_m": root_mean_square(absolute_errors(T_true[known], T_estimated[known])),
        "rpe_translation_rmse_m": root_mean_square(relative.translation_m),
        "rpe_rotation_rmse_deg": float(np.rad2deg(root_mean_square(relative.rotation_rad))),
    }


def _locking(track: Track, errors: TrackErrors, target: Target) -> dict[str, float]:
    claims: BoolArray = np.array([word in CLAIMS for word in track.status])
    # Comparisons with nan are false: a claim without a pose is wrong.
    near = _norm(errors.p_cam_m) <= RIGHT_FRACTION * target.diameter_m
    near &= np.rad2deg(_norm(errors.theta_model_rad)) <= RIGHT_DEG
    locks = np.flatnonzero(claims)
    first = int(locks[0]) if locks.size else len(track)
    elapsed_s = track.time_s[first] - track.time_s[0] if locks.size else np.nan
    return {
        "time_to_lock_s": float(elapsed_s),
        "share_locked_right": float(np.mean(claims & near)),
        "share_locked_wrong": float(np.mean(claims & ~near)),
        "share_unlocked": float(np.mean(~claims)),
        "frames_lost": float(np.count_nonzero(~claims[first:])),
    }


def _norm(vectors: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.norm(vectors, axis=1))
