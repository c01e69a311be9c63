"""What the depth frames of a recording hold, in few numbers: facts that a failure is told by."""

from dataclasses import dataclass

import numpy as np

from pcnav.core.arrays import DepthImage, FloatArray, IntArray
from pcnav.core.camera import PinholeCamera, pixel_rays
from pcnav.recordings.sequence import Frame

_SAMPLE = 10_000
"""Pixels of a frame that suffice for where its returns lie."""
_MAX_MEASURED = 60
"""Frames whose returns are measured: more say nothing new of what stands before the camera."""
_PERCENT = (2.0, 98.0)
"""Of the returns, between which they lie."""


@dataclass(frozen=True)
class FrameSurvey:
    """What the frames of a recording hold."""

    n_returns: IntArray
    """(n,) returns in each frame."""
    near_m: float
    """Depth at which the returns begin, median over frames; nan without a return."""
    far_m: float
    """At which they end."""
    span_m: float
    """Between opposite corners of the box about them."""
    pixels_per_radian: float
    """Focal length of the first camera."""
    cut_share: float = 0.0
    """Share of the frames whose returns reach the border of the image."""

    @property
    def n_empty(self) -> int:
        """Frames without any return."""
        return int(np.count_nonzero(self.n_returns == 0))


class FrameSurveyor:
    """Takes in the frames of a recording as they pass."""

    def __init__(self) -> None:
        self._counts: list[int] = []
        self._extents: list[FloatArray] = []
        self._cut: list[bool] = []
        self._focal_px = float("nan")

    def add(self, frame: Frame) -> None:
        """Take in a frame."""
        if not self._counts:
            self._focal_px = max(frame.camera.fx, frame.camera.fy)
        count = int(np.count_nonzero(frame.depth_m))
        self._counts.append(count)
        if count and len(self._extents) < _MAX_MEASURED:
            self._extents.append(extent_of(frame.depth_m, frame.camera))
            depth = frame.depth_m
            self._cut.append(bool(any(side.any() for side in (*depth[[0, -1]], *depth.T[[0, -1]]))))

    def survey(self) -> FrameSurvey:
        """Of all frames so far."""
        unknown = [np.full(3, np.nan)]
        near_m, far_m, span_m = np.median(self._extents or unknown, axis=0).tolist()
        counts = np.array(self._counts, dtype=np.intp)
        cut_share = float(np.mean(self._cut)) if self._cut else 0.0
        return FrameSurvey(counts, near_m, far_m, span_m, self._focal_px, cut_share)


def extent_of(depth_m: DepthImage, camera: PinholeCamera) -> FloatArray:
    """(3,) where the returns of a depth image, m, begin and end along the depth, and their span."""
    seen = np.flatnonzero(depth_m)
    seen = seen[:: max(1, len(seen) // _SAMPLE)]
    depth = depth_m.reshape(-1)[seen].astype(np.float64)
    points = pixel_rays(camera).reshape(-1, 3)[seen] * depth[:, None]
    low, high = np.percentile(points, _PERCENT, axis=0)
    return np.array([low[2], high[2], np.linalg.norm(high - low)])
