"""One update of the filter with one frame: expect a view, measure, update, and again if it moved.

`RectangleUpdater` measures rectangles in the segmented frame, `RefinedUpdater` compares the frame
with the rendered view. Both measure about the prediction first; the view is expected anew about
the updated pose until that moves no more, and the filter always updates from the prediction.
"""

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from pcnav.config.depth import Measurements
from pcnav.core.arrays import FloatArray
from pcnav.dynamics.state import NavigationState
from pcnav.estimators.depth.pose_fit import step_doubt
from pcnav.estimators.depth.pose_measurement import ObserverPose, pose_covariance, pose_error
from pcnav.estimators.depth.views import FrameView, view_of_comparison, view_of_rectangles
from pcnav.filtering.error_state import ErrorStateFilter, UpdateResult, innovation_gate
from pcnav.perception.reading import FrameReader, Trust
from pcnav.recordings.sequence import Frame

Kalman = ErrorStateFilter[NavigationState]

_MIN_EXPLAINED = 0.4
"""Share of a frame that a prediction must explain for the frame to be believed of it."""
_STILL_PX = 0.1
"""An update that moves no point of the target further than this is final."""
_SHARP_PX = 0.7
"""A prediction that is off by less than this settles which face a pixel shows."""
_CHECK_PROBABILITY = 0.9999
AGREES, CONTRADICTS = "check: agrees", "check: contradicts"
"""Outcomes of rectangles that RANSAC found, as a check on the track."""
_RECTANGLE_PASSES = 3
_REFINED_PASSES = 6


@dataclass(frozen=True)
class Updated:
    """A frame and what the filter made of it."""

    view: FrameView
    result: UpdateResult | None
    """None where the frame was not believed: the filter then stays as predicted."""

    @property
    def is_good(self) -> bool:
        """Whether any of the frame was used."""
        return self.result is not None and any(self.result.accepted)


class Updater(Protocol):
    """A way to update the filter with a frame."""

    def __init__(self, reader: FrameReader) -> None: ...

    def update(
        self,
        frame: Frame,
        kalman: Kalman,
        observer: ObserverPose,
        start: tuple[FloatArray, FloatArray] | None = None,
    ) -> Updated:
        """Update the filter, or leave it as predicted.

        ``start`` is a pose (4, 4) and its covariance (6, 6) to measure about first, where the frame
        itself says where the target is better than the prediction does.
        """


def pose_of(kalman: Kalman, observer: ObserverPose) -> FloatArray:
    """(4, 4) T_cam_model that the filter predicts."""
    return kalman.state.T_cam_model(observer.T_cam_world, observer.R_hill_world)


@dataclass(frozen=True)
class RefinedUpdater:
    """By comparison with the rendered view."""

    reader: FrameReader

    def update(
        self,
        frame: Frame,
        kalman: Kalman,
        observer: ObserverPose,
        start: tuple[FloatArray, FloatArray] | None = None,
    ) -> Updated:
        """See `Updater`.

        A prediction that is sharp by the filter's own covariance takes one pass: the errors of the
        comparison are then independent of those of the prediction.
        """
        prior = kalman.snapshot()
        pose, spread = start or (
            pose_of(kalman, observer),
            pose_covariance(kalman.state, kalman.covariance, observer),
        )
        for _ in range(_REFINED_PASSES):
            comparison = self.reader.compare(frame, pose, spread)
            lever_m = 0.5 * self.reader.diameter_m
            view = view_of_comparison(frame, comparison, lever_m, observer)
            result = kalman.update(view.measurements)
            if not any(result.accepted):
                break
            before, pose = pose, pose_of(kalman, observer)
            if self.reader.moved_px(before, pose, frame) < _STILL_PX:
                break
            spread = pose_covariance(kalman.state, kalman.covariance, observer)
            spread = spread + step_doubt(pose_error(before, pose))
            after = kalman.snapshot()
            kalman.restore(prior)
        else:
            kalman.restore(after)
        # A few returns can always be found where a wrong pose predicts a face.
        if not view.inlier_ratio >= _MIN_EXPLAINED:
            kalman.restore(prior)
            return Updated(view.without_faces("frame not explained"), None)
        return Updated(view, result)


@dataclass(frozen=True)
class RectangleUpdater:
    """By rectangles."""

    reader: FrameReader

    def update(
        self,
        frame: Frame,
        kalman: Kalman,
        observer: ObserverPose,
        start: tuple[FloatArray, FloatArray] | None = None,
    ) -> Updated:
        """See `Updater`."""
        reader, prior = self.reader, kalman.snapshot()
        if start is None:
            pose = pose_of(kalman, observer)
            spread = pose_covariance(kalman.state, kalman.covariance, observer)
        else:
            pose, spread = start
        view = reader.read(frame, pose, self._trust(pose, spread, frame))
        result = kalman.update(view_of_rectangles(view, observer).measurements)
        for _ in range(_RECTANGLE_PASSES - 1):
            before, pose = pose, pose_of(kalman, observer)
            moved_px = reader.moved_px(before, pose, frame)
            if moved_px < _STILL_PX or not reader.depends_on_pose:
                break
            if moved_px < _SHARP_PX:
                view = reader.read_again(view, pose)
            else:
                view = reader.read(frame, pose, Trust.PIXELS)
            kalman.restore(prior)
            result = kalman.update(view_of_rectangles(view, observer).measurements)
        seen = view_of_rectangles(view, observer)
        if view.inlier_ratio < _MIN_EXPLAINED:
            kalman.restore(prior)
            return Updated(seen.without_faces("frame not explained"), None)
        return Updated(seen, result)

    def _trust(self, pose: FloatArray, spread: FloatArray, frame: Frame) -> Trust:
        """How good a pose is, going by its covariance."""
        shift = float(np.sqrt(np.trace(spread[:3, :3])))
        turn = float(np.sqrt(np.trace(spread[3:, 3:])))
        off_px = self.reader.pixels(shift, turn, pose, frame)
        return Trust.PIXELS if off_px < _SHARP_PX else Trust.PLANES


@dataclass(frozen=True)
class CheckedUpdater:
    """By comparison; and rectangles of planes found by RANSAC say whether they agree with it."""

    reader: FrameReader

    def update(
        self,
        frame: Frame,
        kalman: Kalman,
        observer: ObserverPose,
        start: tuple[FloatArray, FloatArray] | None = None,
    ) -> Updated:
        """See `Updater`. The rectangles are recorded; the filter does not use the pixels twice."""
        updated = RefinedUpdater(self.reader).update(frame, kalman, observer, start)
        if not updated.is_good:
            return updated
        found = self.reader.read(frame, pose_of(kalman, observer), Trust.NONE)
        view = view_of_rectangles(found, observer)
        checks = []
        for measurement, record in zip(view.measurements, view.records, strict=True):
            squared, degrees = kalman.innovation(measurement)
            agrees = squared <= innovation_gate(_CHECK_PROBABILITY, degrees)
            checks.append(replace(record, outcome=AGREES if agrees else CONTRADICTS))
        unused = (*updated.view.unused, *checks, *view.unused)
        return replace(updated, view=replace(updated.view, unused=unused))


def updater_of(reader: FrameReader) -> Updater:
    """The way to update that the settings ask for."""
    ways: dict[Measurements, type[Updater]] = {
        Measurements.REFINED: RefinedUpdater,
        Measurements.RECTANGLES: RectangleUpdater,
        Measurements.BOTH: CheckedUpdater,
    }
    return ways[reader.measured_by](reader)
