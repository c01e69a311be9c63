"""How strongly a target is accelerated, learnt from how far its frames lie from the predictions.

Accelerations are taken as white, of one density in all directions of a translation and one of a
rotation. Each level on a grid predicts the spread of the innovations; the likelihoods of the last
frames, older ones counting less, weigh the levels (a marginal likelihood on a grid, forgetting as
in West and Harrison 1997).
"""

import numpy as np

from pcnav.core.arrays import FloatArray
from pcnav.filtering.predictive import log_densities

_LEVELS = 16
_SMALLEST_STEP, _LARGEST_STEP = 1e-5, 0.3
"""Standard deviations that the levels add to a pose over one frame, over the diameter and in rad.
The largest is as far as poses of successive frames are linked."""
_MEMORY_FRAMES = 20
TRANSLATION, ROTATION = 0, 1


class AccelerationLevels:
    """Weights of the densities of translational and rotational acceleration."""

    def __init__(self, diameter_m: float, step_s: float) -> None:
        """For a target of a size, in frames about ``step_s`` apart."""
        steps = np.geomspace(_SMALLEST_STEP, _LARGEST_STEP, _LEVELS)
        # White acceleration of density q adds q dt^3 / 3 to the variance of a place.
        self._grid = 3.0 * np.stack([(steps * diameter_m) ** 2, steps**2]) / step_s**3
        self._log_weights = np.zeros((2, _LEVELS))

    def suggest(self, densities: FloatArray) -> None:
        """Begin about densities (2,) that few frames speak for, right to a power of ten or so."""
        off = np.log10(self._grid / np.maximum(densities, self._grid[:, 0])[:, None])
        self._log_weights = -0.5 * off**2

    @property
    def densities(self) -> FloatArray:
        """(2,) expected power spectral densities: m^2/s^3 and rad^2/s^3."""
        weights = np.exp(self._log_weights - self._log_weights.max(axis=1, keepdims=True))
        return np.asarray(np.sum(weights * self._grid, axis=1) / weights.sum(axis=1))

    def learn(
        self, innovation: FloatArray, unforced: FloatArray, by_density: tuple[FloatArray, ...]
    ) -> None:
        """Take in the innovation of a frame.

        Args:
            innovation: (m,) measured minus predicted.
            unforced: (m, m) its covariance if nothing had accelerated the target since the frame
                before.
            by_density: two of (m, m), what each density adds to it per unit.
        """
        forced = self.densities
        for kind, other in ((TRANSLATION, ROTATION), (ROTATION, TRANSLATION)):
            fixed = unforced + forced[other] * by_density[other]
            spreads = fixed + self._grid[kind][:, None, None] * by_density[kind]
            weights = (1.0 - 1.0 / _MEMORY_FRAMES) * self._log_weights[kind]
            weights += log_densities(innovation, spreads)
            self._log_weights[kind] = weights - weights.max()
