"""Range residuals whose errors are not white: over each face a smooth field, over all an offset.

A real sensor errs alike over a face: matching windows, calibration, paint and the face's own form
displace and tilt it by more than the mean of its white noise does. The field is an offset and two
tilts, drawn anew for every face; it is marginalised in closed form. The
offset that a whole frame shares stays an unknown of its evidence.
"""

from typing import NamedTuple

import numpy as np

from pcnav.core.arrays import FloatArray
from pcnav.perception.modality import Evidence
from pcnav.perception.sensor_noise import SensorNoise

_MIN_SPREAD_PX = 0.5
"""A row of pixels has no tilt across it."""


class FieldEvidence(NamedTuple):
    """What ranges whose errors are not white say."""

    evidence: Evidence
    by_field: FloatArray | None = None
    """(3, 6 + k) what an offset and two tilts of one deviation add to the evidence's vector; None
    where there are none."""


def face_field(u: FloatArray, v: FloatArray) -> FloatArray:
    """(n, 3) an offset and two tilts at pixels (n,) of a face, each of unit mean square.

    The tilts are along the principal axes of the pixels, so that the three are orthogonal.
    """
    centred = np.column_stack([u - u.mean(), v - v.mean()])
    spread, axes = np.linalg.eigh(centred.T @ centred / len(u))
    along = centred @ axes / np.sqrt(np.maximum(spread, _MIN_SPREAD_PX**2))
    return np.column_stack([np.ones(len(u)), along])


def steepness_of(jacobian: FloatArray) -> float:
    """By how much more the ranges (n) of a face change than it is displaced along its normal: the
    inverse cosine of the incidence, from their derivatives (n, 6) by the pose."""
    return float(np.mean(np.linalg.norm(jacobian[:, :3], axis=1)))


def field_deviations(jacobian: FloatArray, noise: SensorNoise) -> FloatArray:
    """(3,) deviations of the offset and the tilts of a face along its rays, by the derivatives
    (n, 6) of its ranges by the pose."""
    sd = np.array([noise.face_sd_m, noise.face_tilt_sd_m, noise.face_tilt_sd_m])
    return sd * steepness_of(jacobian)


def range_evidence(
    jacobian: FloatArray,
    residual: FloatArray,
    field: FloatArray,
    variance_m2: float,
    noise: SensorNoise,
) -> FieldEvidence:
    """What the ranges of a face say of the pose and of the errors that faces share.

    Args:
        jacobian: (n, 6) of the ranges by the pose.
        residual: (n,) measured minus predicted, m; or several of them (n, m).
        field: (n, 3) as `face_field`.
        variance_m2: of the white noise of each.
        noise: what else errs.
    """
    H = jacobian
    if noise.has_shared_errors:
        shared = np.zeros((len(H), noise.n_shared))
        shared[:, 0] = noise.frame_unit_m
        H = np.hstack([H, shared])
    weight = 1.0 / variance_m2
    information, vector = H.T @ H * weight, H.T @ residual * weight
    by_field = None
    if noise.has_face_errors:
        field = field * field_deviations(jacobian, noise)
        # Woodbury: (s^2 1 + B B^T)^-1, with three columns B.
        across = field.T @ np.column_stack([H, residual]) * weight
        inner = field.T @ field * weight + np.eye(3)
        taken, size = np.linalg.solve(inner, across), H.shape[1]
        information = information - across[:, :size].T @ taken[:, :size]
        correction = across[:, :size].T @ taken[:, size:]
        vector = vector - correction.reshape(vector.shape)
        # H^T (s^2 1 + B B^T)^-1 B, transposed.
        by_field = np.asarray(taken[:, :size])
    return FieldEvidence(Evidence(0.5 * (information + information.T), vector), by_field)
