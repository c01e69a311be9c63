"""The tracker: acquires a target, follows it frame by frame, says what its estimate is worth."""

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from pcnav.config.depth import FilterTable, Measurements, PerceptionTable
from pcnav.dynamics.blocks import MASS_CENTRE_LAYOUT
from pcnav.dynamics.mass_prior import PriorMass
from pcnav.dynamics.state import ratio_covariance
from pcnav.estimators.depth.acquisition import (
    Acquisition,
    InitialArc,
    Initialised,
    filter_from,
)
from pcnav.estimators.depth.evidence import Evidence
from pcnav.estimators.depth.lock_monitor import LockCheck, LockMonitor
from pcnav.estimators.depth.mass import MassBelief, learnt_belief, prior_belief
from pcnav.estimators.depth.mass_centre import MassCentreModel
from pcnav.estimators.depth.measuring import (
    UPDATES,
    FrameUpdate,
    Kalman,
    Updated,
    pose_of,
    predicted_pose,
)
from pcnav.estimators.depth.motion_hypotheses import MIN_FRAMES
from pcnav.estimators.depth.pose_fit import SingleFramePose
from pcnav.estimators.depth.pose_measurement import ObserverPose, pose_error
from pcnav.estimators.depth.views import FrameView, silent_view
from pcnav.estimators.interface import Estimator
from pcnav.filtering.error_state import UpdateResult, innovation_gate
from pcnav.filtering.map_arc_fit import TimedMeasurements
from pcnav.perception.reading import FrameReader
from pcnav.recordings.frame_guard import FrameGuard
from pcnav.recordings.sequence import Frame, SequenceInfo, stated_or_default_sigma
from pcnav.runs.estimate import Estimate, Output
from pcnav.runs.status import Status
from pcnav.target.satellite import Target
from pcnav.target.symmetry import group_name

_log = logging.getLogger("pcnav")

_MAX_BLIND_FRAMES = 10
"""Frames with returns but without an accepted measurement before the track is given up."""
_MIN_RETURNS = 40
"""Fewer returns than this are specks."""
_MIN_INLIER_RATIO = 0.5
"""Of a pose found without the track, for it to be accepted."""


@dataclass
class _Track:
    """A target being followed."""

    kalman: Kalman
    arc: InitialArc | None
    time_s: float
    lock_monitor: LockMonitor
    evidence: Evidence
    symmetric: bool
    """Whether the target's own symmetry leaves equivalent attitudes."""
    open_question: bool
    """Whether another motion, no equivalent one, explains the frames as well."""
    blind_frames: int = 0
    was_wrong: bool = False

    @property
    def status(self) -> Status:
        """What it is worth after a frame that was used."""
        ambiguous = self.symmetric or self.open_question
        return Status.AMBIGUOUS if ambiguous else Status.LOCKED


