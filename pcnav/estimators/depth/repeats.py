"""Frames that bring the image of the one before once more, to the bit.

A program that reads a sensor faster than it measures, or a driver that has no new image, gives the
last one again under a later time. It says nothing of that time: taken for a measurement it is a
target that stood still and jumps in the next frame.
"""

import numpy as np

from pcnav.core.arrays import DepthImage
from pcnav.recordings.sequence import Frame

_MAX_IN_A_ROW = 10
"""After more of them nothing moves, and the images have no noise."""


class Repeats:
    """Tells such frames in a sequence."""

    def __init__(self) -> None:
        self._last: DepthImage | None = None
        self._differed = False
        self._in_a_row = 0

    def is_one(self, frame: Frame) -> bool:
        """Whether a frame repeats the one before; each frame is asked for once.

        Images without noise are alike where nothing moves: none is a repetition before two have
        differed, nor are many in a row.
        """
        before, self._last = self._last, frame.depth_m
        if before is None or not frame.depth_m.any():
            return False
        if not np.array_equal(frame.depth_m, before):
            self._differed, self._in_a_row = True, 0
            return False
        self._in_a_row += 1
        return self._differed and self._in_a_row <= _MAX_IN_A_ROW
