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
"""Over fewer frames a factor of the noise explains anything; it is then that of ..."""
_BEFORE_FRAMES = 5
"""... so many frames before them at least, or there are no odds."""


class MotionContest:
    """The last frames under two motion models."""

    def __init__(self) -> None:
        self._frames: deque[tuple[Surprise, Surprise]] = deque(maxlen=WINDOW_FRAMES)

    def __len__(self) -> int:
        return len(self._frames)

    def add(self, torque_free: Surprise, kinematic: Surprise) -> None:
        """Take in what one frame was under both, before either had taken it in."""
        self._frames.append((torque_free, kinematic))

    def odds_against(self) -> tuple[float, int]:
        """Logarithm of the odds against a free body, over the last frames that speak most against
        it, and how many these are; no odds at all over too few."""
        if not self._frames:
            return -np.inf, 0
        odds = -self._odds_for_free()
        worst = int(np.argmax(odds))
        return float(odds[worst]), worst + 1

    def odds_for(self) -> float:
        """Logarithm of the odds for a free body, over all frames that are kept."""
        enough = len(self._frames) >= _MIN_FRAMES
        return float(self._odds_for_free()[-1]) if enough else 0.0

    def _odds_for_free(self) -> FloatArray:
        """(n,) over the last frame, the last two, and so on; inf where there are none."""
        table = np.array([[_row(s) for s in pair] for pair in reversed(self._frames)])
        total = np.cumsum(table, axis=0)
        nis, log_det, dof = np.moveaxis(total, -1, 0)
        factor = nis / np.maximum(dof, 1.0)
        few = min(_MIN_FRAMES - 1, len(total))
        known = np.arange(few) + _BEFORE_FRAMES < len(total)
        before = np.moveaxis(total[-1] - total[:few], -1, 0)
        factor[:few] = before[0] / np.maximum(before[2], 1.0)
        factor = np.maximum(factor, 1.0)
        log_likelihood = -0.5 * (dof * np.log(factor) + nis / factor + log_det)
        odds = log_likelihood[:, 0] - log_likelihood[:, 1]
        odds[:few][~known] = np.inf
        return np.asarray(odds)


def _row(surprise: Surprise) -> tuple[float, float, float]:
    return surprise.nis, surprise.log_det, float(surprise.dof)
