"""How good a run on feature tracks is: errors of motion, mass properties and points, and NEES."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from pcnav.core.arrays import FloatArray, IntArray
from pcnav.core.errors import InputError
from pcnav.core.spatial import log_rotation, make_transform, rotation_angle
from pcnav.dynamics.rigid_body import inertia_from_ratios
from pcnav.evaluation.metrics import (
    Consistency,
    Metrics,
    QuantityErrors,
    consistency,
    nis_consistency,
    quantity_errors,
    run_metrics,
    squared_normalised_errors,
)
from pcnav.evaluation.track_errors import Truth, match_times, relabelled
from pcnav.runs.feature_results import (
    ERROR_SIZE,
    INERTIA_RATIOS,
    OMEGA_BODY,
    R_HILL,
    THETA_BODY,
    V_HILL,
    FeatureTrack,
)

_BLOCKS = {
    "r_hill": R_HILL,
    "v_hill": V_HILL,
    "theta_body": THETA_BODY,
    "omega_body": OMEGA_BODY,
    "inertia_ratios": INERTIA_RATIOS,
    "all": slice(0, ERROR_SIZE),
}
_TIME_TOLERANCE_S = 1e-6


@dataclass(frozen=True)
class FeatureErrors:
    """True minus estimated, per frame of a run; nan where either is missing."""

    state: FloatArray
    """(n, 17) order of `MotionEstimate.covariance`, SI and rad."""
    features_rms_m: FloatArray
    """(n,) root mean square distance of the estimated points from the true ones, body axes."""
    feature_m: Mapping[int, float]
    """Distance of each point of the last estimate from the true one."""
    R_true_body: FloatArray
    """(3, 3) the body axes that the truth was told in, seen in its own."""


def evaluate_features(
    track: FeatureTrack,
    truth: Truth | None,
    points: Mapping[int, FloatArray] | None,
    principal: bool,
) -> tuple[Metrics, FeatureErrors | None]:
    """Numbers of a run; without a truth only what the run says of itself.

    ``principal`` says that the run's body axes are the principal ones: the truth is then told in
    its own, ordered by falling moment, with the signs nearest to the run. Raises `InputError` when
    the truth shares no time with it.
    """
    errors = None if truth is None else _errors(track, truth, points or {}, principal)
    metrics = run_metrics(track, track.has_estimate, nis_consistency(track.as_track()))
    if errors is not None:
        metrics = replace(
            metrics,
            frames_compared=int(np.isfinite(errors.state).all(axis=1).sum()),
            quantities=_quantities(track.time_s, errors),
            nees=_nees(track, errors),
        )
    return metrics, errors


def principal_rotation(inertia: FloatArray) -> FloatArray:
    """(3, 3) R_body_principal: axes of falling moment, right-handed, of arbitrary signs."""
    _, axes = np.linalg.eigh(inertia)
    axes = axes[:, ::-1]
    return np.asarray(axes * [1.0, 1.0, np.linalg.det(axes)])


def _errors(
    track: FeatureTrack, truth: Truth, points: Mapping[int, FloatArray], principal: bool
) -> FeatureErrors:
    rows = match_times(track.time_s, truth.time_s, _TIME_TOLERANCE_S)
    frames = np.flatnonzero((rows >= 0) & track.has_estimate).astype(np.intp)
    if not (rows >= 0).any():
        raise InputError("truth", "time_s", "expected times that the run shares; none match")
    R_true_body = np.eye(3)
    if principal:
        R_true_body = _nearest_principal(track, truth, frames, rows[frames])
    truth = relabelled(truth, make_transform(R_true_body, np.zeros(3)))
    points = {i: R_true_body.T @ p for i, p in points.items()}
    rms = np.full(len(track), np.nan)
    for k in frames:
        apart = [p - points[i] for i, p in track.points[k].items() if i in points]
        rms[k] = np.sqrt(np.mean(np.sum(np.square(apart), axis=1))) if apart else np.nan
    last = {
        i: float(np.linalg.norm(p.p_body - points[i]))
        for i, p in track.last_points.items()
        if i in points
    }
    return FeatureErrors(_state_errors(track, truth, frames, rows[frames]), rms, last, R_true_body)


def _state_errors(
    track: FeatureTrack, truth: Truth, frames: IntArray, rows: IntArray
) -> FloatArray:
    """(n, 17) of the frames that have an estimate and a row of the truth."""
    state = np.full((len(track), ERROR_SIZE), np.nan)
    if truth.r_hill is not None and truth.v_hill is not None:
        state[frames, R_HILL] = truth.r_hill[rows] - track.r_hill[frames]
        state[frames, V_HILL] = truth.v_hill[rows] - track.v_hill[frames]
    if truth.R_world_body is not None and truth.omega_body is not None and len(frames):
        relative = np.swapaxes(track.R_world_body[frames], 1, 2) @ truth.R_world_body[rows]
        state[frames, THETA_BODY] = log_rotation(relative)
        state[frames, OMEGA_BODY] = truth.omega_body[rows] - track.omega_body[frames]
    if truth.inertia_ratios is not None:
        state[frames, INERTIA_RATIOS] = truth.inertia_ratios[rows] - track.inertia_ratios[frames]
    return state


def _nearest_principal(
    track: FeatureTrack, truth: Truth, frames: IntArray, rows: IntArray
) -> FloatArray:
    """(3, 3) R_body_principal of the truth whose signs fit the run best, one for the whole run."""
    if truth.inertia_ratios is None or truth.R_world_body is None or not len(frames):
        return np.eye(3)
    axes = principal_rotation(inertia_from_ratios(truth.inertia_ratios[rows[0]]))
    signs = [np.array([a, b, a * b]) for a, b in product((1.0, -1.0), repeat=2)]
    relative = np.swapaxes(track.R_world_body[frames], 1, 2) @ truth.R_world_body[rows]
    angles = [np.median(rotation_angle(relative @ (axes * sign))) for sign in signs]
    return np.asarray(axes * signs[int(np.argmin(angles))])


def _quantities(time_s: FloatArray, errors: FeatureErrors) -> tuple[QuantityErrors, ...]:
    """Statistics by quantity; those the truth does not know are left out."""
    series = (
        ("r_hill", "mass centre in hill", "m", errors.state[:, R_HILL]),
        ("v_hill", "velocity in hill", "m/s", errors.state[:, V_HILL]),
        ("attitude", "attitude", "deg", np.rad2deg(errors.state[:, THETA_BODY])),
        ("omega_body", "angular rate", "deg/s", np.rad2deg(errors.state[:, OMEGA_BODY])),
        ("inertia_ratios", "inertia ratios", "1", errors.state[:, INERTIA_RATIOS]),
        ("features", "features, RMS of a frame", "m", errors.features_rms_m[:, None]),
    )
    return quantity_errors(time_s, series)


def _nees(track: FeatureTrack, errors: FeatureErrors) -> tuple[Consistency, ...]:
    """NEES of every block of the error state, of what the estimator does not hold fixed."""
    frames = np.flatnonzero(np.isfinite(errors.state).all(axis=1))
    if not frames.size:
        return ()
    covariance = track.covariance[frames]
    free = np.min(np.diagonal(covariance, axis1=1, axis2=2), axis=0) > 0.0
    results = []
    for name, block in _BLOCKS.items():
        chosen = np.arange(ERROR_SIZE)[block][free[block]]
        if chosen.size:
            blocks = covariance[:, chosen[:, None], chosen]
            values = squared_normalised_errors(errors.state[frames][:, chosen], blocks)
            results.append(consistency(name, values, np.full(len(values), chosen.size)))
    return tuple(results)
