"""Rotations and rigid transforms: arrays in, arrays out, batched over leading dimensions.

Conventions (DESIGN: frames and notation): ``p_a = T_a_b @ p_b``; quaternions are scalar-last and
named ``_xyzw``; a rotation vector is axis times angle in radians. A perturbed attitude is
``R_hat @ exp_rotation(theta)`` (right, body-axes error).
"""

import math
from typing import TypeAlias

import numpy as np
from scipy.spatial.transform import Rotation

from pcnav.core.arrays import FloatArray

_Scale: TypeAlias = FloatArray | float
_SMALL_ANGLE_RAD = 1e-4
"""Below this the coefficients of the SO(3) series are taken from their Taylor expansion."""


def skew(vector: FloatArray) -> FloatArray:
    """Cross-product matrix: ``skew(a) @ b == cross(a, b)``; (..., 3) -> (..., 3, 3)."""
    v = np.asarray(vector, dtype=np.float64)
    if v.ndim == 1:
        x, y, z = v.tolist()
        return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    matrix = np.zeros((*v.shape, 3))
    matrix[..., 0, 1], matrix[..., 0, 2], matrix[..., 1, 2] = -v[..., 2], v[..., 1], -v[..., 0]
    matrix[..., 1, 0], matrix[..., 2, 0], matrix[..., 2, 1] = v[..., 2], -v[..., 1], v[..., 0]
    return matrix


def exp_rotation(rotation_vector: FloatArray) -> FloatArray:
    """Rotation matrix of a rotation vector (rad); (..., 3) -> (..., 3, 3). Rodrigues' formula."""
    a, b, _ = _series(rotation_vector)
    k = skew(rotation_vector)
    return np.asarray(np.eye(3) + a * k + b * (k @ k))


def log_rotation(R: FloatArray) -> FloatArray:
    """Rotation vector (rad, angle in [0, pi]) of a rotation matrix; (..., 3, 3) -> (..., 3).

    Up to a right angle from the skew part of one matrix, which is ``sin(angle) axis``. Else through
    the quaternion of the largest component, so it is accurate at 180 degrees, where the
    scalar-part formula of Yu 2019 (20) divides by zero.
    """
    if R.ndim == 2:
        v = 0.5 * np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
        cosine, sine = 0.5 * (float(np.trace(R)) - 1.0), float(np.sqrt(v @ v))
        if cosine > 0.0:
            if sine < _SMALL_ANGLE_RAD:
                return np.asarray(v * (1.0 + sine * sine / 6.0))
            return np.asarray(v * (np.arctan2(sine, cosine) / sine))
    return np.asarray(Rotation.from_matrix(R).as_rotvec(), dtype=np.float64)


def left_jacobian(rotation_vector: FloatArray) -> FloatArray:
    """J with ``exp(v + dv) = exp(J(v) dv) exp(v)`` to first order; (..., 3) -> (..., 3, 3).

    The right Jacobian is its transpose, ``left_jacobian(-v)``. (Sola et al. 2018, eq. 145.)
    """
    _, b, c = _series(rotation_vector)
    k = skew(rotation_vector)
    return np.asarray(np.eye(3) + b * k + c * (k @ k))


def _series(rotation_vector: FloatArray) -> tuple[_Scale, _Scale, _Scale]:
    """sin(t)/t, (1-cos t)/t^2 and (t-sin t)/t^3 of the vector's length t, as factors of matrices.

    Numbers for one vector (3,), (..., 1, 1) for many.
    """
    v = np.asarray(rotation_vector, dtype=np.float64)
    if v.ndim == 1:
        return _series_of_one(math.hypot(*v.tolist()))
    t2 = np.sum(v * v, axis=-1)[..., None, None]
    t = np.sqrt(t2)
    small = t < _SMALL_ANGLE_RAD
    safe = np.where(small, 1.0, t)
    sine = np.sin(safe)
    # 2 sin^2(t/2) keeps the digits that 1 - cos(t) loses.
    versine = 2.0 * np.sin(0.5 * safe) ** 2
    a = np.where(small, 1.0 - t2 / 6.0, sine / safe)
    b = np.where(small, 0.5 - t2 / 24.0, versine / safe**2)
    # t - sin t cancels to t^3 / 6, which costs 1e-8 of relative accuracy at the threshold.
    c = np.where(small, 1.0 / 6.0 - t2 / 120.0, (safe - sine) / safe**3)
    return a, b, c


