"""The tracker: perception and filter joined, one frame in, one estimate out."""

import logging
from collections import deque
from dataclasses import replace
from enum import StrEnum

import numpy as np

from pcnav.arrays import FloatArray
from pcnav.config import FilterTable, PerceptionTable
from pcnav.dynamics.orbit import R_hill_world
from pcnav.estimation.batch import ArcError, ArcFit, TimedMeasurements, fit_arc
from pcnav.estimation.error_state import ErrorStateFilter, UpdateResult
from pcnav.estimation.mass_centre import MassCentreModel, RectangleMeasurement
from pcnav.estimation.single_frame import agreeing_faces, refined_hypotheses
from pcnav.estimation.start import (
    MOST_SIGHTINGS,
    Decision,
    MotionStart,
    first_state,
    start_covariance,
)
from pcnav.perception.association import MeasuredFace, Unused
from pcnav.perception.perceive import PerceivedFrame
from pcnav.perception.reading import FrameReader, Trust, View
from pcnav.results import ACCEPTED, FrameEstimate, RectangleRecord
from pcnav.sequences.sequence import Frame, SequenceInfo
from pcnav.spatial import make_transform
from pcnav.state import COM_MODEL, R_HILL, THETA_BODY, NavigationState
from pcnav.target import Target

_log = logging.getLogger("pcnav")

_MOST_BLIND_FRAMES = 10
"""Frames with returns but without an accepted measurement before the track is given up."""
_ARC_LENGTHS = (8, 16, 32, 64)
"""Numbers of frames after which the whole arc since the start is fitted anew."""
_START_PASSES = 6
"""Most times the first frames are read anew with the poses that fit them."""
_LARGEST_ARC_CHI_SQUARE = 4.0
"""Per degree of freedom: a motion that fits its frames worse is not believed."""
_PASSES = 3
"""Most times the expected view is rendered anew because the update moved the pose."""
_LEAST_EXPLAINED = 0.4
"""Share of a frame that a prediction must explain for the frame to be believed of it."""
_STILL_PX = 0.1
"""An update that moves no point of the target further than this is final."""
_SHARP_PX = 0.7
"""A prediction that is off by less than this settles which face a pixel shows."""


class Status(StrEnum):
    """What an estimate is worth."""

    ACQUIRING = "acquiring"
    LOCKED = "locked"
    AMBIGUOUS = "ambiguous"
    COASTING = "coasting"
    LOST = "lost"


