"""The beginning of a track: poses in first frames, one motion through them, a first filter.

A filter linearises each measurement about its estimate at the time, which is poor at the start. So
the first state is fitted to all frames of the start at once, and the whole initial arc is fitted
anew while it is bent, and whenever it has grown by a quarter, so that what was linearised about a
worse estimate never makes up much of the filter's information.
"""

import logging
from dataclasses import dataclass, replace

import numpy as np

from pcnav.config.depth import FilterTable, MotionChoice
from pcnav.core.arrays import FloatArray, picked
from pcnav.dynamics.mass_prior import MassBelief
from pcnav.estimators.depth.fast_turns import slowest, with_first_rate
from pcnav.estimators.depth.first_pose import STATED_ODDS, fit_first_pose
from pcnav.estimators.depth.first_state import first_state
from pcnav.estimators.depth.following import FollowedMotion, FreeBody, MotionSetup
from pcnav.estimators.depth.initial_arc import Fit, InitialArc, Timed, condensed
from pcnav.estimators.depth.mass_centre import MassCentreModel
from pcnav.estimators.depth.measured_again import Observed, is_outdated, measured_again
from pcnav.estimators.depth.measuring import predicted_pose
from pcnav.estimators.depth.motion_hypotheses import (
    MIN_FRAMES,
    Decision,
    MotionHypotheses,
    MotionHypothesis,
)
from pcnav.estimators.depth.motion_within import predicted_motion
from pcnav.estimators.depth.noise_learning import NoiseLearner
from pcnav.estimators.depth.pose_fit import SingleFramePose
from pcnav.estimators.depth.pose_measurement import ObserverPose
from pcnav.estimators.depth.round_axes import RoundAxes
from pcnav.estimators.depth.single_frame import (
    agreeing_faces,
    best_first,
    compared_poses,
    search,
    with_rivals,
)
from pcnav.estimators.depth.skewed_pose import unskewed
from pcnav.estimators.depth.target_odds import CLEAR_LEAD, SEARCHED, frame_odds
from pcnav.estimators.depth.views import (
    FrameView,
    silent_view,
    unused_record,
    view_of_comparison,
    view_of_rectangles,
)
from pcnav.filtering.map_arc_fit import TimedMeasurements
from pcnav.perception.association import Unused
from pcnav.perception.perceive import PerceivedFrame
from pcnav.perception.reading import FrameReader, Trust, View
from pcnav.perception.view_hypotheses import SearchReport
from pcnav.recordings.sequence import FirstPosePrior, Frame
from pcnav.target.satellite import Target

_log = logging.getLogger("pcnav")

_HIGH_INLIER_RATIO = 0.9
_MAX_DROP = 0.02
"""Of a frame under the best motion, and hardly less than in the frames before: then no other motion
is searched for."""
_DOUBT_WITHOUT_RATE = 3.0
"""A hypothesis carried over from one observation may be off by so many times more than one that
rectangles propose: the target turns."""
_START_PASSES = 6
"""Most times the first frames are read anew with the poses that fit them."""
_NOISE_PASSES = 3
"""Most times they are measured anew, as noise that was not thought of widens what is looked at."""
_MOVING_PASSES = 3
"""Times that frames which take time are measured anew with the motion that was fitted to them."""
_STILL_PX = 0.1
"""A fit that moves no point of the target further than this is final."""


@dataclass(frozen=True)
class Initialised:
    """A track that is initialised."""

    motion: FollowedMotion
    undecided: bool
    """Whether another motion, no equivalent one, explains the frames as well."""
    view: FrameView
    start: tuple[Observed, ...]
    """The frames that it was begun with."""
    odds: float
    """Logarithm of the odds that it is the target that is followed."""


