"""The tracker: acquires a target, follows it frame by frame, says what its estimate is worth."""

import copy
import logging
from collections import deque
from collections.abc import Mapping
from dataclasses import replace
from functools import partial

import numpy as np

from pcnav.config.depth import FilterTable, Measurements, PerceptionTable
from pcnav.core.arrays import FloatArray
from pcnav.dynamics.blocks import MASS_CENTRE_LAYOUT
from pcnav.dynamics.mass_prior import MassBelief, PriorMass
from pcnav.dynamics.state import NavigationState, ratio_covariance
from pcnav.estimators.depth.acquisition import Acquisition, Initialised
from pcnav.estimators.depth.answers import (
    answer_of_frame,
    is_known,
    rectangles_used,
    usual_at_start,
)
from pcnav.estimators.depth.astray import Astray
from pcnav.estimators.depth.calibration_errors import SeenBy
from pcnav.estimators.depth.camera_noise import CameraNoise
from pcnav.estimators.depth.doubts import FrameDoubts
from pcnav.estimators.depth.evidence import Evidence
from pcnav.estimators.depth.following import FollowedMotion
from pcnav.estimators.depth.lasting_errors import LastingErrors
from pcnav.estimators.depth.lock_monitor import LockCheck, LockMonitor
from pcnav.estimators.depth.mass import prior_belief
from pcnav.estimators.depth.mass_centre import MassCentreModel
from pcnav.estimators.depth.measured_again import RecentFrames
from pcnav.estimators.depth.measuring import (
    UPDATES,
    FrameUpdate,
    Updated,
    pose_of,
)
from pcnav.estimators.depth.motion_hypotheses import MIN_FRAMES
from pcnav.estimators.depth.motion_within import TimedPose, motion_about, predicted_motion
from pcnav.estimators.depth.noise_learning import NoiseLearner
from pcnav.estimators.depth.part_learning import PartLearner
from pcnav.estimators.depth.pose_measurement import ObserverPose
from pcnav.estimators.depth.recovering import Recovery
from pcnav.estimators.depth.repeats import Repeats
from pcnav.estimators.depth.scale_learning import ScaleLearner
from pcnav.estimators.depth.target_odds import TrackOdds
from pcnav.estimators.depth.track import Track
from pcnav.estimators.depth.views import FrameView, silent_view
from pcnav.estimators.interface import Estimator
from pcnav.filtering.error_state import UpdateResult
from pcnav.perception.reading import FrameReader
from pcnav.perception.sensor_noise import SensorNoise
from pcnav.perception.view_hypotheses import SearchReport
from pcnav.recordings.frame_guard import FrameGuard
from pcnav.recordings.sequence import (
    FirstPosePrior,
    Frame,
    SequenceInfo,
    stated_or_default_sigma,
)
from pcnav.runs.doubts import COLUMN, RIM_COLUMN, TILT_COLUMN
from pcnav.runs.estimate import Estimate, Output
from pcnav.runs.status import Status
from pcnav.target.row_motion import Exposure
from pcnav.target.satellite import Target

_log = logging.getLogger("pcnav")

_MAX_BLIND_FRAMES = 10
"""Frames with returns but without an accepted measurement before the track is given up."""
_MAX_REFUTED_FRAMES = 10
"""Frames on which it is clearly something else that is followed, before that is given up."""
_MIN_RETURNS = 40
"""Fewer returns than this are specks."""