class Tracker(Estimator):
    """Follows one target through a sequence: acquires it, then filters frame by frame.

    Nothing but the target, the pipeline's settings and the frames enters an estimate.
    """

    output = Output(MASS_CENTRE_LAYOUT, notes=("inlier_ratio", "n_rectangles"), has_records=True)
    min_frames = MIN_FRAMES

    def __init__(
        self,
        target: Target,
        info: SequenceInfo,
        perception: PerceptionTable,
        filtering: FilterTable,
        seed: int,
    ) -> None:
        self._target, self._info, self._filtering = target, info, filtering
        sigma_m = stated_or_default_sigma(info, perception.range_sigma_m)
        self._reader = FrameReader(target, perception, sigma_m, seed)
        self._refined = perception.measured_by is not Measurements.RECTANGLES
        self._update = UPDATES[perception.measured_by]
        self._model = MassCentreModel(
            info.mean_motion_rad_s,
            filtering.acceleration_psd_m2_s3,
            filtering.angular_acceleration_psd_rad2_s3,
        )
        self._belief = prior_belief(target, info.initial, filtering)
        self._status = Status.ACQUIRING
        self._track: _Track | None = None
        self._acquisition = self._new_acquisition(self._belief)
        self._best_view: tuple[Estimate, FrameView] | None = None
        self._has_tracked = False
        self._guard = FrameGuard(target.diameter_m)

    @property
    def best_view(self) -> tuple[Estimate, FrameView] | None:
        """The frame with most rectangles used; the later one of equals, being better estimated."""
        return self._best_view

    @property
    def prior(self) -> PriorMass | None:
        """Prior of the mass before the first frame; None until there is a track."""
        return self._belief.prior if self._has_tracked else None

    def step(self, frame: Frame, /) -> Estimate:
        """Take in one frame.

        Raises `InputError` when target and frame differ in units, and for a frame that is no later
        than the one before.
        """
        self._guard.check(frame)
        observer = ObserverPose.of(frame.T_cam_world, frame.time_s, self._info.mean_motion_rad_s)
        if self._track is None:
            estimate, view = self._acquire(frame, observer)
        else:
            estimate, view = self._follow(frame, observer, self._track)
        if estimate.status != self._status:
            self._log_status(frame, estimate, view.inlier_ratio)
            self._status = Status(estimate.status)
        best = self._best_view
        if best is None or _rectangles_used(estimate) >= _rectangles_used(best[0]):
            self._best_view = estimate, view
        return estimate

    def _log_status(self, frame: Frame, estimate: Estimate, inlier_ratio: float) -> None:
        group = ""
        if estimate.status == Status.AMBIGUOUS:
            group = f", symmetry group {group_name(self._target.symmetry_transforms)}"
        _log.info(
            "frame %d: %s -> %s%s (inlier ratio %.0f %%, NIS per degree of freedom %.2f)",
            frame.index,
            self._status,
            estimate.status,
            group,
            100.0 * inlier_ratio,
            estimate.window_nis,
        )

    # Acquiring.

    def _new_acquisition(self, belief: MassBelief) -> Acquisition:
        return Acquisition(
            *(self._target, self._reader, self._model, self._filtering, belief),
            refined=self._refined,
        )

    def _acquire(self, frame: Frame, observer: ObserverPose) -> tuple[Estimate, FrameView]:
        outcome = self._acquisition.add(frame, observer)
        if not isinstance(outcome, Initialised):
            return self._estimate(outcome, None, Status.ACQUIRING, observer), outcome
        track = _Track(
            outcome.kalman,
            outcome.arc,
            frame.time_s,
            LockMonitor(self._target, self._reader),
            Evidence(),
            symmetric=len(self._target.symmetry_transforms) > 1,
            open_question=outcome.undecided,
        )
        self._track, self._has_tracked = track, True
        return self._estimate(outcome.view, None, track.status, observer), outcome.view

    # Following.

    def _follow(
        self, frame: Frame, observer: ObserverPose, track: _Track
    ) -> tuple[Estimate, FrameView]:
        kalman = track.kalman
        kalman.predict(self._model, track.time_s, frame.time_s - track.time_s)
        track.time_s = frame.time_s
        if np.count_nonzero(frame.depth_m) < _MIN_RETURNS:
            view = silent_view(frame)
            return self._estimate(view, None, Status.COASTING, observer), view
        updated = self._update(FrameUpdate(self._reader, frame, kalman, observer))
        status = Status.COASTING
        if updated.is_good:
            status = self._go_on(frame, observer, track, updated)
        else:
            updated, status = self._search(frame, observer, track, updated)
        estimate = self._estimate(updated.view, updated.result, status, observer)
        if status is Status.LOST:
            self._lose(track)
        return estimate, updated.view

    def _go_on(
        self, frame: Frame, observer: ObserverPose, track: _Track, updated: Updated
    ) -> Status:
        """Take in what a good update says of the track, and say what it is worth now."""
        self._take_in(track, updated)
        monitor = track.lock_monitor
        if monitor.is_due(track.evidence, is_open=track.open_question):
            perceived, found = monitor.detect(frame)
            outcome = monitor.check(perceived, found, pose_of(track.kalman, observer))
            track.open_question = outcome is not LockCheck.CONFIRMED
            if outcome is LockCheck.REJECTED:
                track.was_wrong = True
                return Status.LOST
        return track.status

    def _search(
        self, frame: Frame, observer: ObserverPose, track: _Track, updated: Updated
    ) -> tuple[Updated, Status]:
        """Look for the target where the prediction explains nothing, though there are returns."""
        monitor = track.lock_monitor
        perceived, found = monitor.detect(frame)
        again = self._found_again(frame, observer, track.kalman, found)
        if again is not None:
            self._take_in(track, again)
            return again, track.status
        track.blind_frames += 1
        outcome = monitor.check(perceived, found, pose_of(track.kalman, observer))
        gave_up = outcome is LockCheck.REJECTED or track.blind_frames > _MAX_BLIND_FRAMES
        return updated, Status.LOST if gave_up else Status.COASTING

    def _take_in(self, track: _Track, updated: Updated) -> None:
        assert updated.result is not None, "the update was good"
        track.blind_frames = 0
        track.evidence.add(updated.view.inlier_ratio, updated.result)
        self._extend_arc(track, updated.view, updated.result)

    def _extend_arc(self, track: _Track, view: FrameView, result: UpdateResult) -> None:
        """Keep the measurements of the initial arc, and go on from each fit of them all."""
        if track.arc is None:
            return
        passed = tuple(m for m, ok in zip(view.measurements, result.accepted, strict=True) if ok)
        fit = track.arc.extend(TimedMeasurements(view.frame.time_s, passed))
        if fit is not None:
            track.kalman = filter_from(fit, self._filtering)
        if track.arc.is_over:
            track.arc = None

    def _found_again(
        self, frame: Frame, observer: ObserverPose, kalman: Kalman, found: Sequence[SingleFramePose]
    ) -> Updated | None:
        """An update from where the target is found without the track, if the prediction allows it.

        After a gap the prediction may be off by more than a comparison with its view can bridge.
        """
        predicted, spread = predicted_pose(kalman, observer)
        allowed = []
        for pose in found:
            error = pose_error(predicted, pose.T_cam_model)
            squared = float(error @ np.linalg.solve(spread + pose.covariance, error))
            gate = innovation_gate(self._filtering.gate_probability, len(error))
            if pose.inlier_ratio >= _MIN_INLIER_RATIO and squared < gate:
                allowed.append((squared, pose))
        if not allowed:
            return None
        best = min(allowed, key=lambda pair: pair[0])[1]
        start = (best.T_cam_model, best.covariance)
        updated = self._update(FrameUpdate(self._reader, frame, kalman, observer, start))
        return updated if updated.is_good else None

    def _lose(self, track: _Track) -> None:
        """Start again; what was learnt of the mass stays if the track was right until it was lost.

        A symmetric target may be found in another of its equivalent attitudes, where what was
        learnt would be turned; and a wrong track has learnt nothing.
        """
        was_right = not (track.was_wrong or track.open_question or track.evidence.is_doubtful)
        belief = self._belief
        if was_right and not track.symmetric and track.arc is None:
            belief = learnt_belief(track.kalman.state, track.kalman.covariance)
        self._track = None
        self._acquisition = self._new_acquisition(belief)

    # Results.

    def _estimate(
        self, view: FrameView, result: UpdateResult | None, status: Status, observer: ObserverPose
    ) -> Estimate:
        track, frame = self._track, view.frame
        accepted = (True,) * len(view.measurements) if result is None else result.accepted
        estimate = Estimate(
            time_s=frame.time_s,
            status=str(status),
            nis=float("nan") if result is None else result.joint_nis,
            nis_dof=0 if result is None else result.joint_dof,
            window_nis=float("nan") if track is None else track.evidence.window_nis,
            notes={
                "inlier_ratio": view.inlier_ratio,
                "n_rectangles": sum(accepted[face] for face in view.face_of_record),
            },
            records=view.outcomes(accepted),
        )
        if track is None:
            return estimate
        kalman = track.kalman
        return replace(
            estimate,
            values=kalman.state.values,
            covariance=ratio_covariance(kalman.state, kalman.covariance),
            T_cam_target=pose_of(kalman, observer),
        )


def _rectangles_used(estimate: Estimate) -> int:
    return int(estimate.notes["n_rectangles"] or 0)
