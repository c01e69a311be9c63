"""The inertia of a body in its principal axes: ratios (19) of Hu 2024, and how it may err.

The ratios are p_x and p_z; ``p_y = -(p_x + p_z) / (1 + p_x p_z)`` follows. Which body it is, is
given by ratios and axes together. Motion shows both through Euler's equation, which is linear in
the inertia matrix ``N = 3 I / tr(I)``: what an arc shows are planes in the space of these matrices.
So an error of axes (a turn ``theta``, rad) and ratios stands here for a change of N,

    dN_xy = theta_z (l_x - l_y),  dN_yz = theta_x (l_y - l_z),  dN_zx = theta_y (l_z - l_x),

with the ratios' part on the diagonal, and is applied to N as a whole, which is then diagonalised
anew. For small errors that is a turn and a difference. For large ones, above all about an axis
whose two moments are near equal, the planes stay planes; a turn would bend them.
"""

import numpy as np

from pcnav.core.arrays import FloatArray

MAX_RATIO = 0.9999
"""Of p_x and p_z, either sign; 1 is a sheet or a needle."""
_MIN_GAP = 1e-9
_TURNS = ((1, 2), (2, 0), (0, 1))
"""Entries of N that a turn about x, y and z changes."""


def middle_ratio(ratios: FloatArray) -> float:
    """p_y of p_x and p_z (2,)."""
    px, pz = ratios
    return float(-(px + pz) / (1.0 + px * pz))


def moments_from_ratios(ratios: FloatArray) -> FloatArray:
    """(3,) principal moments over Ix of p_x and p_z (2,): the inverse of (19)."""
    px, pz = ratios
    return np.array([1.0, (1.0 + px * pz) / (1.0 + pz), (1.0 - px) / (1.0 + pz)])


def moments_jacobian(ratios: FloatArray) -> FloatArray:
    """(3, 2) derivative of `moments_from_ratios`."""
    px, pz = ratios
    square = (1.0 + pz) ** 2
    return np.array(
        [
            [0.0, 0.0],
            [pz / (1.0 + pz), (px - 1.0) / square],
            [-1.0 / (1.0 + pz), -(1.0 - px) / square],
        ]
    )


def ratios_from_moments(moments: FloatArray) -> FloatArray:
    """(2,) p_x and p_z of principal moments (3,) of any scale (19)."""
    x, y, z = moments
    return np.array([(y - z) / x, (x - y) / z])


def ratios_jacobian(moments: FloatArray) -> FloatArray:
    """(2, 3) derivative of `ratios_from_moments`."""
    x, y, z = moments
    return np.array(
        [
            [-(y - z) / x**2, 1.0 / x, -1.0 / x],
            [1.0 / z, -1.0 / z, -(x - y) / z**2],
        ]
    )


def move_axes(
    ratios: FloatArray, theta: FloatArray, change: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Axes R_old_new (3, 3) and ratios (2,) after an error of axes (3,) and ratios (2,).

    The new axes are those next to the old ones: no order is imposed. Ratios that no body can have
    are cut off.
    """
    moments, by_ratios = _normalised(ratios)
    matrix = np.diag(moments + by_ratios @ change)
    for (i, j), angle in zip(_TURNS, theta.tolist(), strict=True):
        matrix[i, j] = matrix[j, i] = angle * (moments[i] - moments[j])
    values, axes = np.linalg.eigh(matrix)
    order = _next_to_old(axes)
    axes = axes[:, order]
    axes = axes * np.where(np.diagonal(axes) < 0.0, -1.0, 1.0)
    if np.linalg.det(axes) < 0.0:
        weakest = int(np.abs(np.diagonal(axes)).argmin())
        axes[:, weakest] *= -1.0
    found = ratios_from_moments(np.maximum(values[order], 1e-6))
    return axes, np.clip(found, -MAX_RATIO, MAX_RATIO)


def _next_to_old(axes: FloatArray) -> list[int]:
    """Which columns of (3, 3) come first, second and third, each next to the axis of its place."""
    nearness = np.abs(axes)
    nearest = nearness.argmax(axis=1).tolist()
    if sorted(nearest) == [0, 1, 2]:
        return [int(column) for column in nearest]
    orders = ([0, 1, 2], [0, 2, 1], [1, 0, 2], [1, 2, 0], [2, 0, 1], [2, 1, 0])
    return max(orders, key=lambda order: float(nearness[[0, 1, 2], order].sum()))


def axes_error(
    ratios: FloatArray, R_old_new: FloatArray, new_ratios: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """The error of axes (3,) and ratios (2,) that leads to others: the inverse of `move_axes`."""
    moments, _ = _normalised(ratios)
    there, _ = _normalised(new_ratios)
    matrix = (R_old_new * there) @ R_old_new.T
    theta = np.array([matrix[i, j] / _gap(moments, i, j) for i, j in _TURNS])
    # The ratios' error is that of the moments to first order, at the old ones.
    change = ratios_jacobian(moments) @ (np.diagonal(matrix) - moments)
    return theta, change


def transport(ratios: FloatArray, R_old_new: FloatArray, new_ratios: FloatArray) -> FloatArray:
    """(5, 5) small errors of axes and ratios at the new ones, by those at the old ones.

    Both stand for changes of N; the matrix carries one into the other.
    """
    moments, by_ratios = _normalised(ratios)
    units = np.zeros((5, 3, 3))
    for k, (i, j) in enumerate(_TURNS):
        units[k, i, j] = units[k, j, i] = moments[i] - moments[j]
    for k in range(2):
        units[3 + k] = np.diag(by_ratios[:, k])
    turned = R_old_new.T @ units @ R_old_new
    there, _ = _normalised(new_ratios)
    carried = np.empty((5, 5))
    for k, (i, j) in enumerate(_TURNS):
        carried[k] = turned[:, i, j] / _gap(there, i, j)
    carried[3:] = ratios_jacobian(there) @ np.diagonal(turned, axis1=1, axis2=2).T
    return carried


def _normalised(ratios: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(3,) moments of N, whose trace is 3, and their derivative (3, 2) by the ratios."""
    moments, by = moments_from_ratios(ratios), moments_jacobian(ratios)
    scale = 3.0 / float(moments.sum())
    return scale * moments, scale * by - np.outer(moments, by.sum(axis=0)) * (scale**2 / 3.0)


def _gap(moments: FloatArray, i: int, j: int) -> float:
    gap = float(moments[i] - moments[j])
    return gap if abs(gap) > _MIN_GAP else float(np.copysign(_MIN_GAP, gap))
