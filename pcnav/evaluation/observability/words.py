"""Directions of a state space as people name them."""

import numpy as np

from pcnav.core.arrays import FloatArray
from pcnav.evaluation.knowledge import in_words

_ROUNDING = 1e-9


def directions_in_words(basis: FloatArray, names: tuple[str, ...]) -> tuple[str, ...]:
    """The space that the columns of a basis (n, k) span, in k names.

    Any basis of the space would do; the one told involves few states each. A state that is in the
    space by itself is told by its name.
    """
    return tuple(in_words(row, names) for row in plain_basis(basis))


def plain_basis(basis: FloatArray) -> FloatArray:
    """(k, n) unit vectors of the span of (n, k): each is alone in having one of the states.

    Elimination with the largest pivot left, so that rounding is not magnified.
    """
    rows = basis.T.copy()
    taken: list[int] = []
    for k in range(len(rows)):
        left = np.abs(rows[k:]).copy()
        left[:, taken] = 0.0
        pivot, column = np.unravel_index(int(np.argmax(left)), left.shape)
        rows[[k, k + int(pivot)]] = rows[[k + int(pivot), k]]
        rows[k] /= rows[k, column]
        others = np.arange(len(rows)) != k
        rows[others] -= np.outer(rows[others, column], rows[k])
        taken.append(int(column))
    rows[np.abs(rows) < _ROUNDING] = 0.0
    unit = rows / np.linalg.norm(rows, axis=1, keepdims=True)
    return np.asarray(unit[np.argsort(taken)])
