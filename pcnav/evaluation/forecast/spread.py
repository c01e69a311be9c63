"""The spread of drawn values: mean, covariance, and the ellipsoid that holds 95 % of them.

The ellipsoid is that of the covariance, so large that it holds 95 % of the drawn values. Of values
that are normal its size is that of the chi-square distribution; of a spread that is bent around an
axis the covariance alone would promise too much or too little.
"""

from dataclasses import dataclass

import numpy as np

from pcnav.core.arrays import BoolArray, FloatArray
from pcnav.core.spatial import exp_rotation, log_rotation, nearest_rotation
from pcnav.core.statistics import CONFIDENCE

_FLAT = 1e-12
"""Variance along an axis, over the largest, below which values do not vary along it."""


@dataclass(frozen=True)
class Spread:
    """Of vectors, or of rotations about their mean."""

    mean: FloatArray
    """(3,), or (3, 3) of rotations."""
    covariance: FloatArray
    """(3, 3) about the mean; of rotations of the right error, rad^2."""
    reach: float
    """Mahalanobis distance within which 95 % of the values are: 2.80 where they are normal."""
    radius: float
    """Distance, or angle, from the mean within which 95 % of the values are."""

    def holds(self, values: FloatArray) -> BoolArray:
        """(...,) whether values (..., 3), or rotations (..., 3, 3), are in the ellipsoid."""
        return np.asarray(self.distance(values) <= self.reach)

    def distance(self, values: FloatArray) -> FloatArray:
        """(...,) Mahalanobis distances from the mean."""
        return _distances(self._errors(values), self.covariance)

    def _errors(self, values: FloatArray) -> FloatArray:
        if self.mean.ndim == 1:
            return np.asarray(values - self.mean)
        return log_rotation(self.mean.T @ values)


def spread_of_vectors(values: FloatArray) -> Spread:
    """Of (N, 3)."""
    mean = values.mean(axis=0)
    return _spread(mean, values - mean)


def spread_of_rotations(R: FloatArray) -> Spread:
    """Of (N, 3, 3): about the rotation that is nearest to all of them."""
    mean = nearest_rotation(R.mean(axis=0))
    # The mean of the errors is what is left to go.
    mean = mean @ exp_rotation(log_rotation(mean.T @ R).mean(axis=0))
    return _spread(mean, log_rotation(mean.T @ R))


def _spread(mean: FloatArray, errors: FloatArray) -> Spread:
    covariance = errors.T @ errors / len(errors)
    reach = np.quantile(_distances(errors, covariance), CONFIDENCE)
    radius = np.quantile(np.linalg.norm(errors, axis=1), CONFIDENCE)
    return Spread(mean, covariance, float(reach), float(radius))


def _distances(errors: FloatArray, covariance: FloatArray) -> FloatArray:
    variances, axes = np.linalg.eigh(covariance)
    floor = max(_FLAT * variances[-1], np.finfo(np.float64).tiny)
    along = errors @ axes / np.sqrt(np.maximum(variances, floor))
    return np.asarray(np.linalg.norm(along, axis=-1))