def _series_of_one(t: float) -> tuple[float, float, float]:
    """`_series` of one length: filters ask one vector at a time, and arrays of one are slow."""
    if t < _SMALL_ANGLE_RAD:
        return 1.0 - t * t / 6.0, 0.5 - t * t / 24.0, 1.0 / 6.0 - t * t / 120.0
    sine = math.sin(t)
    return sine / t, 2.0 * math.sin(0.5 * t) ** 2 / t**2, (t - sine) / t**3


def rotation_from_xyzw(quaternion_xyzw: FloatArray) -> FloatArray:
    """Rotation matrix of a scalar-last quaternion (normalised here); (..., 4) -> (..., 3, 3)."""
    return np.asarray(Rotation.from_quat(quaternion_xyzw).as_matrix(), dtype=np.float64)


def xyzw_from_rotation(R: FloatArray) -> FloatArray:
    """Scalar-last unit quaternion with non-negative scalar; (..., 3, 3) -> (..., 4)."""
    return np.asarray(Rotation.from_matrix(R).as_quat(canonical=True), dtype=np.float64)


def nearest_rotation(M: FloatArray) -> FloatArray:
    """The rotation nearest to a matrix, by its singular values; (..., 3, 3) -> (..., 3, 3)."""
    U, _, Vt = np.linalg.svd(M)
    handed = np.ones((*M.shape[:-2], 3))
    handed[..., 2] = np.linalg.det(U @ Vt)
    return np.asarray((U * handed[..., None, :]) @ Vt)


def rotation_angle(R: FloatArray) -> FloatArray:
    """Angle of a rotation matrix, rad in [0, pi]; (..., 3, 3) -> (...)."""
    return np.asarray(np.linalg.norm(log_rotation(R), axis=-1))


def make_transform(R: FloatArray, p: FloatArray) -> FloatArray:
    """Homogeneous transform from rotation (..., 3, 3) and translation (..., 3), metres."""
    T = np.zeros((*np.broadcast_shapes(R.shape[:-2], p.shape[:-1]), 4, 4))
    T[..., :3, :3], T[..., :3, 3], T[..., 3, 3] = R, p, 1.0
    return T


def invert_transform(T: FloatArray) -> FloatArray:
    """``T_b_a`` of ``T_a_b``; (..., 4, 4), rigid."""
    R_inverse = np.swapaxes(T[..., :3, :3], -1, -2)
    return make_transform(R_inverse, -np.einsum("...ij,...j->...i", R_inverse, T[..., :3, 3]))


def transform_points(T_a_b: FloatArray, p_b: FloatArray) -> FloatArray:
    """``p_a`` of points (..., n, 3) given in frame b."""
    R_b_a = np.swapaxes(T_a_b[..., :3, :3], -1, -2)
    return np.asarray(p_b @ R_b_a + T_a_b[..., None, :3, 3])


def rotation_fault(R: FloatArray, tolerance: float = 1e-6) -> str | None:
    """Why a 3 x 3 array is not a proper rotation, in words, or None when it is one."""
    if not np.all(np.isfinite(R)):
        return "it has entries that are not finite numbers"
    deviation = float(np.max(np.abs(R @ R.T - np.eye(3))))
    if deviation > tolerance:
        return f"its columns are not orthonormal (off by {deviation:.2g})"
    if np.linalg.det(R) < 0.0:
        return "it is a reflection (determinant -1)"
    return None


def nearest_orthogonal(matrix: FloatArray) -> FloatArray:
    """The orthogonal matrix nearest to (..., 3, 3) matrices; of one near a rotation, a rotation."""
    U, _, Vt = np.linalg.svd(matrix)
    return np.asarray(U @ Vt)


def orthonormality_error(matrix: FloatArray) -> FloatArray:
    """(...,) largest entry of ``|R R' - I|``; infinite for a reflection or entries not finite."""
    finite = np.asarray(np.isfinite(matrix).all(axis=(-2, -1)))
    R = np.where(finite[..., None, None], matrix, np.eye(3))
    deviation = np.abs(R @ np.swapaxes(R, -1, -2) - np.eye(3)).max(axis=(-2, -1))
    return np.where(finite & (np.linalg.det(R) > 0.0), deviation, np.inf)
