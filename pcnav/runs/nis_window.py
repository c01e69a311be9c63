"""Whether the innovations of the last frames have the size that their covariances claim."""

from collections import deque

import numpy as np

from pcnav.core.arrays import BoolArray, FloatArray, IntArray

NIS_WINDOW_FRAMES = 20
"""Frames with a used measurement that are looked at together: enough to tell a covariance off by
half from chance, few enough to follow a run."""


class NisWindow:
    """Innovations of the last frames of one track in which a measurement was used."""

    def __init__(self) -> None:
        self._frames: deque[tuple[float, int]] = deque(maxlen=NIS_WINDOW_FRAMES)

    def add(self, nis: float, dof: int) -> None:
        """Take in a frame; one without a used measurement says nothing."""
        if dof > 0 and np.isfinite(nis):
            self._frames.append((nis, dof))

    def clear(self) -> None:
        """Forget a track that has ended: the next one starts from nothing."""
        self._frames.clear()

    @property
    def nis(self) -> float:
        """Sum of the squared normalised innovations."""
        return sum(nis for nis, _ in self._frames)

    @property
    def dof(self) -> int:
        """Sum of their degrees of freedom."""
        return sum(dof for _, dof in self._frames)

    @property
    def per_degree(self) -> float:
        """NIS over its degrees of freedom: about 1 of a filter that is right; nan without any."""
        return self.nis / self.dof if self._frames else float("nan")

    def follow(self, has_estimate: bool, nis: float, dof: int) -> float:
        """`per_degree` after the next frame of a run, whose tracks end where no estimate is."""
        if has_estimate:
            self.add(nis, dof)
        else:
            self.clear()
        return self.per_degree


def window_nis(nis: FloatArray, dof: IntArray, has_estimate: BoolArray) -> FloatArray:
    """(n,) of a whole run whose frames do not state it."""
    window = NisWindow()
    rows = zip(has_estimate.tolist(), nis.tolist(), dof.tolist(), strict=True)
    return np.array([window.follow(*row) for row in rows])
