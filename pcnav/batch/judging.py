"""What a run comes to: errors of every frame against the truth, and values of the whole run."""

from dataclasses import dataclass

import numpy as np

from pcnav.batch.following import BOUNDED, Followed
from pcnav.core.arrays import BoolArray, FloatArray
from pcnav.core.spatial import xyzw_from_rotation
from pcnav.dynamics.blocks import CENTRE, RATE, RATIOS, VELOCITY, Block
from pcnav.dynamics.trajectory import Trajectory
from pcnav.estimators.interface import AxesPolicy
from pcnav.evaluation.consistency import squared_normalised_errors
from pcnav.evaluation.errors import Errors, errors
from pcnav.evaluation.metrics import BLOCKS
from pcnav.evaluation.model_distance import model_distances, surface_points
from pcnav.evaluation.trajectory import absolute_errors, relative_errors, root_mean_square
from pcnav.runs.run import Run
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


def judge(followed: Followed, truth: Trajectory, target: Target) -> Verdict:
    """Compare what an estimator said with the truth.

    Up to symmetry means: as the estimator's axes have it in the registry.
    """
    run, T_true = followed.run, truth.T_cam_target
    plain = errors(run, truth, AxesPolicy.SAME)
    found = errors(run, truth, symmetry_transforms=target.symmetry_transforms)
    T_told, T_run = found.truth.T_cam_target, run.trajectory.T_cam_target
    assert T_true is not None and T_told is not None and T_run is not None, "of simulated depth"
    distances = model_distances(
        surface_points(target.mesh, target.symmetry_transforms), T_true, T_run
    )
    columns: dict[str, FloatArray | list[str]] = {
        "time_s": run.time_s,
        "status": list(run.status),
        **_pose_errors(plain, ""),
        **_pose_errors(found, "sym_"),
        "add_m": distances.add_m,
        "add_s_m": distances.add_s_m,
        "velocity_error_m_s": _norm_of(found, VELOCITY),
        "rate_error_deg_s": np.rad2deg(_norm_of(found, RATE)),
        "com_error_m": _norm_of(found, CENTRE),
        "inertia_ratio_error": _norm_of(found, RATIOS),
        **_consistency(found, run),
        **_bounds(followed.bound),
        "frame_ms": 1e3 * followed.frame_s,
        **_poses("est", T_run),
        **_poses("true", T_true),
    }
    values = _trajectory(T_told, T_run) | _locking(run, found, target)
    values["ms_per_frame"] = 1e3 * float(np.mean(followed.frame_s))
    values["frames"] = float(len(run))
    return Verdict(columns, values)


def _pose_errors(found: Errors, told: str) -> dict[str, FloatArray]:
    return {
        f"position_{told}error_m": _norm(found.p_cam_m),
        f"attitude_{told}error_deg": np.rad2deg(_norm(found.theta_model_rad)),
    }


def _norm_of(found: Errors, block: Block) -> FloatArray:
    """(n,) nan of what the estimator does not estimate."""
    vectors = found.state.get(block.name)
    return np.full(len(found.p_cam_m), np.nan) if vectors is None else _norm(vectors)


def _consistency(found: Errors, run: Run) -> dict[str, FloatArray]:
    nees = {f"nees_{name}": np.full(len(run), np.nan) for name in BLOCKS}
    layout, P = run.trajectory.layout, run.trajectory.covariance
    if P is not None and layout.blocks:
        state = np.hstack([found[block] for block in layout.blocks])
        for name, block in BLOCKS.items():
            squared = squared_normalised_errors(state[:, block], P[:, block, block])
            nees[f"nees_{name}"] = squared
    return nees | {"nis": run.nis, "nis_dof": run.nis_dof.astype(np.float64)}


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
    shift_m, turn_rad = relative_errors(T_true[known], T_estimated[known])
    return {
        "ate_rmse_m": root_mean_square(absolute_errors(T_true[known], T_estimated[known])),
        "rpe_translation_rmse_m": root_mean_square(shift_m),
        "rpe_rotation_rmse_deg": float(np.rad2deg(root_mean_square(turn_rad))),
    }


def _locking(run: Run, found: Errors, target: Target) -> dict[str, float]:
    claims: BoolArray = np.array([word in CLAIMS for word in run.status])
    # Comparisons with nan are false: a claim without a pose is wrong.
    near = _norm(found.p_cam_m) <= RIGHT_FRACTION * target.diameter_m
    near &= np.rad2deg(_norm(found.theta_model_rad)) <= RIGHT_DEG
    locks = np.flatnonzero(claims)
    first = int(locks[0]) if locks.size else len(run)
    elapsed_s = run.time_s[first] - run.time_s[0] if locks.size else np.nan
    return {
        "time_to_lock_s": float(elapsed_s),
        "share_locked_right": float(np.mean(claims & near)),
        "share_locked_wrong": float(np.mean(claims & ~near)),
        "share_unlocked": float(np.mean(~claims)),
        "frames_lost": float(np.count_nonzero(~claims[first:])),
    }


def _norm(vectors: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.norm(vectors, axis=1))