class Tracker:
    """Follows one target through a sequence: acquires it, then filters frame by frame.

    Nothing but the target, the pipeline's settings and the frames enters an estimate.
    """

    def __init__(
        self,
        target: Target,
        info: SequenceInfo,
        perception: PerceptionTable,
        filtering: FilterTable,
        seed: int,
    ) -> None:
        self._target, self._info, self._filtering = target, info, filtering
        sigma_m = perception.range_sigma_m or info.range_sigma_m
        self._reader = FrameReader(target, perception, sigma_m, seed)
        self._model = MassCentreModel(
            info.mean_motion_rad_s,
            filtering.acceleration_psd_m2_s3,
            filtering.angular_acceleration_psd_rad2_s3,
        )
        self._units_checked = False
        self._status = Status.ACQUIRING
        self._forget()

    def _forget(self) -> None:
        """Start from nothing."""
        self._filter: ErrorStateFilter[NavigationState] | None = None
        self._time_s = 0.0
        self._start = MotionStart(self._target)
        self._start_frames: deque[Frame] = deque(maxlen=MOST_SIGHTINGS)
        self._arc: list[TimedMeasurements] | None = []
        self._arc_guess: NavigationState | None = None
        self._arc_start: NavigationState | None = None
        self._blind_frames = 0
        self._ambiguous = False

    def step(self, frame: Frame) -> tuple[FrameEstimate, PerceivedFrame]:
        """Take in one frame. Raises `InputError` when target and frame differ in units."""
        if self._filter is None:
            estimate, perceived = self._acquire(frame)
        else:
            estimate, perceived = self._track(frame, self._filter)
        if estimate.status != self._status:
            _log.info("frame %d: %s -> %s", frame.index, self._status, estimate.status)
            self._status = Status(estimate.status)
        return estimate, perceived

    # Acquisition.

    def _acquire(self, frame: Frame) -> tuple[FrameEstimate, PerceivedFrame]:
        perceived = self._reader.look(frame)
        if not self._units_checked:
            self._units_checked = self._reader.check_units(perceived)
        hypotheses = refined_hypotheses(perceived, self._reader)
        if hypotheses:
            self._start_frames.append(frame)
        decision = self._start.add(frame.time_s, frame.T_cam_world, hypotheses)
        if decision is not None:
            return self._begin(decision), perceived
        unused = [Unused(seen, "no motion decided on yet") for seen in perceived.seen]
        return self._estimate(View(perceived, [], unused), None, Status.ACQUIRING), perceived

    def _begin(self, decision: Decision) -> FrameEstimate:
        """Fit the first state to the frames of the motion decided on, and start the filter."""
        by_time = {frame.time_s: frame for frame in self._start_frames}
        frames = [by_time[sighting.time_s] for sighting in decision.motion.sightings]
        poses = [sighting.T_cam_model for sighting in decision.motion.sightings]
        com, ratios = self._prior_mass()
        self._arc_guess = first_state(decision.motion, com, ratios, self._info.mean_motion_rad_s)
        views: list[View] = []
        fit: ArcFit | None = None
        for attempt in range(_START_PASSES):
            # A pose from one rectangle can be off by pixels; one fitted to all of them is not.
            trust = Trust.PLANES if attempt == 0 else Trust.PIXELS
            views = [
                self._agreeing(self._reader.read(frame, pose, trust), pose)
                for frame, pose in zip(frames, poses, strict=True)
            ]
            self._arc = [self._timed(view) for view in views]
            fit = self._fit_arc()
            if fit is None:
                break
            before, poses = (
                poses,
                [self._pose(state, frame) for state, frame in zip(fit.states, frames, strict=True)],
            )
            if attempt > 0 and max(map(self._reader.moved_px, before, poses, frames)) < _STILL_PX:
                break
        if fit is None or not _holds(fit):
            _log.info("frame %d: the first motion did not hold", frames[-1].index)
            self._forget()
            return self._estimate(
                _without_faces(views[-1], "the first motion did not hold"), None, Status.ACQUIRING
            )
        self._ambiguous = decision.ambiguous
        self._restart(fit)
        status = Status.AMBIGUOUS if self._ambiguous else Status.LOCKED
        return self._estimate(views[-1], None, status)

    def _agreeing(self, view: View, T_cam_model: FloatArray) -> View:
        """A view without the faces that the others contradict: nothing else gates them yet."""
        faces = agreeing_faces(view.faces, T_cam_model, self._target.diameter_m)
        kept = {id(face) for face in faces}
        out = [Unused(f.seen, "contradicts the others") for f in view.faces if id(f) not in kept]
        return replace(view, faces=faces, unused=[*view.unused, *out])

    def _prior_mass(self) -> tuple[FloatArray, FloatArray]:
        initial = self._info.initial
        com, ratios = self._target.com_model, self._target.inertia_ratios
        if initial is not None and initial.com_model_m is not None:
            com = initial.com_model_m
        if initial is not None and initial.inertia_ratios is not None:
            ratios = initial.inertia_ratios
        return com, ratios

    def _prior_spread(self) -> tuple[FloatArray, FloatArray]:
        """Standard deviations (3,) of the mass centre and (5,) of the ratios: pipeline file, then
        sequence, then target."""
        initial = self._info.initial
        com = np.full(3, self._filtering.com_sd_m or self._target.com_sd_m)
        ratios = np.full(5, self._filtering.inertia_ratio_sd or self._target.inertia_ratio_sd)
        if initial is not None and initial.com_sd_m is not None and not self._filtering.com_sd_m:
            com = initial.com_sd_m
        if (
            initial is not None
            and initial.inertia_ratios_sd is not None
            and not self._filtering.inertia_ratio_sd
        ):
            ratios = initial.inertia_ratios_sd
        return com, ratios

    def _fit_arc(self) -> ArcFit | None:
        """Fit the whole young track, only while it is kept; None where no fit is found."""
        assert self._arc is not None and self._arc_guess is not None, "checked by the callers"
        prior = start_covariance(*self._prior_spread())
        try:
            fit = fit_arc(self._model, self._arc_guess, prior, self._arc, self._arc_start)
        except ArcError as error:
            _log.info("%s", error)
            return None
        if not fit.converged:
            return None
        self._arc_start = fit.states[0]
        return fit

    def _restart(self, fit: ArcFit) -> None:
        """Go on from the last state of a fit."""
        assert self._arc, "a fit has an arc"
        self._time_s = self._arc[-1].time_s
        self._filter = ErrorStateFilter(
            fit.states[-1],
            fit.covariance,
            gate_probability=self._filtering.gate_probability,
            most_iterations=self._filtering.iterations,
        )

    # Tracking.

    def _track(
        self, frame: Frame, kalman: ErrorStateFilter[NavigationState]
    ) -> tuple[FrameEstimate, PerceivedFrame]:
        kalman.predict(self._model, self._time_s, frame.time_s - self._time_s)
        self._time_s = frame.time_s
        view, result = self._update(frame, kalman)
        if result is not None and any(result.accepted):
            self._blind_frames = 0
            self._extend_arc(view, result)
            status = Status.AMBIGUOUS if self._ambiguous else Status.LOCKED
        else:
            # A frame without a surface in it says nothing; one full of unexplained ones does.
            self._blind_frames += bool(view.perceived.seen)
            status = Status.LOST if self._blind_frames > _MOST_BLIND_FRAMES else Status.COASTING
        estimate = self._estimate(view, result, status)
        if status is Status.LOST:
            self._forget()
        return estimate, view.perceived

    def _update(
        self, frame: Frame, kalman: ErrorStateFilter[NavigationState]
    ) -> tuple[View, UpdateResult | None]:
        """Measure against the expected view and update; again while the view still moves.

        A frame that the pose does not explain leaves the filter as predicted, without a result.
        """
        prior = kalman.snapshot()
        pose = self._pose(kalman.state, frame)
        view = self._reader.read(frame, pose, self._trust(kalman, frame))
        result = kalman.update(self._timed(view).measurements)
        for _ in range(_PASSES - 1):
            before, pose = pose, self._pose(kalman.state, frame)
            moved_px = self._reader.moved_px(before, pose, frame)
            if moved_px < _STILL_PX or not self._reader.depends_on_pose:
                break
            if moved_px < _SHARP_PX:
                view = self._reader.read_again(view, pose)
            else:
                view = self._reader.read(frame, pose, Trust.PIXELS)
            kalman.restore(prior)
            result = kalman.update(self._timed(view).measurements)
        if view.explained < _LEAST_EXPLAINED:
            # A few returns can always be found where a wrong pose predicts a face.
            kalman.restore(prior)
            return _without_faces(view, "frame not explained"), None
        return view, result

    def _trust(self, kalman: ErrorStateFilter[NavigationState], frame: Frame) -> Trust:
        """How good the prediction is, going by the filter's own covariance and recent frames."""
        if self._blind_frames > 0:
            return Trust.NONE
        # The mass centre errs in space and in the model alike: the model itself is seen far better.
        origin = _origin_covariance(
            kalman, R_hill_world(frame.time_s, self._info.mean_motion_rad_s)
        )
        shift = float(np.sqrt(np.trace(origin)))
        turn = float(np.sqrt(np.trace(kalman.covariance[THETA_BODY, THETA_BODY])))
        off_px = self._reader.pixels(shift, turn, self._pose(kalman.state, frame), frame)
        return Trust.PIXELS if off_px < _SHARP_PX else Trust.PLANES

    def _extend_arc(self, view: View, result: UpdateResult) -> None:
        """Keep the young track's measurements, and fit the whole arc anew at set lengths."""
        if self._arc is None:
            return
        passed = [face for face, ok in zip(view.faces, result.accepted, strict=True) if ok]
        self._arc.append(self._timed(replace(view, faces=passed)))
        if len(self._arc) in _ARC_LENGTHS:
            fit = self._fit_arc()
            if fit is not None and _holds(fit):
                self._restart(fit)
        if len(self._arc) >= _ARC_LENGTHS[-1]:
            self._arc = None

    # Between frames, states and measurements.

    def _timed(self, view: View) -> TimedMeasurements:
        R, T_cam_hill = self._hill(view.frame)
        return TimedMeasurements(
            view.frame.time_s,
            tuple(
                RectangleMeasurement(
                    rectangle=face.rectangle.name,
                    T_model_rect=face.rectangle.T_model_rect,
                    T_cam_rect=face.T_cam_rect,
                    known=face.known,
                    full_covariance=face.covariance,
                    T_cam_hill=T_cam_hill,
                    R_hill_world=R,
                )
                for face in view.faces
            ),
        )

    def _hill(self, frame: Frame) -> tuple[FloatArray, FloatArray]:
        """R_hill_world (3, 3) and T_cam_hill (4, 4) at the time of a frame."""
        R = R_hill_world(frame.time_s, self._info.mean_motion_rad_s)
        return R, frame.T_cam_world @ make_transform(R.T, np.zeros(3))

    def _pose(self, state: NavigationState, frame: Frame) -> FloatArray:
        """(4, 4) T_cam_model of a state at the time of a frame."""
        return state.T_cam_model(frame.T_cam_world, self._hill(frame)[0])

    def _estimate(self, view: View, result: UpdateResult | None, status: Status) -> FrameEstimate:
        kalman, frame = self._filter, view.perceived.frame
        passed = [True] * len(view.faces) if result is None else list(result.accepted)
        records = [
            _face_record(frame.time_s, face, ACCEPTED if ok else "failed the innovation gate")
            for face, ok in zip(view.faces, passed, strict=True)
        ]
        records += [_unused_record(frame.time_s, unused) for unused in view.unused]
        return FrameEstimate(
            index=frame.index,
            time_s=frame.time_s,
            state=None if kalman is None else kalman.state,
            covariance=None if kalman is None else kalman.covariance,
            T_cam_model=None if kalman is None else self._pose(kalman.state, frame),
            status=str(status),
            nis=float("nan") if result is None else result.joint_nis,
            nis_dof=0 if result is None else result.joint_dof,
            n_rectangles=sum(passed),
            records=tuple(records),
        )


