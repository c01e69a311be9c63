"""Torque-free rotation and forms of the inertia against physics and numerical derivatives."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial.transform import Rotation

from pcnav.core.arrays import FloatArray
from pcnav.dynamics.rigid_body import (
    euler_forms,
    inertia_from_ratios,
    is_physical_inertia,
    ratios_from_inertia,
)
from tests.dynamics.reference import euler_acceleration

POINTS = arrays(np.float64, (6, 3), elements=st.floats(-2.0, 2.0).map(lambda x: round(x, 3)))


def point_inertia(points: FloatArray) -> FloatArray:
    """Inertia matrix of unit point masses about the origin, from its definition."""
    squares = np.sum(points**2, axis=1)
    return np.asarray(np.sum(squares) * np.eye(3) - points.T @ points)


def random_body(rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """Ratios of a physical body and a rate."""
    return ratios_from_inertia(point_inertia(rng.normal(size=(8, 3)))), rng.normal(0.0, 0.5, 3)


def test_ratios_keep_the_order_of_the_paper() -> None:
    inertia = inertia_from_ratios(np.array([2.0, 3.0, 0.4, 0.5, 0.6]))
    expected = np.array([[1.0, 0.4, 0.5], [0.4, 2.0, 0.6], [0.5, 0.6, 3.0]])
    np.testing.assert_array_equal(inertia, expected)
    np.testing.assert_allclose(ratios_from_inertia(7.0 * expected), [2.0, 3.0, 0.4, 0.5, 0.6])


@given(arrays(np.float64, 5, elements=st.floats(-3.0, 3.0)), st.floats(1e-3, 1e3))
def test_ratios_of_a_scaled_inertia_are_the_ratios(ratios: FloatArray, scale: float) -> None:
    inertia = scale * inertia_from_ratios(ratios)
    np.testing.assert_allclose(ratios_from_inertia(inertia), ratios, rtol=1e-12, atol=1e-15)


@given(POINTS)
def test_any_real_body_is_physical(points: FloatArray) -> None:
    # A line has a zero moment and a sheet meets the triangle inequality with equality: thicken.
    inertia = point_inertia(points) + 0.01 * np.eye(3)
    assert is_physical_inertia(inertia)


@pytest.mark.parametrize(
    ("moments", "physical"),
    [
        ((1.0, 1.0, 1.0), True),
        ((1.0, 2.0, 3.0), True),
        ((1.0, 2.0, 3.01), False),
        ((3.01, 1.0, 2.0), False),
        ((0.0, 1.0, 1.0), False),
        ((-1.0, 1.0, 1.0), False),
    ],
)
def test_triangle_inequality(moments: tuple[float, float, float], physical: bool) -> None:
    assert is_physical_inertia(np.diag(moments)) is physical
    # The borderline cases do not survive the rounding of a rotation.
    if moments not in {(1.0, 2.0, 3.0), (0.0, 1.0, 1.0)}:
        R = Rotation.from_rotvec([0.2, 1.5, -0.7]).as_matrix()
        assert is_physical_inertia(R @ np.diag(moments) @ R.T) is physical


def test_derivatives_are_the_numerical_ones() -> None:
    rng = np.random.default_rng(1)
    for _ in range(10):
        ratios, omega = random_body(rng)
        inertia = inertia_from_ratios(ratios)
        rate_form, ratio_form = euler_forms(inertia)
        by_omega, by_ratios = rate_form @ omega, ratio_form @ omega @ omega
        acceleration = 0.5 * by_omega @ omega
        np.testing.assert_allclose(acceleration, euler_acceleration(inertia, omega), atol=1e-13)
        h = 1e-6
        for k, step in enumerate(h * np.eye(3)):
            change = euler_acceleration(inertia, omega + step) - euler_acceleration(
                inertia, omega - step
            )
            np.testing.assert_allclose(by_omega[:, k], change / (2.0 * h), atol=1e-8)
        for k, step in enumerate(h * np.eye(5)):
            change = euler_acceleration(
                inertia_from_ratios(ratios + step), omega
            ) - euler_acceleration(inertia_from_ratios(ratios - step), omega)
            np.testing.assert_allclose(by_ratios[:, k], change / (2.0 * h), atol=1e-8)
