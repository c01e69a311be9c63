"""How well a rendered view explains a frame, pixel by pixel."""

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from pcnav.core.arrays import DepthImage
from pcnav.target.rendering import RenderedDepth

_EMPTY_SHARE = 0.35
"""A pixel with fewer returns about it than this looks into space; lone gaps are dropouts."""
_ABOUT_PX = 5


@dataclass(frozen=True)
class Agreement:
    """Pixels that speak for and against a view."""

    agree: int
    """Returns at the predicted depth."""
    conflict: int
    """Returns at another depth or where space is predicted, and space where a surface is."""

    @property
    def inlier_ratio(self) -> float:
        """Share of them that speak for it, 0 to 1; nan when the frame is silent."""
        either = self.agree + self.conflict
        return self.agree / either if either else float("nan")


def agreement(depth_m: DepthImage, rendered: RenderedDepth, tolerance_m: float) -> Agreement:
    """Compare a frame with a view; depths that differ by less than the tolerance agree.

    Space counts as much as returns: a return seen through a predicted surface, and none where one
    is predicted, both say no. A gap between returns is a dropout and says nothing.
    """
    part = rendered.window
    returned = depth_m > 0.0
    seen, predicted = depth_m[part], rendered.depth_m[part]
    seen_here, surface = returned[part], rendered.triangle[part] >= 0
    close = np.abs(seen - predicted) < tolerance_m
    agree = int(np.count_nonzero(surface & seen_here & close))
    gaps = surface & ~seen_here
    empty = 0
    if gaps.any():
        about = ndimage.uniform_filter(seen_here.astype(np.float32), _ABOUT_PX, mode="constant")
        empty = int(np.count_nonzero(gaps & (about < _EMPTY_SHARE)))
    return Agreement(agree, int(np.count_nonzero(returned)) - agree + empty)