def _without_faces(view: View, reason: str) -> View:
    """A view none of whose faces is used, and why."""
    return replace(
        view, faces=[], unused=[*view.unused, *(Unused(face.seen, reason) for face in view.faces)]
    )


def _holds(fit: ArcFit) -> bool:
    """Whether one motion explains an arc."""
    return fit.chi_square < _LARGEST_ARC_CHI_SQUARE * fit.dof


def _origin_covariance(
    kalman: ErrorStateFilter[NavigationState], R_hill_world: FloatArray
) -> FloatArray:
    """(3, 3) covariance of the model origin ``r - R com``, attitude held: m^2, Hill axes."""
    select = np.zeros((3, len(kalman.covariance)))
    select[:, R_HILL] = np.eye(3)
    select[:, COM_MODEL] = -R_hill_world @ kalman.state.R_world_body
    return np.asarray(select @ kalman.covariance @ select.T)


def _face_record(time_s: float, face: MeasuredFace, outcome: str) -> RectangleRecord:
    return RectangleRecord(
        time_s=time_s,
        rectangle=face.rectangle.name,
        length_m=face.length_m,
        width_m=face.width_m,
        T_cam_rect=face.T_cam_rect,
        sd=np.where(face.known, np.sqrt(np.diag(face.covariance)), np.inf),
        case=str(face.case),
        outcome=outcome,
    )


def _unused_record(time_s: float, unused: Unused) -> RectangleRecord:
    observation = unused.seen.observation
    return RectangleRecord(
        time_s=time_s,
        rectangle="",
        length_m=observation.length_m,
        width_m=observation.width_m,
        T_cam_rect=observation.T_cam_rect,
        sd=np.sqrt(np.diag(observation.covariance)[:6]),
        case="",
        outcome=unused.reason,
    )
