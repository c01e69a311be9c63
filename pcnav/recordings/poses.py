"""Checks on camera poses as recordings store them."""

import numpy as np

from pcnav.core.arrays import FloatArray


def nearest_rotation(matrix: FloatArray) -> FloatArray:
    """Rotation closest in the Frobenius norm to (..., 3, 3) matrices near one (SVD)."""
    U, _, Vt = np.linalg.svd(matrix)
    return np.asarray(U @ Vt)


def orthonormality_error(matrix: FloatArray) -> FloatArray:
    """(...,) largest entry of ``|R R' - I|``; infinite for a reflection or entries not finite."""
    finite = np.asarray(np.isfinite(matrix).all(axis=(-2, -1)))
    R = np.where(finite[..., None, None], matrix, np.eye(3))
    deviation = np.abs(R @ np.swapaxes(R, -1, -2) - np.eye(3)).max(axis=(-2, -1))
    return np.where(finite & (np.linalg.det(R) > 0.0), deviation, np.inf)
