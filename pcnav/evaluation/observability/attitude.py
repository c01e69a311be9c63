"""Local observability of a free body's rotation from its attitude alone: Deng 2024, section 2.

The state is the printed one (15): three components of the quaternion, the rate, five ratios of the
inertia over Jzz. What is measured are the three components (18).
"""

from collections.abc import Sequence
from decimal import Context, Decimal, localcontext
from fractions import Fraction

import numpy as np

from pcnav.evaluation.observability.lie import (
    LieDerivatives,
    Number,
    ObjectArray,
    Series,
    constant,
    lie_derivatives,
)
from pcnav.evaluation.observability.rank import (
    DIGITS,
    ObservabilityRank,
    directions_in_words,
    exact_rank,
    rank_of,
)

UNKNOWNS = (
    *("q1", "q2", "q3", "rate x", "rate y", "rate z"),
    *("Jxx/Jzz", "Jyy/Jzz", "Jxy/Jzz", "Jxz/Jzz", "Jyz/Jzz"),
)
ORDER = 10
"""Highest derivative that the rank condition asks for: one less than there are unknowns (20)."""
_MEASURED = 3


def attitude_rank(
    quaternion_xyzw: Sequence[float],
    omega_body: Sequence[float],
    printed_ratios: Sequence[float],
    order: int = ORDER,
) -> ObservabilityRank:
    """Rank of Q_order (20) at a state: see `attitude_ranks`."""
    return attitude_ranks(quaternion_xyzw, omega_body, printed_ratios, (order,))[0]


def attitude_ranks(
    quaternion_xyzw: Sequence[float],
    omega_body: Sequence[float],
    printed_ratios: Sequence[float],
    orders: Sequence[int],
) -> list[ObservabilityRank]:
    """Ranks of Q_k (20) for several k at a state, by Taylor arithmetic of sixty digits.

    Args:
        quaternion_xyzw: of ``R_world_body``, the numbers of (10); its scalar must not vanish, where
            three components are no coordinates.
        omega_body: (3,) rad/s.
        printed_ratios: Jxx, Jyy, Jxy, Jxz, Jyz over Jzz.
        orders: of the last Lie derivative, at least one.

    The floats are taken as they are, to the last bit. Units: 1 for quaternion and ratios, and for
    the rate its own length, whose inverse is the unit of time.
    """
    with localcontext(Context(prec=DIGITS)):
        state = [Decimal(float(v)) for v in (*quaternion_xyzw, *omega_body, *printed_ratios)]
        blocks = attitude_lie_derivatives(state, max(orders)).gradients
        speed = sum((w * w for w in state[4:7]), Decimal(0)).sqrt() or Decimal(1)
        one = Decimal(1)
        units = (one, one, one, speed, speed, speed, *[one] * 5)
        return [rank_of(blocks[: order + 1], one / speed, units) for order in orders]


def attitude_exact_rank(
    quaternion_xyzw: Sequence[float],
    omega_body: Sequence[float],
    printed_ratios: Sequence[float],
    order: int,
) -> int:
    """Rank of Q_order at exactly the given floats, without any rounding and any tolerance."""
    values = (*quaternion_xyzw, *omega_body, *printed_ratios)
    return exact_rank(attitude_lie_derivatives([Fraction(v) for v in values], order).gradients)


def attitude_lie_derivatives(state: Sequence[Number], order: int) -> LieDerivatives:
    """Lie derivatives of (18) along (17) at q (4), rate (3) and ratios (5).

    The unknowns are the eleven of (15): q4 follows from the length of q, ``q . dq = 0``. Nothing
    but its direction matters, so a quaternion that is of unit length but for rounding will do.
    """
    kind = type(state[0])
    seeds: ObjectArray = np.full((12, 11), kind(0), dtype=object)
    for k in range(11):
        seeds[k if k < _MEASURED else k + 1, k] = kind(1)
    for k in range(_MEASURED):
        seeds[3, k] = -state[k] / state[3]  # type: ignore[operator]
    return lie_derivatives(_motion, lambda x: x[:_MEASURED], state, seeds, order)


def rank_in_words(rank: ObservabilityRank) -> str:
    """One line: the rank and what is not observable, as "8 of 11; not observable: Jxx/Jzz, ..."."""
    text = f"{rank.rank} of {rank.size}"
    if rank.rank == rank.size:
        return text
    return f"{text}; not observable: {', '.join(directions_in_words(rank.unobservable, UNKNOWNS))}"


def _motion(x: Sequence[Series]) -> list[Series]:
    """(17): ``q' = q * (w, 0) / 2``, ``w' = L^-1 (L w x w)``, constant ratios."""
    q, w, (xx, yy, xy, xz, yz) = x[:4], x[4:7], x[7:]
    kind = type(w[0].coefficients[0, 0])
    half = kind(1) / kind(2)
    momentum = (
        xx * w[0] + xy * w[1] + xz * w[2],
        xy * w[0] + yy * w[1] + yz * w[2],
        xz * w[0] + yz * w[1] + w[2],
    )
    torque = _cross(momentum, w)
    # The adjugate of L with Lzz = 1; it is symmetric.
    one = constant(kind(1), w[0])
    a = (yy - yz * yz, xz * yz - xy, xy * yz - xz * yy)
    b = (a[1], xx - xz * xz, xy * xz - xx * yz)
    c = (a[2], b[2], xx * yy - xy * xy)
    inverse_determinant = one / (xx * a[0] + xy * a[1] + xz * a[2])
    acceleration = [_dot(row, torque) * inverse_determinant for row in (a, b, c)]
    turned = _cross(q[:3], w)
    attitude = [(q[3] * w[k] + turned[k]).scaled(half) for k in range(3)]
    scalar = (-_dot(q[:3], w)).scaled(half)
    return [*attitude, scalar, *acceleration, *[constant(kind(0), w[0])] * 5]


def _cross(a: Sequence[Series], b: Sequence[Series]) -> tuple[Series, Series, Series]:
    return (
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    )


def _dot(a: Sequence[Series], b: Sequence[Series]) -> Series:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
