"""Lie derivatives, ranks and their words, against SymPy, exact arithmetic and differences."""

from decimal import Decimal, localcontext
from fractions import Fraction

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from pcnav.evaluation.observability.attitude import (
    UNKNOWNS,
    attitude_exact_rank,
    attitude_lie_derivatives,
    attitude_rank,
    rank_in_words,
)
from pcnav.evaluation.observability.lie import Series, constant, lie_derivatives
from pcnav.evaluation.observability.rank import (
    directions_in_words,
    exact_rank,
    plain_basis,
    rank_of,
)

NUTATION = (0.85, 1.37, 0.13, 0.17, -0.11)
RATE = tuple(np.radians([5.0, 2.3, 3.5]).tolist())
SPIN = (0.85, 1.37, 0.0, 0.0, 0.0)
SPIN_RATE = (0.0, float(np.radians(2.3)), 0.0)
IDENTITY = (0.0, 0.0, 0.0, 1.0)


def _fractions(array) -> np.ndarray:
    return np.array([[Fraction(v) for v in row] for row in array], dtype=object)


def test_series_obey_calculus():
    """sin and cos from x' = y, y' = -x; and 1 / (x^2 + 2) by quotient and by its product."""
    x0, y0 = Fraction(1, 3), Fraction(2, 5)
    found = lie_derivatives(
        lambda x: [x[1], -x[0]],
        lambda x: [x[0], constant(Fraction(1), x[0]) / (x[0] * x[0] + constant(Fraction(2), x[0]))],
        [x0, y0],
        _fractions(np.eye(2, dtype=int).tolist()),
        6,
    )
    assert list(found.values[:, 0]) == [x0, y0, -x0, -y0, x0, y0, -x0]
    assert list(found.gradients[3, 0]) == [0, -1]
    # d/dt 1/(x^2 + 2) = -2 x y / (x^2 + 2)^2, and its gradient by y.
    square = x0 * x0 + 2
    assert found.values[1, 1] == -2 * x0 * y0 / square**2
    assert found.gradients[1, 1, 1] == -2 * x0 / square**2


def test_quotient_undoes_product():
    rng = np.random.default_rng(0)
    a, b = (Series(_fractions((rng.integers(-9, 9, (6, 4)) + 10).tolist())) for _ in range(2))
    assert np.all((a * b / b).coefficients == a.coefficients)


def test_lie_derivatives_equal_those_of_sympy():
    sympy = pytest.importorskip("sympy", reason="SymPy is an oracle only")
    q = sympy.symbols("q1:4")
    w = sympy.symbols("w1:4")
    ratios = sympy.symbols("xx yy xy xz yz")
    xx, yy, xy, xz, yz = ratios
    q4 = sympy.sqrt(1 - q[0] ** 2 - q[1] ** 2 - q[2] ** 2)
    L = sympy.Matrix([[xx, xy, xz], [xy, yy, yz], [xz, yz, 1]])
    rate, qv = sympy.Matrix(w), sympy.Matrix(q)
    acceleration = -(L.inv() * rate.cross(L * rate))
    attitude = (q4 * rate + qv.cross(rate)) / 2
    state = [*q, *w, *ratios]
    field = [*attitude, *acceleration, *[0] * 5]
    # A Pythagorean quaternion: all numbers stay rational.
    at = [
        *(Fraction(1, 5), Fraction(2, 5), Fraction(2, 5)),
        *(Fraction(1, 10), Fraction(1, 20), Fraction(-3, 40)),
        *(Fraction(17, 20), Fraction(13, 10), Fraction(1, 8), Fraction(1, 6), Fraction(-1, 9)),
    ]
    scalar = Fraction(4, 5)
    found = attitude_lie_derivatives([*at[:3], scalar, *at[3:]], 2)
    point = {s: sympy.Rational(v.numerator, v.denominator) for s, v in zip(state, at, strict=True)}
    derivative = list(q)
    for k in range(3):
        for i, each in enumerate(derivative):
            value = sympy.simplify(each.subs(point))
            assert Fraction(int(value.p), int(value.q)) == found.values[k, i]
            for j, s in enumerate(state):
                slope = sympy.simplify(sympy.diff(each, s).subs(point))
                assert Fraction(int(slope.p), int(slope.q)) == found.gradients[k, i, j]
        derivative = [
            sum(sympy.diff(each, s) * f for s, f in zip(state, field, strict=True))
            for each in derivative
        ]


