"""Rank of an observability matrix, told by the gap in its singular values at sixty digits.

In double precision a singular value that is small and one that is zero look alike: the Lie
derivatives of order ten span more decades than a double has digits. The matrix is exact here
(`pcnav.evaluation.observability.lie`), its singular values have some fifty correct digits, and
those that vanish stand out by forty orders of magnitude.
"""

from dataclasses import dataclass
from decimal import Context, Decimal, localcontext
from fractions import Fraction
from math import factorial
from typing import Any

import numpy as np

from pcnav.core.arrays import FloatArray
from pcnav.evaluation.information_gain import in_words
from pcnav.evaluation.observability.lie import Number, ObjectArray

DIGITS = 60
TOLERANCE = 1e-12
"""Singular values below this share of the largest count as zero.

States of a run are doubles: a spin about a principal axis that is not a coordinate axis is one only
up to their rounding, some 1e-16. Exact states leave zeros below 1e-50.
"""
_MAX_SWEEPS = 60
_ROUNDING = 1e-9
"""Of directions."""


@dataclass(frozen=True)
class ObservabilityRank:
    """What the local rank condition says at a state."""

    singular_values: tuple[Decimal, ...]
    """(n,) of the scaled matrix, largest first."""
    tolerance: float
    """Relative to the largest."""
    directions: FloatArray
    """(n, n) right singular vectors as columns, largest first, in the units of the unknowns."""

    @property
    def size(self) -> int:
        """How many unknowns there are."""
        return len(self.singular_values)

    @property
    def rank(self) -> int:
        """How many singular values are above the tolerance."""
        return int(np.sum(self.relative > self.tolerance))

    @property
    def relative(self) -> FloatArray:
        """(n,) singular values over the largest."""
        largest = self.singular_values[0] or Decimal(1)
        return np.array([float(value / largest) for value in self.singular_values])

    @property
    def unobservable(self) -> FloatArray:
        """(n, n - rank) directions of the unknowns that no derivative sees."""
        return self.directions[:, self.rank :]


def rank_of(
    blocks: ObjectArray,
    time_scale_s: Number,
    units: tuple[Number, ...],
    tolerance: float = TOLERANCE,
) -> ObservabilityRank:
    """Rank of the gradients of Lie derivatives, (K + 1, m, n) of `Fraction` or `Decimal`.

    Rank does not depend on scale, but a tolerance does: the block of order k is multiplied by
    ``time_scale^k / k!``, a Taylor coefficient over that time, and each unknown is counted in its
    unit (n,).
    """
    scale: Any = time_scale_s
    factors = [scale**k / factorial(k) for k in range(len(blocks))]
    scaled = blocks * np.array(factors, dtype=object)[:, None, None]
    scaled = scaled * np.array(units, dtype=object)
    with localcontext(Context(prec=DIGITS)):
        values, right = _singular(_decimal(scaled.reshape(-1, scaled.shape[-1])))
    directions = np.array(right, dtype=np.float64)
    return ObservabilityRank(tuple(values), tolerance, directions)


def exact_rank(blocks: ObjectArray) -> int:
    """Rank of gradients (K + 1, m, n) of `Fraction`, by elimination without rounding."""
    rows = blocks.reshape(-1, blocks.shape[-1]).copy()
    rank = 0
    for column in range(rows.shape[1]):
        pivots = np.flatnonzero(rows[rank:, column] != 0)
        if not len(pivots):
            continue
        pivot = rank + int(pivots[0])
        rows[[rank, pivot]] = rows[[pivot, rank]]
        factors = rows[rank + 1 :, column] / rows[rank, column]
        rows[rank + 1 :] = rows[rank + 1 :] - np.outer(factors, rows[rank])
        rank += 1
        if rank == len(rows):
            break
    return rank


def _singular(matrix: ObjectArray) -> tuple[list[Decimal], ObjectArray]:
    """Singular values, largest first, and right singular vectors (n, n) of a matrix of decimals.

    One-sided Jacobi: rotations of pairs of columns until all are orthogonal (Hestenes 1958). It
    finds small singular values to as many digits as large ones where columns are well scaled.
    """
    work = matrix.copy()
    n = work.shape[1]
    right = np.array([[Decimal(int(i == j)) for j in range(n)] for i in range(n)], dtype=object)
    least = Decimal(10) ** (4 - DIGITS)
    floor = (sum(work.ravel() * work.ravel(), Decimal(0)) or Decimal(1)) * least**2
    for _ in range(_MAX_SWEEPS):
        rotated = False
        for i in range(n - 1):
            for j in range(i + 1, n):
                rotated |= _orthogonalise(work, right, i, j, least, floor)
        if not rotated:
            break
    values = [(work[:, k] @ work[:, k]).sqrt() for k in range(n)]
    order = sorted(range(n), key=lambda k: values[k], reverse=True)
    return [values[k] for k in order], right[:, order]


def _orthogonalise(
    work: ObjectArray, right: ObjectArray, i: int, j: int, least: Decimal, floor: Decimal
) -> bool:
    """Make columns i and j orthogonal, in place; whether there was anything to do."""
    x, y = work[:, i], work[:, j]
    xx, yy, xy = x @ x, y @ y, x @ y
    # Columns that are nothing but rounding are orthogonal to all.
    if abs(xy) <= least * (xx * yy).sqrt() or xx <= floor or yy <= floor:
        return False
    zeta = (yy - xx) / (2 * xy)
    tangent = (1 if zeta >= 0 else -1) / (abs(zeta) + (1 + zeta * zeta).sqrt())
    cosine = 1 / (1 + tangent * tangent).sqrt()
    sine = cosine * tangent
    for columns in (work, right):
        first, second = columns[:, i].copy(), columns[:, j].copy()
        columns[:, i] = cosine * first - sine * second
        columns[:, j] = sine * first + cosine * second
    return True


def _decimal(matrix: ObjectArray) -> ObjectArray:
    return np.array([[_to_decimal(value) for value in row] for row in matrix], dtype=object)


def _to_decimal(value: Number) -> Decimal:
    """To the digits of the context."""
    if isinstance(value, Fraction):
        return Decimal(value.numerator) / Decimal(value.denominator)
    return +value


def directions_in_words(basis: FloatArray, names: tuple[str, ...]) -> tuple[str, ...]:
    """The space that the columns of a basis (n, k) span, in k names.

    Any basis of the space would do; the one named involves few states each. A state that is in
    the space by itself stands alone.
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
