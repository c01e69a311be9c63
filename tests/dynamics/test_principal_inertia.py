"""Errors of inertia in its principal axes, against the eigen-decomposition they stand for."""

import numpy as np
import pytest

from pcnav.core.spatial import log_rotation
from pcnav.dynamics.principal_inertia import (
    axes_error,
    middle_ratio,
    moments_from_ratios,
    moments_jacobian,
    move_axes,
    ratios_from_moments,
    ratios_jacobian,
    transport,
)

STEP = 1e-6
MOMENTS = np.array([8.0, 5.0, 4.0])
RATIOS = ratios_from_moments(MOMENTS)


def numerical(function, at):
    columns = [
        (function(at + STEP * e) - function(at - STEP * e)) / (2.0 * STEP) for e in np.eye(len(at))
    ]
    return np.stack(columns, axis=-1)


def test_ratios_and_moments_follow_print():
    px, pz = RATIOS
    py = middle_ratio(RATIOS)
    assert py == pytest.approx((4.0 - 8.0) / 5.0)
    assert px + py + pz + px * py * pz == pytest.approx(0.0, abs=1e-15)
    np.testing.assert_allclose(moments_from_ratios(RATIOS), MOMENTS / 8.0)
    # (22) has the same torque accelerate the axes by their moments.
    assert (1.0 - py) / (1.0 + px) == pytest.approx(MOMENTS[0] / MOMENTS[1])
    assert (1.0 + pz) / (1.0 - px) == pytest.approx(MOMENTS[0] / MOMENTS[2])


def test_derivatives():
    np.testing.assert_allclose(
        moments_jacobian(RATIOS), numerical(moments_from_ratios, RATIOS), atol=1e-9
    )
    np.testing.assert_allclose(
        ratios_jacobian(MOMENTS), numerical(ratios_from_moments, MOMENTS), atol=1e-9
    )


def test_small_errors_are_a_turn_and_a_difference():
    theta, change = np.array([3e-6, -2e-6, 1e-6]), np.array([1e-6, 2e-6])
    axes, ratios = move_axes(RATIOS, theta, change)
    np.testing.assert_allclose(log_rotation(axes), theta, atol=1e-10)
    np.testing.assert_allclose(ratios - RATIOS, change, atol=1e-10)


@pytest.mark.parametrize("size", [1e-3, 0.05, 0.1])
def test_an_error_is_found_again(size):
    rng = np.random.default_rng(0)
    for _ in range(20):
        theta, change = size * rng.normal(size=3), 0.1 * size * rng.normal(size=2)
        axes, ratios = move_axes(RATIOS, theta, change)
        assert np.linalg.det(axes) == pytest.approx(1.0)
        found = axes_error(RATIOS, axes, ratios)
        np.testing.assert_allclose(found[0], theta, atol=1e-12)
        np.testing.assert_allclose(found[1], change, atol=1e-12)


def test_errors_of_the_inertia_matrix_lie_on_straight_lines():
    # Twice the error is twice the change of N = 3 I / tr(I) seen in the old axes.
    def matrix(scale):
        axes, ratios = move_axes(RATIOS, scale * np.array([0.3, 0.1, -0.2]), scale * RATIOS * 0.1)
        moments = moments_from_ratios(ratios)
        return axes @ np.diag(3.0 * moments / moments.sum()) @ axes.T

    np.testing.assert_allclose(matrix(1.0) - matrix(0.5), matrix(0.5) - matrix(0.0), atol=1e-12)


def test_small_errors_are_carried_along():
    theta, change = np.array([0.2, -0.1, 0.15]), np.array([0.02, -0.03])
    axes, ratios = move_axes(RATIOS, theta, change)

    def seen_from_there(error):
        moved, new = move_axes(RATIOS, theta + error[:3], change + error[3:])
        return np.concatenate(axes_error(ratios, axes.T @ moved, new))

    expected = numerical(seen_from_there, np.zeros(5))
    np.testing.assert_allclose(transport(RATIOS, axes, ratios), expected, atol=1e-8)


def test_equal_moments_do_no_harm():
    ratios = ratios_from_moments(np.array([8.0, 4.0, 4.0]))
    axes, new = move_axes(ratios, np.array([5.0, 0.01, 0.01]), np.array([0.01, 0.0]))
    assert np.linalg.det(axes) == pytest.approx(1.0)
    assert np.all(np.isfinite(transport(ratios, axes, new)))
