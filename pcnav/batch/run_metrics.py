"""What a run comes to: errors of every frame against the truth, and values of the whole run.

A column or value that does not apply to a run is absent, not empty.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from pcnav.core.arrays import BoolArray, FloatArray
from pcnav.core.spatial import xyzw_from_rotation
from pcnav.dynamics.trajectory import Trajectory
from pcnav.estimators.interface import AxesPolicy
from pcnav.evaluation.bop_errors import (
    MSSD_THRESHOLDS,
    bop_errors,
    bop_vertices,
    mspd_thresholds_px,
    recall,
)
from pcnav.evaluation.consistency import squared_errors
from pcnav.evaluation.errors import Errors, errors
from pcnav.evaluation.metrics import QUANTITIES, UNIT_SUFFIX
from pcnav.evaluation.model_distance import model_distances, surface_points
from pcnav.evaluation.trajectory import absolute_errors, relative_errors, root_mean_square
from pcnav.runs.run import Run
from pcnav.runs.status import CLAIMED, WRONG_SHIFT_FRACTION, WRONG_TURN_RAD, Status
from pcnav.target.satellite import Target

BOUNDED = {
    "crb_position_m": 1.0,
    "crb_attitude_deg": float(np.rad2deg(1.0)),
    "crb_rate_deg_s": float(np.rad2deg(1.0)),
    "crb_com_m": 1.0,
    "crb_inertia_ratio": 1.0,
}
"""Columns of the bound, and their scale from SI."""
INLIER_RATIO = "inlier_ratio"
"""The share of what is seen that the estimate explains."""
_Columns = dict[str, FloatArray]
_POSE_COLUMNS = ("tx_m", "ty_m", "tz_m", "qx", "qy", "qz", "qw")


@dataclass(frozen=True)
class Views:
    """The cameras of the frames of a run."""

    intrinsics: FloatArray
    """(n, 4) fx, fy, cx, cy, px."""
    width_px: int
    asked: BoolArray | None = None
    """(n,) frames that the recalls are over; None for all that have a truth."""


@dataclass(frozen=True)
class Followed:
    """What an estimator said of a recording."""

    run: Run
    """With its covariances."""
    frame_s: FloatArray
    """(n,) processor time on each frame."""
    bound: Mapping[str, FloatArray]
    """(n,) by column of `BOUNDED`: roots of the traces of the blocks of the bound of what is
    compared, SI, the least RMS error of the pose's position, the attitude, the rate, the mass
    centre and the inertia ratios. Empty where it does not hold."""
    views: Views | None = None
    """The cameras of depth frames, where the poses are compared in their images, too."""


@dataclass(frozen=True)
class RunMetrics:
    """The numbers of one run, as a record keeps them."""

    columns: dict[str, FloatArray | list[str]]
    """One value a frame, nan where there is none."""
    values: dict[str, float]
    """Of the run as a whole."""


def run_metrics(followed: Followed, truth: Trajectory | None, target: Target | None) -> RunMetrics:
    """Compare what an estimator said with the truth; without one, what can be said without.

    Errors are those of `QUANTITIES` in the axes that the registry says of the estimator; those of
    a pose of a target with a model also in the true axes. ``sym`` in a name means the former.
    Raises `InputError` for a truth that has no frame of the run.
    """
    columns, values = _told(followed)
    if truth is None:
        return RunMetrics(columns, values)
    run = followed.run
    symmetries = None if target is None else target.symmetry_transforms
    roundness = None if target is None else target.roundness
    found = errors(run, truth, symmetry_transforms=symmetries, roundness=roundness)
    plain = found if target is None else errors(run, truth, AxesPolicy.SAME)
    nees = squared_errors(run, found)
    columns |= {
        **_errors(plain, found),
        **_distances(followed, plain.truth, target),
        **{f"nees_{name}": squared for name, (squared, _) in nees.items()},
        **{name: BOUNDED[name] * bound for name, bound in followed.bound.items()},
    }
    values |= {f"nees_{name}_dof": float(degrees) for name, (_, degrees) in nees.items()}
    values |= _right(run, found, target) | _trajectory(found.truth, run.trajectory)
    return RunMetrics(columns, values)


def _told(followed: Followed) -> tuple[dict[str, FloatArray | list[str]], dict[str, float]]:
    """Columns and values that need no truth."""
    run = followed.run
    T = run.trajectory.T_cam_target
    columns: dict[str, FloatArray | list[str]] = {
        "time_s": run.time_s,
        "status": list(run.status),
        "nis": run.nis,
        "nis_dof": run.nis_dof.astype(np.float64),
        "frame_ms": 1e3 * followed.frame_s,
    }
    if T is not None:
        columns |= {"has_pose": np.isfinite(T[:, 0, 0]).astype(np.float64)} | _poses("est", T)
    if INLIER_RATIO in run.notes:
        columns[INLIER_RATIO] = run.notes[INLIER_RATIO]
    words = np.array(run.status)
    values = {f"share_{word}": float(np.mean(words == word)) for word in map(str, Status)}
    values |= _locking(run)
    values |= {"ms_per_frame": 1e3 * float(np.mean(followed.frame_s)), "frames": float(len(run))}
    return columns, values


def _errors(plain: Errors, found: Errors) -> dict[str, FloatArray]:
    """(n,) norms of what is estimated, by column."""
    columns = {}
    for quantity in filter(lambda each: each.name, QUANTITIES):
        vectors, ending = quantity.of(found), f"error{UNIT_SUFFIX[quantity.unit]}"
        if vectors is None or not np.isfinite(vectors).any():
            continue
        if quantity.of_pose:
            columns[f"{quantity.name}_sym_{ending}"] = _norm(vectors)
            vectors = quantity.of(plain)
            assert vectors is not None, "other axes have the same quantities"
        columns[f"{quantity.name}_{ending}"] = _norm(vectors)
    return columns


def _distances(followed: Followed, truth: Trajectory, target: Target | None) -> _Columns:
    """The true poses, and the distances of the model's points between them and the estimates."""
    T_true, T_run = truth.T_cam_target, followed.run.trajectory.T_cam_target
    if T_true is None or T_run is None or target is None:
        return {}
    points = surface_points(target.mesh, target.symmetry_transforms)
    distances = model_distances(points, T_true, T_run)
    columns = {"add_m": distances.add_m, "add_s_m": distances.add_s_m}
    return columns | _of_bop(followed.views, T_true, T_run, target) | _poses("true", T_true)


