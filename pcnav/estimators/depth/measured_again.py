"""The last frames of a track, measured anew when the noise has turned out to be another.

Frames taken in under a wrong noise are weighted wrongly for as long as a filter remembers them: an
arc that is fitted as one, for good.
"""

from collections import deque
from collections.abc import Sequence
from dataclasses import replace

from pcnav.core.arrays import FloatArray
from pcnav.estimators.depth.initial_arc import Timed, condensed
from pcnav.estimators.depth.pose_fit import agreeing
from pcnav.estimators.depth.pose_measurement import ObserverPose
from pcnav.estimators.depth.views import FrameView, view_of_comparison
from pcnav.filtering.map_arc_fit import TimedMeasurements
from pcnav.perception.reading import FrameReader
from pcnav.perception.sensor_noise import SensorNoise

_MAX_FRAMES = 12
_OTHER = 1.3
"""A deviation that differs by this factor is another one."""

Observed = tuple[FrameView, ObserverPose]


class RecentFrames:
    """The last frames of a track that were compared with a rendered view."""

    def __init__(self, reader: FrameReader, start: Sequence[Observed] = ()) -> None:
        """``start``: the frames that the track began with."""
        self._reader = reader
        self._frames: deque[Observed] = deque(maxlen=_MAX_FRAMES)
        for view, observer in start:
            self.add(view, observer)

    def add(self, view: FrameView, observer: ObserverPose) -> None:
        """Keep a frame that was just taken in, where it was compared."""
        if view.comparison is not None:
            self._frames.append((view, observer))

    @property
    def count(self) -> int:
        """How many are kept."""
        return len(self._frames)

    @property
    def are_outdated(self) -> bool:
        """Whether any was measured under a noise that differs clearly from what is known now."""
        return any(is_outdated(view, self._reader.noise) for view, _ in self._frames)

    @property
    def compared(self) -> tuple[list[FrameView], list[FloatArray]]:
        """The frames, and the poses (4, 4) that they were compared with."""
        views = [view for view, _ in self._frames]
        return views, [view.comparison.T_cam_model for view in views if view.comparison is not None]

    def measured_again(self) -> list[Timed]:
        """All of them under the noise as it is known now, as `condensed` has them."""
        again = [(measured_again(self._reader, *each), each[1]) for each in self._frames]
        # In their place: an arc that is shorter than what is kept would hold its frames twice.
        self._frames = deque(again, maxlen=_MAX_FRAMES)
        return [
            condensed(TimedMeasurements(view.frame.time_s, view.measurements)) for view, _ in again
        ]


def is_outdated(view: FrameView, noise: SensorNoise) -> bool:
    """Whether a frame was measured under a noise that differs clearly from this one."""
    assert view.comparison is not None, "only these are kept"
    before = view.comparison.seen.sensor_noise
    pairs = (
        (before.sigma_m, noise.sigma_m),
        (before.frame_sd_m, noise.frame_sd_m),
        (before.face_sd_m, noise.face_sd_m),
        (before.face_tilt_sd_m, noise.face_tilt_sd_m),
        (before.outline_sd_px, noise.outline_sd_px),
    )
    return any(a > _OTHER * b or b > _OTHER * a for a, b in pairs)


def measured_again(reader: FrameReader, view: FrameView, observer: ObserverPose) -> FrameView:
    """A compared frame about the same pose, by the faces that agree under the noise known now."""
    assert view.comparison is not None, "it was compared"
    pose, spread = view.comparison.T_cam_model, view.comparison.seen.doubt.covariance
    reader.expect_motion(view.comparison.motion)
    comparison = reader.compare(view.frame, pose, spread)
    lever_m = 0.5 * reader.diameter_m
    faces = tuple(agreeing(comparison.faces, spread, lever_m)) if comparison.faces else ()
    return view_of_comparison(view.frame, replace(comparison, faces=faces), lever_m, observer)
