"""Pixels of a frame that say nothing of a target, some of which depends on where it is."""

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from pcnav.core.arrays import BoolArray, DepthImage
from pcnav.recordings.sequence import Frame
from pcnav.target.rendering import RenderedDepth

_ABOUT_PX = 5
"""What was left out beside a view is compared with the farthest of it about there."""


@dataclass(frozen=True)
class Unseen:
    """What is not known of a frame."""

    always: BoolArray | None
    """(height, width) pixels of which nothing is known; None for none."""
    masked_m: DepthImage | None
    """(height, width) z-depth of what a mask left out, m, 0 elsewhere; None for nothing."""

    @staticmethod
    def of(frame: Frame) -> "Unseen | None":
        """Of a frame; None where all of it is known."""
        if frame.unseen is None and frame.masked_m is None:
            return None
        return Unseen(frame.unseen, frame.masked_m)

    def strided(self, stride: int) -> "Unseen":
        """On every so many pixels."""
        if stride == 1:
            return self
        every = slice(None, None, stride)
        always = None if self.always is None else self.always[every, every]
        masked_m = None if self.masked_m is None else self.masked_m[every, every]
        return Unseen(always, masked_m)

    def beside(self, rendered: RenderedDepth, tolerance_m: float) -> BoolArray:
        """(height, width) pixels that say nothing of a view.

        What a mask left out hides the target where it is nearer than that, by whatever the mask was
        made for; and where it lies at the depth that the view has there, the mask is too small or
        late. Only where it is farther is the target known to end.
        """
        none = np.zeros(rendered.depth_m.shape, dtype=np.bool_)
        found = none if self.always is None else self.always.copy()
        if self.masked_m is None:
            return found
        rows, columns = rendered.window
        part = tuple(
            slice(max(span.start - _ABOUT_PX, 0), span.stop + _ABOUT_PX) for span in (rows, columns)
        )
        shown = np.where(rendered.triangle[part] >= 0, rendered.depth_m[part], 0.0)
        left_out = np.where(self.masked_m[part] > 0.0, self.masked_m[part], np.inf)
        # What touches the target beside the view is what the mask tells it from.
        about = ndimage.maximum_filter(shown, _ABOUT_PX, mode="constant")
        before = (shown == 0.0) & (left_out < about - tolerance_m)
        # So it is within, as far as a view that is off by little reaches over it.
        missed = ndimage.binary_opening(
            left_out < shown + tolerance_m, np.ones((3, 3), dtype=np.bool_)
        )
        found[part] |= before | ((shown > 0.0) & missed)
        return found
