"""A free body's motion against any motion, by how well each predicted the same frames.

An absolute test of innovations would take a misstated noise for a wrong motion. Odds do not: each
model's noise may be larger than stated by the factor that suits it best.
"""

from collections import deque

import numpy as np

from pcnav.core.arrays import FloatArray
from pcnav.filtering.predictive import Surprise

WINDOW_FRAMES = 20
"""Frames that are compared at most."""
_MIN_FRAMES = 3
"""Over fewer frames a factor of the noise explains anything; it is then that of the frames before
them, and of the arc that a free body was fitted to..."""
_MIN_DOF = 4
"""... with so many degrees of freedom at least, or there are no odds."""


class MotionContest:
    """The last frames under two motion models."""

    def __init__(self, chi_square: float = 0.0, dof: int = 0) -> None:
        """``chi_square`` and ``dof`` of the arc that the free body was fitted to."""
        self._arc = np.array([chi_square, max(dof, 0)])
        self._frames: deque[tuple[Surprise, Surprise]] = deque(maxlen=WINDOW_FRAMES)
        self._odds = np.zeros(0)

    def __len__(self) -> int:
        return len(self._frames)

    def add(self, torque_free: Surprise, kinematic: Surprise) -> None:
        """Take in what one frame was under both, before either had taken it in."""
        self._frames.append((torque_free, kinematic))
        self._odds = self._odds_for_free()

    def odds_against(self) -> tuple[float, int]:
        """Logarithm of the odds against a free body, over the last frames that speak most against
        it, and how many these are; no odds at all over too few."""
        if not self._frames:
            return -np.inf, 0
        odds = -self._odds
        worst = int(np.argmax(odds))
        return float(odds[worst]), worst + 1

    def odds_for(self) -> float:
        """Logarithm of the odds for a free body, over all frames that are kept."""
        enough = len(self._frames) >= _MIN_FRAMES
        return float(self._odds[-1]) if enough else 0.0

    def _odds_for_free(self) -> FloatArray:
        """(n,) over the last frame, the last two, and so on; inf where there are none."""
        table = np.array([[_row(s) for s in pair] for pair in reversed(self._frames)])
        total = np.cumsum(table, axis=0)
        nis, log_det, dof = np.moveaxis(total, -1, 0)
        factor = nis / np.maximum(dof, 1.0)
        few = min(_MIN_FRAMES - 1, len(total))
        before = (total[-1] - total[:few])[..., [0, 2]]
        before[:, 0] += self._arc
        # The arc is the free body's; where the other has no frames before, its noise is the same.
        before[:, 1] = np.where(before[:, 1, 1:] > 0, before[:, 1], before[:, 0])
        known = before[:, 0, 1] >= _MIN_DOF
        factor[:few] = before[..., 0] / np.maximum(before[..., 1], 1.0)
        factor = np.maximum(factor, 1.0)
        log_likelihood = -0.5 * (dof * np.log(factor) + nis / factor + log_det)
        odds = log_likelihood[:, 0] - log_likelihood[:, 1]
        odds[:few][~known] = np.inf
        return np.asarray(odds)


def _row(surprise: Surprise) -> tuple[float, float, float]:
    return surprise.nis, surprise.log_det, float(surprise.dof)
