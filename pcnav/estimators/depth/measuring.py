"""One update of the filter with one frame: predict a view, measure, update, and again if it moved.

Rectangles are measured in the segmented frame, or the frame is compared with the rendered view.
Both measure about the prediction first; the view is predicted
anew about the updated pose until that moves no more, and the filter always updates from the
prediction.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from pcnav.config.depth import Measurements
from pcnav.core.arrays import FloatArray
from pcnav.dynamics.state import NavigationState
from pcnav.estimators.depth.pose_fit import agreeing, step_doubt
from pcnav.estimators.depth.pose_measurement import (
    ObserverPose,
    PoseMeasurement,
    UncertainPose,
    pose_covariance,
    pose_error,
    seen_pose,
)
from pcnav.estimators.depth.views import FrameView, view_of_comparison, view_of_rectangles
from pcnav.filtering.error_state import (
    ErrorStateFilter,
    Snapshot,
    UpdateResult,
    innovation_gate,
)
from pcnav.perception.reading import FrameReader, Trust
from pcnav.perception.render_compare import Comparison
from pcnav.recordings.sequence import Frame

Kalman = ErrorStateFilter[NavigationState]
Prior = Snapshot[NavigationState]

_MIN_INLIER_RATIO = 0.4
"""Of the view at a prediction, as far as nothing stands before it, for the frame to be used."""
_STILL_PX = 0.1
"""An update that moves no point of the target further than this is final."""
_NEARLY_STILL_PX = 0.5
"""So is one by less than this as far as the coarse grid goes."""
_SHARP_PX = 0.7
"""A prediction that is off by less than this settles which face a pixel shows."""
_CHECK_PROBABILITY = 0.9999
AGREES, CONTRADICTS = "check: agrees", "check: contradicts"
"""Outcomes of rectangles that RANSAC found, as a check on the track."""
NOT_EXPLAINED = "frame not explained"
_RECTANGLE_PASSES = 3
_COMPARISON_PASSES = 6


@dataclass(frozen=True)
class Updated:
    """A frame and what the filter made of it."""

    view: FrameView
    result: UpdateResult | None
    """None where the frame was not used: the filter then stays as predicted."""
    explained: float = float("nan")
    """Share of the frame that speaks for the view, but for what stands before it; nan where nothing
    was rendered."""

    @property
    def is_good(self) -> bool:
        """Whether any of the frame was used."""
        return self.result is not None and any(self.result.accepted)

    @property
    def refused(self) -> "Updated":
        """The frame not used after all; the caller puts the filter back."""
        return Updated(self.view.without_faces(NOT_EXPLAINED), None, self.explained)


def pose_of(kalman: Kalman, observer: ObserverPose) -> FloatArray:
    """(4, 4) T_cam_model that the filter predicts."""
    return kalman.state.T_cam_model(observer.T_cam_world, observer.R_hill_world)


def predicted_pose(kalman: Kalman, observer: ObserverPose) -> UncertainPose:
    """It, with its covariance."""
    pose, covariance = (
        pose_of(kalman, observer),
        pose_covariance(kalman.state, kalman.covariance, observer),
    )
    if observer.noise.is_there:
        covariance = covariance + observer.noise.of_pose(pose)
    return pose, covariance


class _Pass(NamedTuple):
    """An update about a view."""

    is_fine: bool
    comparison: Comparison
    view: FrameView
    result: UpdateResult
    pose: FloatArray
    """(4, 4) after it."""
    after: Prior

    def weight(self) -> tuple[bool, int]:
        """Larger for what explains more, on all pixels first."""
        return self.is_fine, self.comparison.agreement.support


@dataclass(frozen=True)
class FrameUpdate:
    """An update of the filter with one frame, or a filter left as predicted."""

    reader: FrameReader
    frame: Frame
    kalman: Kalman
    observer: ObserverPose
    start: UncertainPose | None = None
    """A pose to measure about first, where the frame itself says where the target is better than
    the prediction does."""

    def by_comparison(self) -> Updated:
        """By comparison with the rendered view.

        A prediction that is sharp by the filter's own covariance takes one pass: the errors of the
        comparison are then independent of those of the prediction.
        """
        reader, frame, kalman, observer = self.reader, self.frame, self.kalman, self.observer
        prior, predicted = kalman.snapshot(), predicted_pose(kalman, observer)
        pose, spread = self.start or predicted
        coarse_is_done, passes = False, list[_Pass]()
        for _ in range(_COMPARISON_PASSES):
            fine = coarse_is_done or not reader.is_doubted(frame, pose, spread)
            comparison = reader.compare(frame, pose, spread, fine=fine)
            comparison = self._consistent(comparison, spread)
            view = view_of_comparison(frame, comparison, 0.5 * reader.diameter_m, observer)
            result = kalman.update(view.measurements, view.shared)
            if not any(result.accepted):
                break
            before, (pose, spread) = pose, self._pose_after(predicted, view, result)
            moved_px = reader.moved_px(before, pose, frame)
            # Short edges that alone tell of a direction show on no coarse grid. Among other things
            # an edge that may be so far off is rather another one.
            is_alone = comparison.seen.outline is None
            if moved_px < _STILL_PX and (fine or not is_alone):
                break
            coarse_is_done |= is_alone and moved_px < _NEARLY_STILL_PX
            spread = spread + step_doubt(pose_error(before, pose))
            passes.append(_Pass(fine, comparison, view, result, pose, kalman.snapshot()))
            kalman.restore(prior)
        else:
            # It goes to and fro between poses: the frame says which.
            likeliest = max(passes, key=_Pass.weight)
            _, comparison, view, result, pose, after = likeliest
            kalman.restore(after)
        if observer.noise.is_there:
            view = replace(view, T_cam_seen=pose)
        # A few returns can always be found where a wrong pose predicts a face.
        return self._supported(view, comparison.agreement.visible_ratio, result, prior)

    def _consistent(self, comparison: Comparison, spread: FloatArray) -> Comparison:
        """Without faces that the others contradict, where the gates of single faces are as wide as
        the noise of the camera's pose."""
        if not self.observer.noise.is_there or not comparison.faces:
            return comparison
        faces = agreeing(comparison.faces, spread, 0.5 * self.reader.diameter_m)
        return replace(comparison, faces=tuple(faces))

    def _pose_after(
        self, predicted: UncertainPose, view: FrameView, result: UpdateResult
    ) -> UncertainPose:
        """Where the target is in the camera, after an update that used some of the frame."""
        if not self.observer.noise.is_there:
            return predicted_pose(self.kalman, self.observer)
        used = [
            measurement
            for measurement, accepted in zip(view.measurements, result.accepted, strict=True)
            if accepted and isinstance(measurement, PoseMeasurement)
        ]
        return seen_pose(predicted, used)

    def by_rectangles(self) -> Updated:
        """By rectangles in the segmented frame."""
        reader, frame, kalman, observer = self.reader, self.frame, self.kalman, self.observer
        prior = kalman.snapshot()
        pose, spread = self.start or predicted_pose(kalman, observer)
        shift, turn = (float(np.sqrt(np.trace(part))) for part in (spread[:3, :3], spread[3:, 3:]))
        is_sharp = reader.pixels(shift, turn, pose, frame) < _SHARP_PX
        view = reader.read(frame, pose, Trust.PIXELS if is_sharp else Trust.PLANES)
        seen = view_of_rectangles(view, observer)
        result = kalman.update(seen.measurements, seen.shared)
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
            seen = view_of_rectangles(view, observer)
            result = kalman.update(seen.measurements, seen.shared)
        # In paper mode nothing was rendered, and the ratio is not known.
        ratio = 1.0 if np.isnan(view.inlier_ratio) else view.inlier_ratio
        return self._supported(seen, ratio, result, prior)

    def with_check(self) -> Updated:
        """By comparison; rectangles of planes found by RANSAC are recorded as a check.

        The filter does not use the pixels twice.
        """
        updated = self.by_comparison()
        if not updated.is_good:
            return updated
        found = self.reader.read(self.frame, pose_of(self.kalman, self.observer), Trust.NONE)
        view = view_of_rectangles(found, self.observer)
        checks = []
        for measurement, record in zip(view.measurements, view.records, strict=True):
            squared, degrees = self.kalman.innovation(measurement)
            agrees = squared <= innovation_gate(_CHECK_PROBABILITY, degrees)
            checks.append(replace(record, outcome=AGREES if agrees else CONTRADICTS))
        unused = (*updated.view.unused, *checks, *view.unused)
        return replace(updated, view=replace(updated.view, unused=unused))

    def _supported(
        self, view: FrameView, inlier_ratio: float, result: UpdateResult, prior: Prior
    ) -> Updated:
        """The update; or the prediction again, where the frame does not support it."""
        if inlier_ratio >= _MIN_INLIER_RATIO:
            return Updated(view, result, inlier_ratio)
        self.kalman.restore(prior)
        return Updated(view, result, inlier_ratio).refused


UPDATES: Mapping[Measurements, Callable[[FrameUpdate], Updated]] = {
    Measurements.REFINED: FrameUpdate.by_comparison,
    Measurements.RECTANGLES: FrameUpdate.by_rectangles,
    Measurements.BOTH: FrameUpdate.with_check,
}
"""The way to update that the settings ask for."""
