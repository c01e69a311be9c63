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

_AXES_CROSSED = np.moveaxis(skew(np.eye(3)), 0, 1)
"""(3, 3, 3) component a of the axis e_i crossed with e_b in the place [a, i, b]."""


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


def euler_forms(inertia: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Angular acceleration in body axes without torque (Yu 2019 (28)), as forms of the rate w.

    Of an inertia (3, 3). The acceleration is quadratic in w. Returned are (3, 3, 3), which makes
    its derivative by w of w, and half of that times w is the acceleration itself; and
    (3, 5, 3, 3), which makes its derivative by the ratios of the products of w. Both are symmetric
    in their last two axes.

    From ``I a = -w x (I w)`` and ``I da = -dI a - w x (dI w)``.
    """
    solved = -np.asarray(np.linalg.inv(inertia))
    crossed = _twice_symmetric(_AXES_CROSSED @ inertia)
    by_rate = (solved @ crossed.reshape(3, 9)).reshape(3, 3, 3)
    # Half of it is the acceleration of each pair of axes, by polarisation.
    twisted = (_RATIO_UNITS @ by_rate.reshape(3, 9)).reshape(5, 3, 3, 3)
    crossed = _twice_symmetric(_AXES_CROSSED @ _RATIO_UNITS[:, None])
    by_ratios = 0.5 * (solved @ (twisted + crossed).reshape(5, 3, 9)).reshape(5, 3, 3, 3)
    return by_rate, np.moveaxis(by_ratios, 0, 1)


def _twice_symmetric(forms: FloatArray) -> FloatArray:
    """The sum of forms (..., i, j) and their transposes."""
    return np.asarray(forms + np.swapaxes(forms, -1, -2))