def _of_bop(views: Views | None, T_true: FloatArray, T_run: FloatArray, target: Target) -> _Columns:
    if views is None:
        return {}
    vertices, round_about = bop_vertices(target.mesh), target.roundness
    symmetries = target.symmetry_transforms
    found = bop_errors(vertices, T_true, T_run, symmetries, views.intrinsics, round_about)
    # A frame without a pose is one that was missed; one without a truth asks for nothing.
    known = np.isfinite(T_true[:, 0, 0])
    is_asked = np.where(known if views.asked is None else known & views.asked, 1.0, np.nan)
    in_space = recall(found.mssd_m, float(target.diameter_m) * MSSD_THRESHOLDS)
    in_image = recall(found.mspd_px, mspd_thresholds_px(views.width_px))
    return {
        **{"mssd_m": found.mssd_m, "mspd_px": found.mspd_px},
        **{"recall_mssd": is_asked * in_space, "recall_mspd": is_asked * in_image},
    }


def _poses(whose: str, T: FloatArray) -> dict[str, FloatArray]:
    known = np.isfinite(T).all(axis=(1, 2))
    rows = np.full((len(T), len(_POSE_COLUMNS)), np.nan)
    rows[:, :3] = T[:, :3, 3]
    if known.any():
        rows[known, 3:] = xyzw_from_rotation(T[known, :3, :3])
    return {f"{whose}_{name}": rows[:, k].copy() for k, name in enumerate(_POSE_COLUMNS)}


def _trajectory(truth: Trajectory, run: Trajectory) -> dict[str, float]:
    """Over the frames with a pose, as they follow each other; nothing is aligned."""
    T_true, T_run = truth.T_cam_target, run.T_cam_target
    if T_true is None or T_run is None:
        return {}
    known = np.isfinite(T_run).all(axis=(1, 2)) & np.isfinite(T_true).all(axis=(1, 2))
    translation_m, rotation_rad = relative_errors(T_true[known], T_run[known])
    return {
        "ate_rmse_m": root_mean_square(absolute_errors(T_true[known], T_run[known])),
        "rpe_translation_rmse_m": root_mean_square(translation_m),
        "rpe_rotation_rmse_deg": float(np.rad2deg(root_mean_square(rotation_rad))),
    }


def _locking(run: Run) -> dict[str, float]:
    claims = _claims(run)
    locks = np.flatnonzero(claims)
    first = int(locks[0]) if locks.size else len(run)
    elapsed_s = run.time_s[first] - run.time_s[0] if locks.size else np.nan
    return {
        "time_to_lock_s": float(elapsed_s),
        "share_unlocked": float(np.mean(~claims)),
        "frames_lost": float(np.count_nonzero(~claims[first:])),
    }


def _right(run: Run, found: Errors, target: Target | None) -> dict[str, float]:
    """Shares of the frames that have a truth."""
    T_true = found.truth.T_cam_target
    known = np.ones(len(run), dtype=np.bool_) if T_true is None else np.isfinite(T_true[:, 0, 0])
    claims = _claims(run)[known]
    attitude = next(quantity.of(found) for quantity in QUANTITIES if quantity.name == "attitude")
    assert attitude is not None, "all estimators have one"
    # Comparisons with nan are false: a claim without a pose is wrong.
    near = _norm(attitude) <= np.rad2deg(WRONG_TURN_RAD)
    if target is not None:
        near &= _norm(found.p_cam_m) <= WRONG_SHIFT_FRACTION * target.diameter_m
    return {
        "share_locked_right": float(np.mean(claims & near[known])),
        "share_locked_wrong": float(np.mean(claims & ~near[known])),
    }


def _claims(run: Run) -> BoolArray:
    """(n,) frames whose pose can be relied on, as the run says."""
    return np.array([word in CLAIMED for word in run.status])


def _norm(vectors: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.norm(vectors, axis=1))