class Acquisition:
    """Finds a first state without any prior on the motion."""

    def __init__(
        self,
        target: Target,
        reader: FrameReader,
        model: MassCentreModel,
        filtering: FilterTable,
        belief: MassBelief,
        *,
        noise: NoiseLearner,
        refined: bool,
        first_pose: FirstPosePrior | None = None,
    ) -> None:
        """``noise`` learns from the frames of a start; ``first_pose``: where the target is
        said to be in the first frame."""
        self._first_pose, self._noise = first_pose, noise
        self._target, self._reader, self._model = target, reader, model
        self._axes = None if target.roundness is None else RoundAxes(target.roundness)
        self._filtering, self._belief, self._refined = filtering, belief, refined
        self._choice = filtering.motion
        self._units_checked = False
        self.report: SearchReport | None = None
        """Of the search that found most."""
        self._start = MotionHypotheses(target)
        self._among_others = False
        self._frames: dict[float, Frame] = {}
        """Those that motions have observations in, by time."""

    def add(self, frame: Frame, observer: ObserverPose) -> Initialised | FrameView:
        """Take in a frame: an initialised track, or the frame as it was seen.

        Raises `InputError` when target and frame differ in units.
        """
        self._camera_noise = observer.noise
        if self._refined:
            frame = self._reader.thinned(frame)
        told = self._told(frame)
        hypotheses, waiting = told or self._hypotheses(frame)
        if hypotheses:
            self._frames[frame.time_s] = frame
        self._among_others = self._among_others or self._reader.is_among_others(frame)
        prior_odds = -SEARCHED if self._among_others else 0.0
        decision = self._start.add(frame.time_s, frame.T_cam_world, hypotheses, prior_odds)
        if decision is not None and self._refined and not decision.motion.is_fast:
            decision = self._start.looked_again(prior_odds, self._looked_again)
        # A motion of few observations may have left out many frames between them.
        needed = self._start.times_s
        self._frames = {time: kept for time, kept in self._frames.items() if time in needed}
        if told is not None and self._choice is not MotionChoice.TORQUE_FREE:
            best = self._start.best
            assert best is not None, "it has just been begun"
            decision = Decision(best, undecided=False)
        if decision is None:
            return waiting
        if decision.motion.is_fast:
            track = self._fast(decision, prior_odds)
        else:
            track = self._initialise(decision, prior_odds if told is None else STATED_ODDS)
            if track is None:
                self._start = MotionHypotheses(self._target)
        if track is None:
            return waiting
        # What is still doubtful of what a few frames show, more may settle.
        return waiting if track.odds < CLEAR_LEAD else track

    def _told(self, frame: Frame) -> tuple[tuple[SingleFramePose, ...], FrameView] | None:
        """The first frame about where the target is said to be; None where that is no help."""
        stated, self._first_pose = self._first_pose, None
        if stated is None:
            return None
        perceived = self._reader.look(frame)
        fit = fit_first_pose(stated, perceived, self._reader)
        if fit.pose is None:
            _log.warning("frame %d: the first pose is dropped: %s", frame.index, fit.objection)
            return None
        _log.info(
            "frame %d: begun at the first pose (inlier ratio %.0f %%)",
            frame.index,
            100.0 * fit.pose.inlier_ratio,
        )
        begun: tuple[SingleFramePose, ...] = (fit.pose,)
        if self._refined and self._reader.frames_take_time:
            begun = unskewed(begun, frame, self._reader)
        return begun, _looked_at(perceived, "no motion decided on yet")

    def _hypotheses(self, frame: Frame) -> tuple[tuple[SingleFramePose, ...], FrameView]:
        """Where the target may be in a frame, and the frame as it was seen.

        Motions that go on and explain the frame as well as those before save the search for planes.
        """
        predicted = self._start.predicted(frame.time_s, frame.T_cam_world)
        best = self._start.best
        last = None if best is None else best.motion_at(len(best.observations) - 1)
        self._reader.expect_motion(last)
        if self._refined and best is not None:
            doubt = _DOUBT_WITHOUT_RATE if len(best.observations) == 1 else 1.0
            found = compared_poses(predicted, frame, self._reader, doubt, are_motions=True)
            followed = best_first(found)
            if self._reader.frames_take_time:
                followed = unskewed(followed, frame, self._reader)
            usual = max(observation.pose.inlier_ratio for observation in best.observations)
            enough = max(_HIGH_INLIER_RATIO, usual - _MAX_DROP)
            if followed and followed[0].inlier_ratio >= enough:
                return with_rivals(followed, frame, self._reader), silent_view(frame)
        perceived = self._reader.look(frame)
        if not self._units_checked:
            self._units_checked = self._reader.check_units(perceived)
        hypotheses, report = search(perceived, self._reader, predicted)
        if self._refined and self._reader.frames_take_time:
            hypotheses = unskewed(hypotheses, frame, self._reader)
        if self.report is None or not report.best_inlier_ratio < self.report.best_inlier_ratio:
            self.report = report
        return hypotheses, _looked_at(perceived, "no motion decided on yet")

    def _looked_again(self, motion: MotionHypothesis) -> MotionHypothesis:
        """A motion whose observations that explain less than others are fitted anew from between
        these: what is beaten in its frame was not brought to the end, and may belong to the motion
        that is right in all others. A fit is better that explains more, and lies nearer to them."""
        for k, T_between in motion.short_of():
            before = motion.observations[k]
            frame = self._frames[before.time_s]
            found = compared_poses([T_between], frame, self._reader, are_motions=True)
            if not found or found[0].agreement.support <= before.pose.agreement.support:
                continue
            off_px, before_px = (
                self._reader.moved_px(T_between, pose.T_cam_model, frame)
                for pose in (found[0], before.pose)
            )
            if off_px < before_px:
                motion = motion.with_pose(k, found[0])
        return motion

    def _fast(self, decision: Decision, prior_odds: float) -> Initialised | None:
        """The one of fast motions that a body can make; None while more than one can."""
        possible = []
        for motion in (decision.motion, *decision.even):
            track = self._initialise(replace(decision, motion=motion), prior_odds)
            if track is None:
                self._start.refute([motion])
            else:
                rate = float(np.linalg.norm(motion.turns[0]))
                possible.append((rate, track))
        return slowest(possible)

    def _initialise(self, decision: Decision, prior_odds: float) -> Initialised | None:
        """Fit the first state to the frames of the motion decided on, and start the filter."""
        motion = decision.motion.without_strays(self._target.diameter_m)
        belief = self._belief
        n = self._model.mean_motion_rad_s
        guess = first_state(motion, belief.com_model, belief.inertia_ratios, n)
        if motion.is_fast:
            first, then = motion.observations[:2]
            guess = with_first_rate(
                guess, self._model, first.time_s, then.time_s, then.R_world_body
            )
        arc = InitialArc(self._model, guess, belief, self._axes)
        frames = [self._frames[observation.time_s] for observation in motion.observations]
        observers = [
            ObserverPose.of(frame.T_cam_world, frame.time_s, n, self._camera_noise)
            for frame in frames
        ]
        if self._refined:
            views = self._learnt(self._compared(motion, frames, observers), observers, motion)
            arc.frames = [condensed(_timed(view)) for view in views]
            fit = arc.fit() if len(views) >= MIN_FRAMES else None
            for _ in range(_MOVING_PASSES if self._reader.frames_take_time else 0):
                if fit is not None:
                    fit, views = self._fit_moving(arc, fit, views, observers)
        else:
            fit, views = self._fit_rectangles(arc, motion, frames, observers)
        if fit is None and motion.is_fast and not motion.is_steady:
            # Between frames so far apart any motion could have done anything.
            return None
        if self._choice is MotionChoice.KINEMATIC or len(frames) < MIN_FRAMES:
            fit = None
        elif fit is None:
            after = "" if self._choice is MotionChoice.TORQUE_FREE else ": followed as kinematic"
            _log.info("frame %d: no free motion fits the first frames%s", frames[-1].index, after)
        if fit is None and self._choice is MotionChoice.TORQUE_FREE:
            return None
        measured = [timed for timed in arc.frames if timed.measurements]
        if not measured:
            return None
        free = None if fit is None else FreeBody.of(fit, arc, self._filtering)
        begin = guess if fit is None else fit.first
        setup = MotionSetup(self._model, self._filtering, self._target.diameter_m, self._axes)
        followed = FollowedMotion(setup, belief, free, begin, measured)
        start = tuple(zip(views, observers, strict=True))
        odds = prior_odds + motion.odds
        if self._refined:
            odds += self._odds_gained(followed, odds, motion, frames[-1], observers[-1])
        return Initialised(followed, decision.undecided, views[-1], start, odds)

    def _fit_moving(
        self, arc: InitialArc, fit: Fit, views: list[FrameView], observers: list[ObserverPose]
    ) -> tuple[Fit | None, list[FrameView]]:
        """Frames that take time measured anew, with the target moving in each as the fit to all of
        them has it, and the fit to them then: one frame alone says little of its rate."""
        n, lever_m = self._model.mean_motion_rad_s, 0.5 * self._target.diameter_m
        again: list[FrameView] = []
        for k, view in enumerate(views):
            state, time_s, comparison = picked(fit.path, k), view.frame.time_s, view.comparison
            assert comparison is not None, "it was compared"
            beside = views[k - 1 if k else 1].frame
            camera = beside.time_s, beside.T_cam_world
            half_s = self._reader.half_duration(view.frame)
            at = state, time_s, self._model
            motion = predicted_motion(*at, observers[k], camera, half_s, n) if half_s else None
            self._reader.expect_motion(motion)
            pose = state.T_cam_model(observers[k].T_cam_world, observers[k].R_hill_world)
            found = self._reader.compare(view.frame, pose, comparison.seen.doubt.covariance)
            again.append(view_of_comparison(view.frame, found, lever_m, observers[k]))
        arc.frames = [condensed(_timed(view)) for view in again]
        return arc.fit(), again

    def _odds_gained(
        self,
        followed: FollowedMotion,
        odds: float,
        motion: MotionHypothesis,
        frame: Frame,
        observer: ObserverPose,
    ) -> float:
        """By the pose that the filter begins with, over the one fitted to its last frame alone.

        A free motion that is bent to frames of another one is given up for any motion. A frame that
        contradicts the filter leaves no odds at all.
        """
        single = frame_odds(motion.observations[-1].pose.agreement)
        comparison = self._reader.compare(frame, *predicted_pose(followed.kalman, observer))
        filtered = frame_odds(comparison.agreement)
        gained = min(filtered - single, 0.0) if filtered > 0.0 else -np.inf
        if odds + gained < CLEAR_LEAD and followed.is_torque_free and followed.kinematic:
            followed.go_over(len(motion.observations))
            return self._odds_gained(followed, odds, motion, frame, observer)
        return gained

    def _compared(
        self, motion: MotionHypothesis, frames: list[Frame], observers: list[ObserverPose]
    ) -> list[FrameView]:
        views: list[FrameView] = []
        for observation, frame, observer in zip(
            motion.observations, frames, observers, strict=True
        ):
            pose, comparison = observation.pose, observation.pose.comparison
            is_known = comparison is not None
            if comparison is None or self._reader.frames_take_time:
                # It was fitted in another of the target's equivalent attitudes, or before anything
                # was known of how the target moves.
                self._reader.expect_motion(motion.motion_at(len(views)))
                comparison = self._reader.compare(frame, pose.T_cam_model, pose.covariance)
            kept = comparison.faces
            if is_known:
                kept = tuple(face for face in kept if face.name in pose.used)
            comparison = replace(comparison, faces=kept)
            views.append(
                view_of_comparison(frame, comparison, 0.5 * self._target.diameter_m, observer)
            )
        return views

    def _learnt(
        self, views: list[FrameView], observers: list[ObserverPose], motion: MotionHypothesis
    ) -> list[FrameView]:
        """Frames measured anew where they show the noise to be another than was believed."""
        poses = [observation.T_cam_model for observation in motion.observations]
        for attempt in range(_NOISE_PASSES):
            self._noise.learn_start(views, poses, again=attempt > 0)
            if not any(is_outdated(view, self._noise.noise) for view in views):
                break
            views = [
                measured_again(self._reader, view, observer)
                for view, observer in zip(views, observers, strict=True)
            ]
        return views

    def _fit_rectangles(
        self,
        arc: InitialArc,
        motion: MotionHypothesis,
        frames: list[Frame],
        observers: list[ObserverPose],
    ) -> tuple[Fit | None, list[FrameView]]:
        poses = [observation.T_cam_model for observation in motion.observations]
        views: list[FrameView] = []
        fit: Fit | None = None
        for attempt in range(_START_PASSES):
            # A pose from one rectangle can be off by pixels; one fitted to all of them is not.
            trust = Trust.PLANES if attempt == 0 else Trust.PIXELS
            views = [
                view_of_rectangles(self._agreeing(self._reader.read(frame, pose, trust), pose), s)
                for frame, pose, s in zip(frames, poses, observers, strict=True)
            ]
            arc.frames = [_timed(view) for view in views]
            fit = arc.fit()
            if fit is None:
                break
            before, poses = (
                poses,
                [
                    picked(fit.path, k).T_cam_model(observer.T_cam_world, observer.R_hill_world)
                    for k, observer in enumerate(observers)
                ],
            )
            if attempt > 0 and max(map(self._reader.moved_px, before, poses, frames)) < _STILL_PX:
                break
        return fit, views

    def _agreeing(self, view: View, T_cam_model: FloatArray) -> View:
        """A view without the faces that the others contradict: nothing else gates them yet."""
        faces = agreeing_faces(view.faces, T_cam_model, self._target.diameter_m)
        kept = {id(face) for face in faces}
        out = [Unused(f.seen, "contradicts the others") for f in view.faces if id(f) not in kept]
        return replace(view, faces=faces, unused=[*view.unused, *out])


def _timed(view: FrameView) -> Timed:
    return TimedMeasurements(view.frame.time_s, view.measurements)


def _looked_at(perceived: PerceivedFrame, reason: str) -> FrameView:
    """A frame in which nothing was measured, with all that was seen in it."""
    time_s = perceived.frame.time_s
    unused = tuple(unused_record(time_s, Unused(seen, reason)) for seen in perceived.seen)
    labels = perceived.image_labels
    return FrameView(perceived.frame, labels, (), (), (), unused, float("nan"))
