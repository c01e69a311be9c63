"""Variances of counts along edges, against edges that are laid on the grid at every phase."""

import numpy as np
import pytest

from pcnav.perception.grid_variances import bent_grid_variances, grid_variances


@pytest.mark.parametrize("slope", [0.0, 0.37, 0.5, 1.0])
def test_variances_on_the_grid_are_those_of_straight_edges_of_any_phase(slope: float) -> None:
    cases = [(n, d) for n in (5, 12, 41, 80) for d in (0.1, 0.3, 0.5)]
    phase = (np.arange(6000) + 0.5)[:, None] / 6000
    n, distance = (np.array(column) for column in zip(*cases, strict=True))
    mean, tilt = grid_variances(n, np.full(len(n), slope), distance)
    for k, (size, d) in enumerate(cases):
        i = np.arange(size)
        counted = np.floor(phase + i * slope + d) - np.floor(phase + i * slope) - d
        assert np.abs(counted.mean()) < 1e-3
        centred = i - i.mean()
        slopes = counted @ centred / (centred @ centred)
        # To the phases that were tried.
        assert mean[k] == pytest.approx(counted.mean(axis=1).var(), rel=0.02, abs=2e-5), cases[k]
        assert tilt[k] == pytest.approx(slopes.var(), rel=0.02, abs=1e-9), cases[k]
    further = grid_variances(n, np.full(len(n), slope), distance + 0.5)
    np.testing.assert_array_equal(
        further, grid_variances(n, np.full(len(n), slope), np.full(len(n), 0.5))
    )


def test_grid_variances_of_curves_are_those_of_any_phase() -> None:
    phase = (np.arange(4000) + 0.5)[:, None] / 4000
    for size, slope, bend in ((60, 0.0, 3e-4), (41, 0.37, 1e-3), (90, 0.5, 2e-4), (25, 1.0, 5e-3)):
        i = np.arange(size)
        minor = slope * i + bend * i**2
        centred = i - i.mean()
        weights = (np.full(size, 1.0 / size), centred / (centred @ centred))
        for d in (0.1, 0.3, 0.5):
            counted = np.floor(phase + minor + d) - np.floor(phase + minor) - d
            found = bent_grid_variances(minor, weights, np.array([0]), np.array([d]))
            # A tilt has less of the low harmonics.
            for variance, weight, rel in zip(found, weights, (0.1, 0.25), strict=True):
                assert variance[0] == pytest.approx((counted @ weight).var(), rel=rel)
