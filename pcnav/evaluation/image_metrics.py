"""How good a run on images of one camera is: errors of attitude and rate, and NEES.

Such a run cannot know the target's own axes: its body axes are the camera's at the first frame of
a segment. The constant rotation between the two at that frame is taken out of the truth.
"""

from dataclasses import dataclass, replace

import numpy as np

from pcnav.core.arrays import BoolArray, FloatArray, IntArray
from pcnav.core.errors import InputError
from pcnav.core.spatial import log_rotation
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
from pcnav.runs.image_results import ImageTrack

_TIME_TOLERANCE_S = 1e-6


@dataclass(frozen=True)
class ImageErrors:
    """True minus estimated, per frame of a run; nan where either is missing."""

    theta_body: FloatArray
    """(n, 3) rad; 0 at the frames that define the axes."""
    omega_body: FloatArray
    """(n, 3) rad/s"""
    defines_axes: BoolArray
    """(n,) the frames at which the axes of truth and run were made the same."""


def evaluate_images(track: ImageTrack, truth: Truth | None) -> tuple[Metrics, ImageErrors | None]:
    """Numbers of a run; without a truth only what the run says of itself.

    Raises `InputError` when the truth shares no time with it.
    """
    errors = None if truth is None else _errors(track, truth)
    no_nis = consistency("nis", np.zeros(0), np.zeros(0, dtype=np.intp))
    metrics = run_metrics(track, track.has_attitude, no_nis)
    if errors is not None:
        metrics = replace(
            metrics,
            frames_compared=int(_compared(errors).sum()),
            quantities=_quantities(track.time_s, errors),
            nees=_nees(track, errors),
        )
    return metrics, errors


def _compared(errors: ImageErrors) -> BoolArray:
    """(n,) frames with an error that is none by construction."""
    return np.asarray(np.isfinite(errors.theta_body).all(axis=1) & ~errors.defines_axes)


def _nees(track: ImageTrack, errors: ImageErrors) -> tuple[Consistency, ...]:
    judged = _compared(errors)
    squared = squared_normalised_errors(errors.theta_body[judged], track.covariance[judged])
    nees = consistency("theta_body", squared, np.full(len(squared), 3, dtype=np.intp))
    return (nees,) if nees.frames else ()


def _errors(track: ImageTrack, truth: Truth) -> ImageErrors:
    rows = match_times(track.time_s, truth.time_s, _TIME_TOLERANCE_S)
    if not (rows >= 0).any():
        raise InputError("truth", "time_s", "expected times that the run shares; none match")
    n = len(track)
    theta, omega = np.full((n, 3), np.nan), np.full((n, 3), np.nan)
    defines = np.zeros(n, dtype=np.bool_)
    if truth.R_world_body is None or truth.omega_body is None:
        return ImageErrors(theta, omega, defines)
    both = (rows >= 0) & track.has_attitude
    for segment in np.unique(track.segment[both]):
        at: IntArray = np.flatnonzero(both & (track.segment == segment))
        first, true = at[0], rows[at]
        defines[first] = True
        R_true_body = truth.R_world_body[true[0]].T @ track.R_world_body[first]
        R_world_true = truth.R_world_body[true] @ R_true_body
        theta[at] = log_rotation(np.swapaxes(track.R_world_body[at], 1, 2) @ R_world_true)
        omega[at] = truth.omega_body[true] @ R_true_body - track.omega_body[at]
    return ImageErrors(theta, omega, defines)


def _quantities(time_s: FloatArray, errors: ImageErrors) -> tuple[QuantityErrors, ...]:
    # Where the axes are defined there is no error by construction: it would flatter the run.
    theta = np.where(errors.defines_axes[:, None], np.nan, errors.theta_body)
    series = (
        ("attitude", "attitude since the first frame", "deg", np.rad2deg(theta)),
        ("omega_body", "angular rate", "deg/s", np.rad2deg(errors.omega_body)),
    )
    return quantity_errors(time_s, series)
