"""Quaternion and rates of a chain of attitudes (Appl. Sci. 2022 (14)-(18)).

Printed (15), ``R_i'^T R_i``, is the transpose of a cross-product matrix as the other papers write
it; (17) prints the angle as ``pi / 2 . arcsin q4``, which is meant as ``2 arccos q4``.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pcnav.config.image_motion import ImageMotionTable, Smoothing
from pcnav.core.arrays import FloatArray, IntArray
from pcnav.core.spatial import exp_rotation, left_jacobian, log_rotation, xyzw_from_rotation
from pcnav.estimators.image_motion.chain import ChainFrame


@dataclass(frozen=True)
class RotationHistory:
    """The frames of a chain that have an attitude. Rates are inertial."""

    frames: IntArray
    """(n,) their numbers."""
    time_s: FloatArray
    """(n,)"""
    segment: IntArray
    """(n,)"""
    R_world_body: FloatArray
    """(n, 3, 3), smoothed where asked for."""
    R_cam_body: FloatArray
    """(n, 3, 3)"""
    omega_body: FloatArray
    """(n, 3) rad/s; nan in a segment of a single frame."""


def rotation_history(frames: Sequence[ChainFrame], settings: ImageMotionTable) -> RotationHistory:
    """Attitudes and rates of a chain; every segment on its own."""
    placed = [k for k, frame in enumerate(frames) if frame.R_world_body is not None]
    numbers: IntArray = np.array(placed, dtype=np.intp)
    time_s = np.array([frames[k].time_s for k in placed])
    segment: IntArray = np.array([frames[k].segment for k in placed], dtype=np.intp)
    R = np.array([frames[k].R_world_body for k in placed]).reshape(-1, 3, 3)
    R_cam_world = np.array([frames[k].R_cam_world for k in placed]).reshape(-1, 3, 3)
    omega = np.full((len(placed), 3), np.nan)
    for each in np.unique(segment):
        at = np.flatnonzero(segment == each)
        R[at], omega[at] = smoothed(time_s[at], R[at], settings)
    R_cam_body = R_cam_world @ R
    return RotationHistory(numbers, time_s, segment, R, R_cam_body, omega)


def smoothed(
    time_s: FloatArray, R_world_body: FloatArray, settings: ImageMotionTable
) -> tuple[FloatArray, FloatArray]:
    """Attitudes (n, 3, 3) and body rates (n, 3) of attitudes at increasing times (n,)."""
    if len(time_s) < 2:
        return R_world_body, np.full((len(time_s), 3), np.nan)
    if settings.smoothing is Smoothing.NONE:
        return R_world_body, differences(time_s, R_world_body)
    return local_polynomial(time_s, R_world_body, settings.window_frames, settings.degree)


def differences(time_s: FloatArray, R_world_body: FloatArray) -> FloatArray:
    """(n, 3) body rates by the turn between both neighbours, at the ends to the one there is."""
    first = np.maximum(np.arange(len(time_s)) - 1, 0)
    last = np.minimum(np.arange(len(time_s)) + 1, len(time_s) - 1)
    turn = log_rotation(np.swapaxes(R_world_body[first], -1, -2) @ R_world_body[last])
    return np.asarray(turn / (time_s[last] - time_s[first])[:, None])


def local_polynomial(
    time_s: FloatArray, R_world_body: FloatArray, window: int, degree: int
) -> tuple[FloatArray, FloatArray]:
    """Attitudes and body rates by a polynomial of the turn from the middle of a window.

    With ``R(t) = R_k exp(p(t))`` the rate is ``J_r(p) p'``. At the ends the window is one-sided;
    with fewer frames than a polynomial has coefficients its degree is less.
    """
    R, omega = np.empty_like(R_world_body), np.empty((len(time_s), 3))
    size = min(window, len(time_s))
    degree = min(degree, size - 1)
    for k in range(len(time_s)):
        start = int(np.clip(k - size // 2, 0, len(time_s) - size))
        rows = slice(start, start + size)
        turn = log_rotation(R_world_body[k].T @ R_world_body[rows])
        powers = np.vander(time_s[rows] - time_s[k], degree + 1, increasing=True)
        coefficients = np.linalg.lstsq(powers, turn, rcond=None)[0]
        R[k] = R_world_body[k] @ exp_rotation(coefficients[0])
        omega[k] = left_jacobian(-coefficients[0]) @ coefficients[1]
    return R, omega


def continuous_xyzw(R: FloatArray, segment: IntArray | None = None) -> FloatArray:
    """(n, 4) quaternions of (n, 3, 3) whose sign follows the one before in its segment."""
    quaternions = xyzw_from_rotation(R)
    if len(quaternions) < 2:
        return quaternions
    same = np.ones(len(R) - 1, dtype=np.bool_) if segment is None else np.diff(segment) == 0
    flips = (np.sum(quaternions[1:] * quaternions[:-1], axis=1) < 0.0) & same
    signs = np.concatenate([[1.0], np.cumprod(np.where(flips, -1.0, 1.0))])
    return np.asarray(quaternions * signs[:, None])
