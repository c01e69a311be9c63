"""Torque-free rotation of a rigid body and the forms its inertia is written in."""

from collections.abc import Sequence

import numpy as np

from pcnav.core.arrays import FloatArray
from pcnav.core.spatial import skew

# Entry (i, j) of the inertia matrix that each ratio stands for: Iyy, Izz, Ixy, Ixz, Iyz.
_RATIO_ENTRIES = ((1, 1), (2, 2), (0, 1), (0, 2), (1, 2))


def symmetric_units(entries: Sequence[tuple[int, int]]) -> FloatArray:
    """(k, 3, 3) derivatives of a symmetric matrix by its entries (i, j)."""
    units = np.zeros((len(entries), 3, 3))
    for unit, (i, j) in zip(units, entries, strict=True):
        unit[i, j] = unit[j, i] = 1.0
    return units


_RATIO_UNITS = symmetric_units(_RATIO_ENTRIES)
"""(5, 3, 3) derivative of the inertia matrix by each ratio."""


def inertia_from_ratios(ratios: FloatArray) -> FloatArray:
    """(..., 3, 3) inertia over Ixx of the ratios Iyy, Izz, Ixy, Ixz, Iyz (..., 5); Yu 2019 (29)."""
    inertia = np.zeros((*ratios.shape[:-1], 3, 3))
    inertia[..., 0, 0] = 1.0
    for k, (i, j) in enumerate(_RATIO_ENTRIES):
        inertia[..., i, j] = inertia[..., j, i] = ratios[..., k]
    return inertia


def ratios_from_inertia(inertia: FloatArray) -> FloatArray:
    """(..., 5) ratios Iyy, Izz, Ixy, Ixz, Iyz over Ixx of inertias (..., 3, 3) of any scale."""
    entries = np.stack([inertia[..., i, j] for i, j in _RATIO_ENTRIES], axis=-1)
    return np.asarray(entries / inertia[..., 0, 0, None])


def is_physical_inertia(inertia: FloatArray) -> bool:
    """Whether a mass distribution exists that has this (3, 3) inertia matrix.

    Its principal moments must be positive and satisfy the triangle inequality.
    """
    moments = np.linalg.eigvalsh(inertia)
    return bool(moments[0] > 0.0 and moments[0] + moments[1] >= moments[2])


def euler_derivatives(
    inertia: FloatArray, inverse: FloatArray, omega_body: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Angular acceleration (3,) in body axes, rad/s^2, without torque (Yu 2019 (28)), and its
    derivatives by the rate (3, 3) and the ratios (3, 5).

    From ``I a = -w x (I w)``: ``I da = -[w]x I dw + [I w]x dw`` and ``I da = -dI a - w x (dI w)``.
    The inverse of the inertia is handed in because callers evaluate this many times for one body.
    """
    momentum = inertia @ omega_body
    cross = skew(omega_body)
    acceleration = -inverse @ (cross @ momentum)
    by_omega = inverse @ (skew(momentum) - cross @ inertia)
    twisted = _RATIO_UNITS @ np.column_stack([acceleration, omega_body])
    by_ratios = -inverse @ (twisted[..., 0] + twisted[..., 1] @ cross.T).T
    return acceleration, by_omega, by_ratios
