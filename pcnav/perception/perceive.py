"""Perception of one frame: returns -> planes -> segments -> rectangles -> catalogue entries."""

from dataclasses import dataclass, replace

import numpy as np

from pcnav.config.depth import PerceptionTable
from pcnav.core.arrays import FloatArray, IntArray
from pcnav.perception.planes import extract_planes, trial_count
from pcnav.perception.recognition import Recognition, recognise
from pcnav.perception.rectangles import RectangleObservation, observe_segment
from pcnav.perception.returns import Window, smoothed_points, smoothing_size, window_of_returns
from pcnav.perception.segmentation import PredictedSurface, Segment, Segmenter
from pcnav.recordings.sequence import Frame
from pcnav.target.satellite import Rectangle

_MAX_PLANE_FRACTION = 0.2
"""Share of the returns left that the next plane is counted on to hold: 1 - tau of Yu 2019 (2)."""


@dataclass(frozen=True)
class Seen:
    """One segment read as a rectangle and what it can be."""

    segment: Segment
    observation: RectangleObservation
    recognitions: tuple[Recognition, ...]
    """Catalogue entries of its size, best first; not asked for where a prediction tells faces."""


@dataclass(frozen=True)
class PerceivedFrame:
    """All that perception says of one frame, before any filter."""

    frame: Frame
    window: Window | None
    """None when nothing came back."""
    labels: IntArray
    """(height, width) of the window: which of `seen` each pixel belongs to, -1 for none."""
    seen: tuple[Seen, ...]
    """Largest segment first."""

    @property
    def image_labels(self) -> IntArray:
        """(height, width) of the whole image: as `labels`."""
        image = np.full(self.frame.depth_m.shape, -1, dtype=np.intp)
        if self.window is not None:
            image[self.window.part] = self.labels
        return image


def perceive(
    frame: Frame,
    catalogue: tuple[Rectangle, ...],
    settings: PerceptionTable,
    range_sigma_m: float,
    seed: int,
    expected: PredictedSurface | None = None,
) -> PerceivedFrame:
    """Planes, rectangles and their catalogue entries in a depth frame.

    The planes are found by RANSAC, unless a trusted prediction says what the image should show:
    its planes then start the fit. Deterministic for a seed. A frame without returns gives no
    rectangles; it is no error.
    """
    window = window_of_returns(frame)
    if window is None:
        return PerceivedFrame(frame, None, np.empty((0, 0), dtype=np.intp), ())
    least = settings.minimum_plane_points
    segmenter = Segmenter(window, range_sigma_m, least)
    if expected is None:
        planes = _found_planes(window, settings, range_sigma_m, seed + frame.index)
        segments, labels = segmenter.segments(planes)
    else:
        guided = replace(segmenter, expected=expected.part(window.part))
        segments, labels = guided.segments(expected.planes, rounds=1)
    seen = []
    for segment in segments:
        observation = observe_segment(frame.camera, window, segment, range_sigma_m, settings.mode)
        recognitions: tuple[Recognition, ...] = ()
        if expected is None:
            recognitions = recognise(observation, catalogue, settings.size_gate_sigma)
        seen.append(Seen(segment, observation, recognitions))
    return PerceivedFrame(frame, window, labels, tuple(seen))


def _found_planes(
    window: Window, settings: PerceptionTable, range_sigma_m: float, seed: int
) -> tuple[FloatArray, ...]:
    # Planes nearer to each other than the noise are only distinguished after averaging it.
    size = smoothing_size(window, range_sigma_m)
    trials = trial_count(1.0 - _MAX_PLANE_FRACTION, settings.ransac_success_probability)
    found = extract_planes(
        smoothed_points(window, size),
        settings.plane_threshold_sigma * range_sigma_m / size,
        trials,
        settings.minimum_plane_points,
        seed,
    )
    return tuple(m for m, _ in found)