def test_taylor_series_follows_the_motion():
    """The sum of the series against an integrator, and gradients against differences of it."""

    def motion(_, x):
        q, w, (xx, yy, xy, xz, yz) = x[:4], x[4:7], x[7:]
        L = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, 1.0]])
        acceleration = -np.linalg.solve(L, np.cross(w, L @ w))
        vector = 0.5 * (q[3] * w + np.cross(q[:3], w))
        return np.concatenate([vector, [-0.5 * q[:3] @ w], acceleration, np.zeros(5)])

    start = np.array([0.1, -0.3, 0.2, 0.0, 0.4, 0.2, 0.3, *NUTATION])
    start[3] = np.sqrt(1.0 - start[:3] @ start[:3])
    end_s = 1.0

    def integrated(x):
        x = x.copy()
        x[3] = np.sqrt(1.0 - x[:3] @ x[:3])
        return solve_ivp(motion, (0.0, end_s), x, rtol=1e-12, atol=1e-13).y[:3, -1]

    with localcontext() as context:
        context.prec = 40
        found = attitude_lie_derivatives([Decimal(float(v)) for v in start], 16)
    factorials = np.cumprod([1.0, *range(1, 17)])
    weights = end_s ** np.arange(17) / factorials
    summed = weights @ found.values.astype(float)
    np.testing.assert_allclose(summed, integrated(start), atol=1e-9)
    gradients = np.tensordot(weights, found.gradients.astype(float), 1)
    unknowns = [0, 1, 2, *range(4, 12)]
    for j, k in enumerate(unknowns):
        step = np.zeros(12)
        step[k] = 1e-5
        numerical = (integrated(start + step) - integrated(start - step)) / 2e-5
        np.testing.assert_allclose(gradients[:, j], numerical, atol=1e-6)


def test_rank_in_nutation_and_in_a_spin():
    nutation = attitude_rank(IDENTITY, RATE, NUTATION)
    assert nutation.rank == 11
    assert nutation.relative[-1] > 1e-5
    spin = attitude_rank(IDENTITY, SPIN_RATE, SPIN)
    assert spin.rank == 8
    # A clean gap: forty orders of magnitude between what counts and what does not.
    assert spin.relative[7] > 1e40 * spin.relative[8]
    assert rank_in_words(spin) == "8 of 11; not observable: Jxx/Jzz, Jyy/Jzz, Jxz/Jzz"
    # The paper needs derivatives of order 4 (21).
    assert attitude_exact_rank(IDENTITY, RATE, NUTATION, 4) == 11
    assert attitude_exact_rank(IDENTITY, SPIN_RATE, SPIN, 4) == 8


@pytest.mark.parametrize("seed", [1, 2])
def test_rank_at_random_states(seed):
    rng = np.random.default_rng(seed)
    q = rng.standard_normal(4)
    q *= np.sign(q[3]) / np.linalg.norm(q)
    points = rng.standard_normal((10, 3))
    J = np.sum(points**2) * np.eye(3) - points.T @ points
    ratios = np.array([J[0, 0], J[1, 1], J[0, 1], J[0, 2], J[1, 2]]) / J[2, 2]
    rate = (0.05 * rng.standard_normal(3)).tolist()
    assert attitude_rank(q.tolist(), rate, ratios.tolist(), 6).rank == 11
    # About a principal axis, to the digits of doubles.
    L = np.array(
        [[ratios[0], ratios[2], ratios[3]], [ratios[2], ratios[1], ratios[4]], [*ratios[3:], 1]]
    )
    axis = (0.05 * np.linalg.eigh(L)[1][:, 0]).tolist()
    assert attitude_rank(q.tolist(), axis, ratios.tolist(), 6).rank == 8


def test_singular_values_are_those_of_numpy():
    rng = np.random.default_rng(3)
    matrix = rng.standard_normal((4, 3, 5))
    blocks = np.array([Fraction(v) for v in matrix.ravel()], dtype=object).reshape(4, 3, 5)
    found = rank_of(blocks, Fraction(1), tuple([Fraction(1)] * 5))
    factorials = np.array([1.0, 1.0, 2.0, 6.0])
    scaled = (matrix / factorials[:, None, None]).reshape(-1, 5)
    expected = np.linalg.svd(scaled, compute_uv=False)
    np.testing.assert_allclose(np.array(found.singular_values, float), expected, rtol=1e-13)
    right = found.directions
    np.testing.assert_allclose(right.T @ right, np.eye(5), atol=1e-14)
    np.testing.assert_allclose(np.linalg.norm(scaled @ right, axis=0), expected, rtol=1e-12)


def test_exact_rank_sees_what_rounding_hides():
    tiny = Fraction(1, 10**40)
    rows = np.array([[[Fraction(1), Fraction(1)], [Fraction(1), Fraction(1) + tiny]]], dtype=object)
    assert exact_rank(rows) == 2
    assert exact_rank(rows[:, :1]) == 1
    assert rank_of(rows, Fraction(1), (Fraction(1), Fraction(1))).rank == 1


def test_directions_are_told_by_few_states():
    rng = np.random.default_rng(4)
    span = np.array([[1.0, 0, 0, 0], [0, 0, 1.0, 1.0]]).T
    mixed = span @ rng.standard_normal((2, 2))
    assert directions_in_words(mixed, ("a", "b", "c", "d")) == ("a", "0.71 c + 0.71 d")
    basis = plain_basis(mixed)
    assert np.linalg.matrix_rank(np.hstack([basis.T, span])) == 2
    assert len(UNKNOWNS) == 11
