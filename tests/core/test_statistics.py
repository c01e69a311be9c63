"""Tests of what many runs come to."""

import numpy as np
import pytest

from pcnav.core.statistics import (
    NONE,
    chi_square_bounds,
    mean_squared,
    percentile,
    root_mean_square,
    share,
)


def test_mean_squared_of_many_is_that_of_each() -> None:
    squared = np.random.default_rng(1).chisquare(3.0, (40, 5))
    squared[3, 2] = np.nan
    together = mean_squared(squared, 3)
    for k, column in enumerate(squared.T):
        alone, known = mean_squared(column, 3), column[np.isfinite(column)]
        assert alone.mean == pytest.approx(known.sum() / (3.0 * len(known)), rel=1e-12)
        assert alone.values == len(known) == together.values[k]
        assert str(together[k]) == str(alone)
        lower, upper = chi_square_bounds(3.0 * len(known))
        assert alone.lower == pytest.approx(lower / (3.0 * len(known)))
        assert alone.upper == pytest.approx(upper / (3.0 * len(known)))


def test_bounds_hold_at_their_confidence() -> None:
    means = mean_squared(np.random.default_rng(2).chisquare(6.0, (20, 4000)), 6)
    assert means.inside.mean() == pytest.approx(0.95, abs=0.015)


def test_verdict_says_on_which_side() -> None:
    values = np.full(50, 6.0)
    assert mean_squared(values, 6).verdict == "inside"
    assert mean_squared(2.0 * values, 6).verdict == "above"
    assert mean_squared(0.5 * values, 6).verdict == "below"
    assert str(mean_squared(2.0 * values, 6)) == "2.00 (0.85 to 1.17) above"
    nothing = mean_squared(np.full(3, np.nan), 6)
    assert str(nothing) == nothing.verdict == nothing.bounds == NONE
    assert not nothing.inside


def test_degrees_of_freedom_weigh() -> None:
    assert mean_squared(np.array([1.0, 6.0]), np.array([1, 3])).mean == pytest.approx(7.0 / 4.0)
    # What has no degrees of freedom says nothing.
    assert mean_squared(np.array([1.0, 6.0]), np.array([0, 3])).values == 1


def test_a_share_has_wilsons_interval() -> None:
    found = share(9, 10)
    assert found.value == 0.9
    # Brown, Cai and DasGupta 2001, eq. 4.
    assert (found.low, found.high) == pytest.approx((0.59585, 0.98212), abs=1e-5)
    assert str(found) == "90.0% (59.6 to 98.2)"
    assert share(0, 8).low == 0.0


def test_missing_values_are_left_out() -> None:
    values = np.array([3.0, np.nan, 4.0])
    assert percentile(values, 50) == 3.5
    assert root_mean_square(values) == pytest.approx(np.sqrt(12.5))
    assert np.isnan(percentile(values[1:2], 50)) and np.isnan(root_mean_square(values[1:2]))
