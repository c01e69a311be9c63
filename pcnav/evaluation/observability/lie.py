"""Lie derivatives of any order and their gradients, by Taylor arithmetic on exact numbers.

Along ``x' = f(x)`` an output is ``h(x(t)) = sum_k L_f^k h(x0) t^k / k!``. The coefficients of x
follow one after the other from ``(k + 1) x_(k+1) = [f(x)]_k``, and if every number carries its
gradient by the unknowns at the start, those of h give ``d L_f^k h / dX`` of Deng 2024 (19) as well.
Only sums, products and quotients occur, so on `Fraction` there is no rounding at all. On `Decimal`
the numbers have the digits of the context.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from decimal import Decimal
from fractions import Fraction
from math import factorial
from typing import Any

import numpy as np
from numpy.typing import NDArray

Number = Fraction | Decimal
ObjectArray = NDArray[np.object_]
"""An array of `Number`, all of one kind."""


class Series:
    """A number along the motion: Taylor coefficients in time and their gradients."""

    def __init__(self, coefficients: ObjectArray) -> None:
        """``coefficients`` is (K + 1, 1 + n): the value's in the first column, then its gradient's
        by the n unknowns."""
        self.coefficients = coefficients

    def __add__(self, other: "Series") -> "Series":
        return Series(self.coefficients + other.coefficients)

    def __sub__(self, other: "Series") -> "Series":
        return Series(self.coefficients - other.coefficients)

    def __neg__(self) -> "Series":
        return Series(-self.coefficients)

    def __mul__(self, other: "Series") -> "Series":
        a, b = self.coefficients, other.coefficients
        product = np.empty_like(a)
        for k in range(len(a)):
            left, right = a[: k + 1], b[k::-1]
            product[k] = left[:, 0] @ right
            product[k, 1:] += right[:, 0] @ left[:, 1:]
        return Series(product)

    def __truediv__(self, other: "Series") -> "Series":
        """Raises `ZeroDivisionError` (or its kind in `decimal`) where the other's value is 0."""
        a, b = self.coefficients, other.coefficients
        quotient = np.empty_like(a)
        for k in range(len(a)):
            # a_k = sum_j c_j b_(k-j), solved for c_k; then the same for the gradients.
            earlier, rest = quotient[:k], b[k:0:-1]
            remainder = a[k] - (earlier[:, 0] @ rest if k else 0)
            if k:
                remainder[1:] = remainder[1:] - rest[:, 0] @ earlier[:, 1:]
            value = remainder[0] / b[0, 0]
            quotient[k, 0] = value
            quotient[k, 1:] = (remainder[1:] - value * b[0, 1:]) / b[0, 0]
        return Series(quotient)

    def scaled(self, factor: Number) -> "Series":
        """Times a constant."""
        return Series(self.coefficients * factor)


Field = Callable[[Sequence[Series]], Sequence[Series]]
"""Right-hand side f of an autonomous system, or an output h, made of sums, products, quotients."""


@dataclass(frozen=True)
class LieDerivatives:
    """``L_f^k h`` and their gradients for k = 0 ... K."""

    values: ObjectArray
    """(K + 1, m)"""
    gradients: ObjectArray
    """(K + 1, m, n) by the unknowns: the blocks of Q_K (Deng 2024 (20))."""


def lie_derivatives(
    field: Field,
    output: Field,
    state: Sequence[Number],
    seeds: ObjectArray,
    order: int,
) -> LieDerivatives:
    """Lie derivatives of an output along a field, up to an order, at a state.

    Args:
        field: ``f``, of the N numbers of the state.
        output: ``h``, m numbers of the state.
        state: (N,) all `Fraction` or all `Decimal`.
        seeds: (N, n) derivative of the state by the unknowns. Where the state obeys a constraint
            there are fewer unknowns than numbers: three for the four of a unit quaternion.
        order: K.
    """
    along = _taylor_series(field, state, seeds, order)
    seen = output(along)
    factorials = np.array([factorial(k) for k in range(order + 1)], dtype=object)
    table = np.stack([series.coefficients for series in seen], axis=1) * factorials[:, None, None]
    return LieDerivatives(values=table[..., 0], gradients=table[..., 1:])


def _taylor_series(
    field: Field, state: Sequence[Number], seeds: ObjectArray, order: int
) -> list[Series]:
    """The N numbers of the state along the motion, with coefficients up to an order."""
    start = np.column_stack([np.array(state, dtype=object), seeds])
    coefficients = start[:, None, :]
    for k in range(order):
        slopes = field([Series(each) for each in coefficients])
        following = np.stack([slope.coefficients[k] for slope in slopes]) / (k + 1)
        coefficients = np.concatenate([coefficients, following[:, None, :]], axis=1)
    return [Series(each) for each in coefficients]


def constant(value: Number, like: Series) -> Series:
    """A number that neither moves nor depends on the unknowns."""
    zero: Any = value * 0
    coefficients = np.full_like(like.coefficients, zero)
    coefficients[0, 0] = value
    return Series(coefficients)
