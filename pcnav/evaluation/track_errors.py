"""Errors of a track against the truth, frame by frame."""

from dataclasses import dataclass, replace

import numpy as np

from pcnav.core.arrays import BoolArray, FloatArray, IntArray
from pcnav.core.errors import InputError
from pcnav.core.spatial import invert_transform, log_rotation, rotation_angle, transform_points
from pcnav.dynamics import blocks
from pcnav.dynamics.rigid_body import inertia_from_ratios, ratios_from_inertia
from pcnav.dynamics.state import (
    COM_MODEL,
    INERTIA_RATIOS,
    OMEGA_BODY,
    R_HILL,
    STATE_SIZE,
    THETA_BODY,
    V_HILL,
)
from pcnav.dynamics.trajectory import Trajectory
from pcnav.runs.results import Track


@dataclass(frozen=True)
class Truth:
    """A truth by field; None for what it does not say."""

    time_s: FloatArray
    r_hill: FloatArray | None = None
    v_hill: FloatArray | None = None
    com_model: FloatArray | None = None
    R_world_body: FloatArray | None = None
    omega_body: FloatArray | None = None
    inertia_ratios: FloatArray | None = None
    T_cam_model: FloatArray | None = None


def truth_of(truth: Trajectory | None) -> Truth | None:
    """A truth as the estimators' own evaluations take it."""
    if truth is None:
        return None
    values = truth.values.get
    return Truth(
        time_s=truth.time_s,
        r_hill=values(blocks.POSITION.name),
        v_hill=values(blocks.VELOCITY.name),
        com_model=values(blocks.CENTRE.name),
        R_world_body=values(blocks.ATTITUDE.name),
        omega_body=values(blocks.RATE.name),
        inertia_ratios=values(blocks.RATIOS.name),
        T_cam_model=truth.T_cam_target,
    )


@dataclass(frozen=True)
class TrackErrors:
    """True minus estimated, per frame of a track; nan where either is missing."""

    p_cam_m: FloatArray
    """(n, 3) position of the model origin, camera axes, m; all nan without true poses."""
    theta_model_rad: FloatArray
    """(n, 3) rotation vector of the pose error, model axes, rad."""
    state: FloatArray
    """(n, 20) error state that takes the estimate to the truth (`NavigationState.local`), SI, rad.
    All nan when the truth knows nothing but poses."""

    @property
    def has_pose(self) -> BoolArray:
        """(n,) frames in which a pose was compared."""
        return np.asarray(np.isfinite(self.p_cam_m).all(axis=1))

    @property
    def has_state(self) -> BoolArray:
        """(n,) frames in which the whole state was compared."""
        return np.asarray(np.isfinite(self.state).all(axis=1))


def match_times(time_s: FloatArray, truth_time_s: FloatArray, tolerance_s: float) -> IntArray:
    """(n,) row of the truth nearest in time to each frame, -1 beyond the tolerance."""
    if not len(truth_time_s):
        return np.full(len(time_s), -1, dtype=np.intp)
    order = np.argsort(truth_time_s)
    ordered = truth_time_s[order]
    after = np.searchsorted(ordered, time_s).clip(0, len(ordered) - 1)
    before = (after - 1).clip(0)
    nearest = np.where(
        np.abs(ordered[before] - time_s) <= np.abs(ordered[after] - time_s), before, after
    )
    close = np.abs(ordered[nearest] - time_s) <= tolerance_s
    return np.where(close, order[nearest], -1).astype(np.intp)