class Tracker(Estimator):
    """Follows one target through a sequence: acquires it, then filters frame by frame.

    Nothing but the target, the pipeline's settings and the frames enters an estimate.
    """

    output = Output(
        MASS_CENTRE_LAYOUT,
        notes=("inlier_ratio", "n_rectangles", "motion", COLUMN, TILT_COLUMN, RIM_COLUMN),
        has_records=True,
    )
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
        noise = SensorNoise.before_any_frame(sigma_m)
        self._reader = FrameReader(target, perception, noise, seed)
        self._noise = NoiseLearner(self._reader, perception.range_sigma_m or info.range_sigma_m)
        self._reader.row_readout_s = info.row_readout_s
        self._reader.frames_take_time = info.takes_time
        self._scale = ScaleLearner(self._reader, perception.mesh_scale_sd, info.calibration)
        self._parts = PartLearner(target, self._reader)
        self._seen_poses: deque[TimedPose] = deque(maxlen=3)
        self._camera: TimedPose | None = None
        self._refined = perception.measured_by is not Measurements.RECTANGLES
        self._update = UPDATES[perception.measured_by]
        self._model = MassCentreModel(
            info.mean_motion_rad_s,
            filtering.acceleration_psd_m2_s3,
            filtering.angular_acceleration_psd_rad2_s3,
        )
        self._belief = prior_belief(target, info.initial, filtering)
        self._status = Status.ACQUIRING
        self._track: Track | None = None
        self._given = self._belief
        self._acquisition = self._new_acquisition(self._belief, info.first_pose)
        self._remarks: list[str] = []
        self._best_view: tuple[Estimate, FrameView] | None = None
        self._has_tracked = False
        self._last_claim: tuple[NavigationState, Mapping[str, FloatArray]] | None = None
        self._guard, self._repeats = FrameGuard(target.diameter_m), Repeats()

    @property
    def best_view(self) -> tuple[Estimate, FrameView] | None:
        """The frame with most rectangles used; the later one of equals, being better estimated."""
        return self._best_view

    @property
    def sensor_noise(self) -> SensorNoise:
        """Noise of the sensor, as far as it is known now."""
        return self._noise.noise

    @property
    def mesh_scale(self) -> float:
        """By which the target is taken to be larger than its mesh."""
        return self._scale.factor

    def exposure(self, frame: Frame, T_cam_model: FloatArray) -> Exposure | None:
        """See `Estimator.exposure`."""
        return self._reader.exposure(frame, T_cam_model)

    @property
    def changed_parts(self) -> tuple[str, ...]:
        """Names of the parts that are not as in the mesh: no pose is measured by them."""
        return self._parts.found

    @property
    def search_report(self) -> SearchReport | None:
        """Of the search since the start, or since the last loss, that found most."""
        return self._acquisition.report

    @property
    def remarks(self) -> tuple[str, ...]:
        """What it said while it ran: that the frames contradict what was stated of the mass, or of
        the calibration."""
        doubt = self._scale.doubt
        against = (doubt.said,) if doubt is not None and doubt.is_clear else ()
        return (*self._remarks, *against)

    @property
    def budget(self) -> Mapping[str, FloatArray]:
        """See `Estimator.budget`."""
        if self._last_claim is None:
            return {}
        state, parts = self._last_claim
        return {name: ratio_covariance(state, part) for name, part in parts.items()}

    @property
    def prior(self) -> PriorMass | None:
        """Prior of the mass before the first frame, widened where the frames contradict it; None
        until there is a track."""
        return self._belief.prior if self._has_tracked else None

    def step(self, frame: Frame, /) -> Estimate:
        """Take in one frame.

        Raises `InputError` when target and frame differ in units, and for a frame that is no later
        than the one before.
        """
        self._guard.check(frame)
        self._noise.begin(frame)
        observer = self._observer(frame)
        if self._repeats.is_one(frame):
            return self._shown_again(frame, observer)
        if self._track is None:
            estimate, view = self._acquire(frame, observer)
            # What can be no matter of units ended above.
            self._guard.doubt_units(frame)
        else:
            estimate, view = self._follow(frame, observer, self._track)
        self._remember(estimate)
        self._camera = frame.time_s, frame.T_cam_world
        if estimate.status != self._status:
            self._log_status(frame, estimate, view.inlier_ratio)
            self._status = Status(estimate.status)
        best = self._best_view
        if best is None or rectangles_used(estimate) >= rectangles_used(best[0]):
            self._best_view = estimate, view
        return estimate

    def forecast(self, frame: Frame, /) -> Estimate:
        """See `Estimator.forecast`."""
        view, observer, track = silent_view(frame), self._observer(frame), self._track
        if track is None:
            return self._estimate(view, None, Status.ACQUIRING, observer)
        # Both follow one filter.
        motion, lasting = copy.deepcopy((track.motion, track.lasting))
        motion.predict(frame.time_s)
        lasting.predict(motion.kalman)
        astray = track.astray.predicted(motion.kalman.transition)
        self._track = replace(track, motion=motion, lasting=lasting, astray=astray)
        try:
            status = Status.LOST if motion.is_lost else Status.COASTING
            return self._estimate(view, None, status, observer)
        finally:
            self._track = track

    def _shown_again(self, frame: Frame, observer: ObserverPose) -> Estimate:
        """A frame that brings the image of the one before: nothing is measured.

        A free body is where its motion leads. Of any other the frame's own pose is the better one.
        """
        view, track = silent_view(frame), self._track
        if track is None:
            return self._estimate(view, None, Status.ACQUIRING, observer)
        track.motion.predict(frame.time_s)
        if track.motion.is_torque_free or not self._seen_poses:
            return self._estimate(view, None, self._status, observer)
        estimate = self._estimate(view, None, Status.COASTING, observer)
        shown = self._seen_poses[-1][1]
        return replace(estimate, status=str(self._status), T_cam_target=shown)

    def _remember(self, estimate: Estimate) -> None:
        if estimate.T_cam_target is None:
            self._seen_poses.clear()
        else:
            self._seen_poses.append((estimate.time_s, estimate.T_cam_target))

    def _expect_motion(self, frame: Frame, observer: ObserverPose, track: Track) -> None:
        """Tell the reader how the target moves in the camera, where it matters."""
        known, info = list(self._seen_poses), self._info
        if observer.noise.is_there and len(known) > 1:
            # A noisy camera pose would be taken for a jolt: the last frames tell more.
            self._reader.expect_motion(motion_about(known, len(known) - 1))
            return
        half_s = self._reader.half_duration(frame)
        if half_s == 0.0:
            self._reader.expect_motion(None)
            return
        at = track.motion.kalman.state, track.motion.time_s, track.motion.model
        motion = predicted_motion(*at, observer, self._camera, half_s, info.mean_motion_rad_s)
        self._reader.expect_motion(motion)

    def _observer(self, frame: Frame) -> ObserverPose:
        info = self._info
        noise = CameraNoise(info.camera_position_sd_m, info.camera_attitude_sd_rad)
        return ObserverPose.of(frame.T_cam_world, frame.time_s, info.mean_motion_rad_s, noise)

    def _log_status(self, frame: Frame, estimate: Estimate, inlier_ratio: float) -> None:
        group = ""
        if estimate.status == Status.AMBIGUOUS:
            group = f", symmetry group {self._target.symmetry_name}"
        known = []
        if np.isfinite(inlier_ratio):
            known.append(f"inlier ratio {inlier_ratio:.0%}")
        if estimate.window_nis is not None and np.isfinite(estimate.window_nis):
            known.append(f"NIS per degree of freedom {estimate.window_nis:.2f}")
        why = f" ({', '.join(known)})" if known else ""
        _log.info("frame %d: %s -> %s%s%s", frame.index, self._status, estimate.status, group, why)

    # Acquiring.

    def _new_acquisition(
        self, belief: MassBelief, first_pose: FirstPosePrior | None = None
    ) -> Acquisition:
        return Acquisition(
            *(self._target, self._reader, self._model, self._filtering, belief),
            noise=self._noise,
            refined=self._refined,
            first_pose=first_pose,
        )

    def _acquire(self, frame: Frame, observer: ObserverPose) -> tuple[Estimate, FrameView]:
        outcome = self._acquisition.add(frame, observer)
        if not isinstance(outcome, Initialised):
            return self._estimate(outcome, None, Status.ACQUIRING, observer), outcome
        track = Track(
            outcome.motion,
            LockMonitor(self._target, self._reader),
            Evidence(usual_at_start(outcome, frame)),
            RecentFrames(self._reader, outcome.start),
            LastingErrors(len(outcome.start)),
            symmetric=self._target.is_symmetric,
            open_question=outcome.undecided,
            odds=TrackOdds(outcome.odds),
        )
        self._track, self._has_tracked = track, True
        self._heed(track.motion)
        if outcome.view.comparison is not None:
            all_of_it = (True,) * len(outcome.view.comparison.faces)
            self._consider(track, observer, outcome.view, all_of_it)
        return self._estimate(outcome.view, None, track.status, observer), outcome.view

    # Following.

    def _follow(
        self, frame: Frame, observer: ObserverPose, track: Track
    ) -> tuple[Estimate, FrameView]:
        step_s = frame.time_s - track.motion.time_s
        track.motion.predict(frame.time_s)
        track.lasting.predict(track.motion.kalman)
        track.astray = track.astray.predicted(track.motion.kalman.transition)
        if track.motion.is_lost:
            view = silent_view(frame)
            estimate = self._estimate(view, None, Status.LOST, observer)
            self._lose(track)
            return estimate, view
        if np.count_nonzero(frame.depth_m) < _MIN_RETURNS:
            view = silent_view(frame)
            return self._estimate(view, None, Status.COASTING, observer), view
        if self._info.takes_time:
            self._expect_motion(frame, observer, track)
        recovery = self._recovery(frame, observer, track)
        kalman, start = track.motion.kalman, recovery.start(track.motion)
        predicted = kalman.snapshot()
        updated = self._update(FrameUpdate(self._reader, frame, kalman, observer, start))
        if track.is_single:
            updated = recovery.without_rate(kalman, updated, predicted)
        updated = self._overruled(recovery, track, updated)
        if updated.is_good:
            status = self._go_on(frame, observer, track, updated)
            if status is not Status.LOST and updated.result is not None:
                self._learn(track, observer, updated.view, updated.result)
        else:
            updated, status = self._search(recovery, track, updated)
            if not updated.is_good:
                self._go_astray(track, updated.view, step_s)
        estimate = self._estimate(updated.view, updated.result, status, observer)
        if status is Status.LOST:
            self._lose(track)
        return estimate, updated.view

    def _learn(
        self, track: Track, observer: ObserverPose, view: FrameView, result: UpdateResult
    ) -> None:
        """Learn of the sensor's noise and of the target from a frame that was taken in."""
        if view.comparison is not None:
            self._consider(track, observer, view, result.accepted)
        pose = pose_of(track.motion.kalman, observer)
        self._noise.learn(view, result.accepted, pose)
        track.recent.add(view, observer)
        is_other = self._scale.learn(view, result.accepted)
        judges = self._refined and not track.open_question
        if judges and self._parts.learn(view, pose, self._scale.factor):
            # What did not fit was taken for noise.
            self._noise.start_again()
            track.recent.measured_again()
            self._noise.learn_start(*track.recent.compared, again=False)
            is_other = True
        if is_other or track.recent.are_outdated:
            track.motion.take_in_again(track.recent.measured_again())

    def _consider(
        self, track: Track, observer: ObserverPose, view: FrameView, used: tuple[bool, ...]
    ) -> None:
        """Follow what lasting errors make of a frame that was taken in."""
        assert view.comparison is not None, "it was compared"
        seen = SeenBy(view.frame.camera, self._scale.calibration, view.comparison, used)
        track.lasting.take_in(track.motion.kalman, observer, seen, self._noise.noise)

    def _go_on(
        self, frame: Frame, observer: ObserverPose, track: Track, updated: Updated
    ) -> Status:
        """Take in what a good update says of the track, and say what it is worth now."""
        self._take_in(frame, track, updated)
        if track.refuted_frames > _MAX_REFUTED_FRAMES:
            track.was_wrong = True
            return Status.LOST
        monitor = track.lock_monitor
        if monitor.is_due(track.evidence, is_open=track.open_question):
            perceived, found = monitor.detect(frame)
            outcome = monitor.check(perceived, found, pose_of(track.motion.kalman, observer))
            track.open_question = outcome is not LockCheck.CONFIRMED
            if outcome is LockCheck.REJECTED:
                track.was_wrong = True
                return Status.LOST
        return track.status

    def _overruled(self, recovery: Recovery, track: Track, updated: Updated) -> Updated:
        """The update about where any motion may have led, if that explains the frame better."""
        motion, result = track.motion, updated.result
        if motion.is_torque_free:
            strained = result is not None and track.evidence.is_strained(result)
            again = recovery.near(motion) if updated.is_good and strained else None
            if again is not None:
                motion.go_over()
                self._log_motion(recovery.frame, track, "it leads past this frame")
            return again or updated
        return recovery.overruled(motion, updated)

    def _search(self, recovery: Recovery, track: Track, updated: Updated) -> tuple[Updated, Status]:
        """Look for the target where the prediction explains nothing, though there are returns."""
        monitor, motion, frame = track.lock_monitor, track.motion, recovery.frame
        perceived, found = monitor.detect(frame)
        again = recovery.found(motion, found)
        if again is None:
            lead = partial(monitor.lead_of, perceived, found)
            again = recovery.jolted(motion, lead) if motion.is_torque_free else None
            if again is None:
                again = recovery.found_far(motion, found, lead)
            if again is not None and motion.is_torque_free:
                motion.go_over()
                self._log_motion(frame, track, "it does not lead to this frame")
        if again is not None:
            self._take_in(frame, track, again)
            return again, track.status
        track.blind_frames += 1
        outcome = monitor.check(perceived, found, pose_of(motion.kalman, recovery.observer))
        gave_up = outcome is LockCheck.REJECTED or track.blind_frames > _MAX_BLIND_FRAMES
        return updated, Status.LOST if gave_up else Status.COASTING

    def _go_astray(self, track: Track, view: FrameView, step_s: float) -> None:
        """Take in that the target is not where its motion leads."""
        agreement = None if view.comparison is None else view.comparison.agreement
        mean_motion = self._info.mean_motion_rad_s
        track.astray = track.astray.after(agreement, mean_motion, step_s, self._target.diameter_m)

    def _recovery(self, frame: Frame, observer: ObserverPose, track: Track) -> Recovery:
        gate = self._filtering.gate_probability
        return Recovery(self._reader, frame, observer, self._update, gate, track.evidence)

    def _take_in(self, frame: Frame, track: Track, updated: Updated) -> None:
        assert updated.result is not None, "the update was good"
        track.blind_frames, track.astray = 0, Astray()
        track.evidence.add(updated.view.inlier_ratio, updated.result)
        comparison = updated.view.comparison
        if comparison is not None:
            track.odds.add(comparison.T_cam_model, comparison.agreement)
        track.refuted_frames = track.refuted_frames + 1 if track.odds.is_refuted else 0
        why = track.motion.take_in(updated.view.measurements, updated.result.accepted)
        if why is not None:
            self._log_motion(frame, track, why)
        self._heed(track.motion)

    def _heed(self, motion: FollowedMotion) -> None:
        """Believe as little of the mass as the motion does."""
        said = motion.contradicted
        if said is None or said in self._remarks:
            return
        self._remarks.append(said)
        # What was learnt before a loss is no prior of the target.
        if self._given is self._belief:
            self._given = self._belief = motion.prior

    def _log_motion(self, frame: Frame, track: Track, why: str) -> None:
        free = track.motion.is_torque_free
        said = "that of a free body again" if free else "not that of a free body"
        name = "torque free" if free else "kinematic"
        _log.info("frame %d: the motion is %s (%s): followed as %s", frame.index, said, why, name)

    def _lose(self, track: Track) -> None:
        """Start again; what was learnt of the mass stays if the track was right until it was lost.

        A symmetric target may be found in another of its equivalent attitudes, where what was
        learnt would be turned; and a wrong track has learnt nothing.
        """
        was_right = not (track.was_wrong or track.open_question or track.evidence.is_doubtful)
        belief = self._belief
        if track.was_wrong:
            self._noise.start_again()
            self._parts.start_again(self._scale.factor)
        if was_right and not track.symmetric:
            belief = track.motion.learnt_mass or belief
        self._track, self._given = None, belief
        self._acquisition = self._new_acquisition(belief)

    # Results.

    def _estimate(
        self, view: FrameView, result: UpdateResult | None, status: Status, observer: ObserverPose
    ) -> Estimate:
        track = self._track
        is_contradicted = track is not None and track.motion.contradicted is not None
        noise, calibration = self._noise.noise, self._scale.doubt
        doubts = FrameDoubts.of(track, is_contradicted, calibration, noise)
        claims = track is not None and status in (Status.LOCKED, Status.AMBIGUOUS)
        if track is None or not claims:
            return answer_of_frame(track, view, result, status, observer, doubts)
        if not is_known(track, self._target, observer):
            status = Status.COASTING
        else:
            own = {"noise, motion and prior": track.motion.reported_covariance}
            self._last_claim = track.motion.kalman.state, {**own, **track.lasting.budget}
        return answer_of_frame(track, view, result, status, observer, doubts)
