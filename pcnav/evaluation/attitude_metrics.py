"""How good a run on attitudes is: errors of attitude, rate and inertia ratios, and NEES.

From images of one camera the body axes are the run's own, the camera's at the first frame; the
constant rotation between them and the target's is then taken out of the truth at that frame.
Attitudes that come from elsewhere are in the axes that they came in.
"""

from dataclasses import replace

import numpy as np

from pcnav.core.arrays import BoolArray, FloatArray, IntArray
from pcnav.core.errors import InputError
from pcnav.core.spatial import log_rotation
from pcnav.dynamics.inertia_parameters import parameters_from_ratios, ratios_jacobian
from pcnav.dynamics.rigid_body import inertia_from_ratios, ratios_from_inertia
from pcnav.estimators.attitude_inertia.rotation_model import INERTIA, OMEGA, SIZE, THETA
from pcnav.evaluation.metrics import (
    Consistency,
    Metrics,
    QuantityErrors,
    consistency,
    quantity_errors,
    run_metrics,
    squared_normalised_errors,
)
from pcnav.evaluation.track_errors import Truth, match_times
from pcnav.runs.attitude_results import AttitudeTrack

_TIME_TOLERANCE_S = 1e-6
_BLOCKS = {
    "theta_body": THETA,
    "omega_body": OMEGA,
    "inertia_ratios": INERTIA,
    "all": slice(0, SIZE),
}


def evaluate_attitudes(
    track: AttitudeTrack, truth: Truth | None
) -> tuple[Metrics, FloatArray | None]:
    """Numbers of a run, and true minus estimated (n, 11); None without a truth.

    Raises `InputError` when the truth shares no time with the run.
    """
    errors = None if truth is None else attitude_errors(track, truth)
    judged = np.isfinite(track.nis)
    degrees = np.full(int(judged.sum()), 3, dtype=np.intp)
    nis = consistency("nis", track.nis[judged], degrees, independent=True)
    metrics = run_metrics(track, track.has_estimate, nis)
    if errors is not None:
        metrics = replace(
            metrics,
            frames_compared=int(_compared(errors).sum()),
            quantities=_quantities(track.time_s, errors),
            nees=_nees(track, errors),
        )
    return metrics, errors


def attitude_errors(track: AttitudeTrack, truth: Truth) -> FloatArray:
    """(n, 11) true minus estimated: theta (body axes, rad), rate, ratios; nan where unknown."""
    rows = match_times(track.time_s, truth.time_s, _TIME_TOLERANCE_S)
    if not (rows >= 0).any():
        raise InputError("truth", "time_s", "expected times that the run shares; none match")
    errors = np.full((len(track), SIZE), np.nan)
    if truth.R_world_body is None:
        return errors
    known = (rows >= 0) & track.has_estimate
    ends = [*(frame for frame, _ in track.axes[1:]), len(track)]
    for (frame, R_world_body), end in zip(track.axes, ends, strict=False):
        R_true_body = truth.R_world_body[_nearest(truth, track.time_s[frame])].T @ R_world_body
        _compare(errors, track, truth, rows, known[:end] & (np.arange(end) >= frame), R_true_body)
    if not track.axes:
        _compare(errors, track, truth, rows, known, np.eye(3))
    return errors


def _nearest(truth: Truth, time_s: float) -> int:
    return int(np.argmin(np.abs(truth.time_s - time_s)))


def _compare(
    errors: FloatArray,
    track: AttitudeTrack,
    truth: Truth,
    rows: IntArray,
    which: BoolArray,
    R_true_body: FloatArray,
) -> None:
    """Fill in the errors of the frames that are marked, in body axes turned from the true ones."""
    both: IntArray = np.flatnonzero(which)
    if not both.size or truth.R_world_body is None:
        return
    true = rows[both]
    turned = np.swapaxes(track.R_world_body[both], 1, 2) @ truth.R_world_body[true] @ R_true_body
    errors[both, THETA] = log_rotation(turned)
    if truth.omega_body is not None:
        errors[both, OMEGA] = truth.omega_body[true] @ R_true_body - track.omega_body[both]
    if truth.inertia_ratios is not None:
        inertia = np.stack([inertia_from_ratios(row) for row in truth.inertia_ratios[true]])
        inertia = R_true_body.T @ inertia @ R_true_body
        ratios = np.stack([ratios_from_inertia(each) for each in inertia])
        errors[both, INERTIA] = ratios - track.inertia_ratios[both]


def _compared(errors: FloatArray) -> BoolArray:
    return np.asarray(np.isfinite(errors[:, THETA]).all(axis=1))


def _nees(track: AttitudeTrack, errors: FloatArray) -> tuple[Consistency, ...]:
    """Of the inertia in its entries over the trace: in ratios a wide distribution is a bent one."""
    judged = np.flatnonzero(np.isfinite(errors).all(axis=1))
    if not judged.size:
        return ()
    flat, covariance = errors[judged], track.covariance[judged]
    for k, row in enumerate(judged):
        ratios = track.inertia_ratios[row]
        parameters = parameters_from_ratios(ratios)
        flat[k, INERTIA] = parameters_from_ratios(ratios + errors[row, INERTIA]) - parameters
        change = np.eye(SIZE)
        change[INERTIA, INERTIA] = np.linalg.inv(ratios_jacobian(parameters))
        covariance[k] = change @ covariance[k] @ change.T
    found = []
    for name, block in _BLOCKS.items():
        values = squared_normalised_errors(flat[:, block], covariance[:, block, block])
        found.append(consistency(name, values, np.full(len(values), block.stop - block.start)))
    return tuple(found)


def _quantities(time_s: FloatArray, errors: FloatArray) -> tuple[QuantityErrors, ...]:
    series = (
        ("attitude", "attitude", "deg", np.rad2deg(errors[:, THETA])),
        ("omega_body", "angular rate", "deg/s", np.rad2deg(errors[:, OMEGA])),
        ("inertia_ratios", "inertia ratios", "1", errors[:, INERTIA]),
    )
    return quantity_errors(time_s, series)