def track_errors(track: Track, truth: Truth, tolerance_s: float = 1e-6) -> TrackErrors:
    """Compare the frames of a track with the truth at the same time.

    Raises `InputError` when no frame of the track has a truth within ``tolerance_s``.
    """
    rows = match_times(track.time_s, truth.time_s, tolerance_s)
    frames = np.flatnonzero(rows >= 0)
    if not frames.size:
        raise InputError("truth", "time_s", "expected times that the run shares; none match")
    rows = rows[frames]
    p_cam_m, theta = np.full((len(track), 3), np.nan), np.full((len(track), 3), np.nan)
    if truth.T_cam_model is not None:
        estimated, true = track.T_cam_model[frames], truth.T_cam_model[rows]
        p_cam_m[frames] = true[:, :3, 3] - estimated[:, :3, 3]
        theta[frames] = _log_between(estimated[:, :3, :3], true[:, :3, :3])
    state = np.full((len(track), STATE_SIZE), np.nan)
    if truth.r_hill is not None and truth.v_hill is not None:
        state[frames, R_HILL] = truth.r_hill[rows] - track.r_hill[frames]
        state[frames, V_HILL] = truth.v_hill[rows] - track.v_hill[frames]
    if truth.R_world_body is not None and truth.omega_body is not None:
        R_estimated = track.R_world_body[frames]
        state[frames, THETA_BODY] = _log_between(R_estimated, truth.R_world_body[rows])
        state[frames, OMEGA_BODY] = truth.omega_body[rows] - track.omega_body[frames]
    if truth.com_model is not None and truth.inertia_ratios is not None:
        state[frames, COM_MODEL] = truth.com_model[rows] - track.com_model[frames]
        state[frames, INERTIA_RATIOS] = truth.inertia_ratios[rows] - track.inertia_ratios[frames]
    return TrackErrors(p_cam_m, theta, state)


def best_symmetry(
    track: Track, truth: Truth, symmetry_transforms: FloatArray, tolerance_s: float = 1e-6
) -> int:
    """Which of the (n, 4, 4) symmetries S makes ``T_cam_model @ S`` of the truth fit the run best.

    One for the whole run, by the median attitude error: a run that jumps from one equivalent
    attitude to another is wrong and is not to be excused frame by frame. 0 without any match.
    """
    if truth.T_cam_model is not None:
        estimated, true = track.T_cam_model[:, :3, :3], truth.T_cam_model[:, :3, :3]
    elif truth.R_world_body is not None:
        estimated, true = track.R_world_body, truth.R_world_body
    else:
        return 0
    rows = match_times(track.time_s, truth.time_s, tolerance_s)
    relative = np.swapaxes(estimated[rows >= 0], -1, -2) @ true[rows[rows >= 0]]
    relative = relative[np.isfinite(relative).all(axis=(1, 2))]
    if not len(relative):
        return 0
    angles = [np.median(rotation_angle(relative @ S[:3, :3])) for S in symmetry_transforms]
    # Equal angles differ by rounding; the identity comes first and is to win then.
    return int(np.argmax(np.asarray(angles) <= np.min(angles) + 1e-9))


def relabelled(truth: Truth, symmetry: FloatArray) -> Truth:
    """The same motion told in the model frame that a (4, 4) symmetry of the target maps it to.

    A model point p becomes ``S^-1 p``; rates and inertia turn with it, the orbit stays.
    """
    R = symmetry[:3, :3]
    changed = truth
    if truth.T_cam_model is not None:
        changed = replace(changed, T_cam_model=truth.T_cam_model @ symmetry)
    if truth.R_world_body is not None and truth.omega_body is not None:
        turned = (truth.R_world_body @ R, truth.omega_body @ R)
        changed = replace(changed, R_world_body=turned[0], omega_body=turned[1])
    if truth.com_model is not None and truth.inertia_ratios is not None:
        inertia = [R.T @ inertia_from_ratios(ratios) @ R for ratios in truth.inertia_ratios]
        changed = replace(
            changed,
            com_model=transform_points(invert_transform(symmetry), truth.com_model),
            inertia_ratios=np.array([ratios_from_inertia(matrix) for matrix in inertia]),
        )
    return changed


def _log_between(R_from: FloatArray, R_to: FloatArray) -> FloatArray:
    """(n, 3) log of ``R_from^T R_to``, nan where either is."""
    relative = np.swapaxes(R_from, -1, -2) @ R_to
    known = np.isfinite(relative).all(axis=(1, 2))
    vectors = np.full((len(relative), 3), np.nan)
    if known.any():
        vectors[known] = log_rotation(relative[known])
    return vectors
