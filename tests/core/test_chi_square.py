"""The chi-square distribution, against the one of scipy.stats."""

import numpy as np
from scipy.stats import chi2

from pcnav.core import chi_square

PROBABILITIES = np.array([1e-12, 1e-4, 0.025, 0.5, 0.95, 0.9999])
DEGREES = np.array([1, 2, 7, 300, 20_000])


def test_it_is_the_distribution_of_scipy() -> None:
    p, dof = np.meshgrid(PROBABILITIES, DEGREES)
    np.testing.assert_allclose(chi_square.quantile(p, dof), chi2.ppf(p, dof), rtol=1e-12)
    np.testing.assert_allclose(chi_square.upper_quantile(p, dof), chi2.isf(p, dof), rtol=1e-12)
    values = chi2.isf(p, dof)
    np.testing.assert_allclose(chi_square.exceeds(values, dof), p, rtol=1e-9)


def test_it_is_the_sum_of_squares_of_normal_numbers() -> None:
    squares = np.sum(np.random.default_rng(4).normal(size=(200_000, 5)) ** 2, axis=1)
    share = np.mean(squares < chi_square.quantile(0.95, 5))
    assert abs(share - 0.95) < 4.0 * np.sqrt(0.95 * 0.05 / 200_000)
