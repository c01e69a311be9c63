"""The second-order part of a fit, where it can be worked out by hand or drawn."""

import numpy as np
import pytest

from pcnav.core.arrays import FloatArray
from pcnav.filtering.arc_curvature import LinearisedArc, bend_of

SD_LOOSE, SD_SHARP, CURVE = 0.3, 1e-3, 0.5


def valley(error: FloatArray) -> LinearisedArc:
    """Sharp in ``x1 - CURVE x0^2``, loose in x0; the last state is a first one moved along."""
    jacobian = np.array(
        [[1.0 / SD_LOOSE, 0.0], np.array([-2.0 * CURVE * error[0], 1.0]) / SD_SHARP]
    )
    return LinearisedArc(jacobian, np.array([[1.0, 0.0], [0.2 * error[0], 1.0]]))


def test_a_parabola_has_the_moments_of_a_squared_normal() -> None:
    at = valley(np.zeros(2))
    bend = bend_of(at, np.zeros(2), np.diag([SD_LOOSE**2, SD_SHARP**2]), slice(0, 1), valley)
    # x1 = CURVE x0^2 there, and the last state adds 0.1 x0^2: E (a z^2)^2 = 3 a^2.
    a = (CURVE + 0.1) * SD_LOOSE**2
    np.testing.assert_allclose(bend.second_moment, [[0.0, 0.0], [0.0, 3.0 * a**2]], atol=1e-12)
    assert bend.excess == pytest.approx(3.0 * (a / SD_SHARP) ** 2)


def test_covariance_with_the_bend_is_that_of_the_posterior() -> None:
    """By draws of the posterior itself: x0 normal, x1 normal about the parabola."""
    rng = np.random.default_rng(2)
    x0 = SD_LOOSE * rng.standard_normal(200_000)
    x1 = CURVE * x0**2 + SD_SHARP * rng.standard_normal(len(x0))
    last = np.stack([x0, x1 + 0.1 * x0**2])
    covariance = np.diag([SD_LOOSE**2, SD_SHARP**2])
    bend = bend_of(valley(np.zeros(2)), np.zeros(2), covariance, slice(0, 1), valley)
    total = covariance + bend.second_moment
    np.testing.assert_allclose(total, last @ last.T / len(x0), rtol=0.03, atol=5e-4)
    squared = np.einsum("in,ij,jn->n", last, np.linalg.inv(total), last)
    assert squared.mean() == pytest.approx(2.0, rel=0.02)
    alone = np.einsum("in,ij,jn->n", last, np.linalg.inv(covariance), last)
    assert alone.mean() == pytest.approx(2.0 + bend.excess, rel=0.02)


def test_what_is_straight_is_left_alone_after_one_look() -> None:
    looks: list[FloatArray] = []

    def straight(error: FloatArray) -> LinearisedArc:
        looks.append(error)
        return LinearisedArc(np.eye(3), np.eye(3))

    bend = bend_of(straight(np.zeros(3)), np.zeros(3), np.eye(3), slice(0, 3), straight)
    assert bend.excess == 0.0 and not bend.second_moment.any() and len(looks) == 2


def test_where_no_state_lies_to_one_side_the_other_one_tells() -> None:
    """As of a thin body, whose inertia may be one of a thicker one only."""

    def half(error: FloatArray) -> LinearisedArc:
        if error[0] > 0.0:
            raise ValueError("no body")
        return valley(error)

    prior = np.diag([SD_LOOSE**2, SD_SHARP**2])
    whole = bend_of(valley(np.zeros(2)), np.zeros(2), prior, slice(0, 1), valley)
    bend = bend_of(valley(np.zeros(2)), np.zeros(2), prior, slice(0, 1), half)
    np.testing.assert_allclose(bend.second_moment, whole.second_moment)
    assert bend.excess == pytest.approx(whole.excess)


def test_no_state_beside_the_fit_leaves_its_linearisation() -> None:
    def nowhere(error: FloatArray) -> LinearisedArc:
        raise ValueError("no body")

    at = valley(np.zeros(2))
    bend = bend_of(at, np.zeros(2), np.diag([SD_LOOSE**2, SD_SHARP**2]), slice(0, 1), nowhere)
    assert bend.excess == 0.0 and not bend.second_moment.any()
