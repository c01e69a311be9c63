"""Trajectories of every estimator, followed by its own model over an arc and beyond it.

The true motion of a pipeline, or the one that leads to the last estimate of a run, is followed over
the arc and beyond it. An arc of many frames is thinned; a frame of the thinned arc then stands for
several.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Generic, TypeVar

import numpy as np

from pcnav.config.attitude_inertia import AttitudeInertiaTable
from pcnav.config.inertia_bank import InertiaBankTable
from pcnav.config.principal_axes import PrincipalAxesTable
from pcnav.core.arrays import FloatArray, IntArray
from pcnav.core.camera import R_cam_hill
from pcnav.dynamics.inertia_parameters import inertia_of, parameters_of
from pcnav.dynamics.state import NavigationState
from pcnav.estimators.attitude_inertia.estimator import initial_belief
from pcnav.estimators.attitude_inertia.rotation_model import (
    THETA,
    AttitudeSet,
    RotationState,
    TorqueFreeModel,
)
from pcnav.estimators.inertia_bank.relative_state import (
    PixelMeasurements,
    RelativeMotion,
    RelativeStates,
    reduced_pixels,
)
from pcnav.estimators.principal_axes.feature_measurements import FeatureView
from pcnav.estimators.principal_axes.feature_states import (
    PrincipalAxesModel,
    PrincipalState,
    ratios_from_moments,
)
from pcnav.evaluation.observability.information import (
    Propagate,
    ReferenceArc,
    Sensor,
    reference_arc,
    whitened,
)
from pcnav.evaluation.observability.reported import BANK, PRINCIPAL, ROTATION, ReportedState
from pcnav.recordings.tracks import StereoTracks, TrackFrame

S = TypeVar("S")

_MAX_FRAMES = 150
"""Of an arc; more are thinned out."""
_MAX_TURN_RAD = 0.4
"""Of the target between frames of a thinned arc."""
_MAX_BEYOND = 700
_GROWTH = 0.05
"""Of the time since the start, between frames at most."""
_EXTENSION = 4.0
"""Length of the extended arc over that of the arc."""
_PRINCIPAL_PRIOR_SD = (*[1.0] * 3, *[0.2] * 3, *[0.5] * 2, *[10.0] * 3, *[1.0] * 3)
"""Of attitude, rate, ratios, position and velocity (rad, rad/s, 1, m, m/s): a filter in principal
axes begins with nothing."""
_POINT_SD_M = 3.0


@dataclass(frozen=True)
class TargetMotion:
    """A target at one time of its motion."""

    time_s: float
    state: NavigationState
    points: Mapping[int, FloatArray] = field(default_factory=dict)
    """(3,) by feature, from the mass centre, body axes, m."""

    @property
    def rotation(self) -> RotationState:
        """What attitudes tell of it."""
        state = self.state
        return RotationState(state.R_world_body, state.omega_body, parameters_of(state.inertia))


@dataclass(frozen=True)
class Timing:
    """The times of an arc and of its extension, thinned."""

    times_s: FloatArray
    weights: FloatArray
    """How many frames each stands for."""
    frames: int
    """Of the arc, thinned."""
    recorded_s: FloatArray
    """(seen,) times of the arc's own frames."""

    def index(self, k: int) -> int:
        """The frame of the recording that frame k is like: the recording is repeated."""
        start, end = float(self.recorded_s[0]), float(self.recorded_s[-1])
        past = (float(self.times_s[k]) - start) % max(end - start, 1e-9)
        if k == self.frames - 1:
            past = end - start
        return int(np.argmin(np.abs(self.recorded_s - start - past)))


def timing_of(times_s: FloatArray, omega_body: FloatArray) -> Timing:
    """Thinned and extended times of an arc (n,) of a body with a rate (3,), rad/s.

    Frames lie densely at first, where standard deviations fall fast, and never so far apart that
    the body turns by more than a fraction of a radian between two.
    """
    start, span_s = float(times_s[0]), float(times_s[-1] - times_s[0])
    if span_s <= 0.0:
        return Timing(times_s[:1], np.ones(1), 1, times_s)
    interval_s = span_s / (len(times_s) - 1)
    speed = max(float(np.linalg.norm(omega_body)), 1e-9)
    max_s = max(interval_s, min(span_s / _MAX_FRAMES, _MAX_TURN_RAD / speed))
    past = [0.0]
    while past[-1] < span_s * (1.0 - 1e-9):
        step_s = float(np.clip(_GROWTH * past[-1], interval_s, max_s))
        past.append(min(past[-1] + step_s, span_s))
    frames = len(past)
    beyond = max(1, min(round((_EXTENSION - 1.0) * span_s / max_s), _MAX_BEYOND))
    past += [span_s + (k + 1) * max_s for k in range(beyond)]
    steps = np.diff(past, prepend=-interval_s)
    return Timing(start + np.array(past), steps / interval_s, frames, times_s)


@dataclass(frozen=True)
class Linearised(Generic[S]):
    """An estimator as it is asked along a trajectory: its state, model, sensor and prior."""

    estimator: str
    reported: ReportedState[S]
    state: S
    """Of the motion at its time."""
    propagate: Propagate[S]
    sensor: Sensor[S]
    """By the number of a frame of the thinned arc."""
    prior: Callable[[S], FloatArray]
    """(n, n) before the first frame, of the state there."""
    omega_body: Callable[[S], FloatArray]
    """(3,) of a state, rad/s."""
    inertia: FloatArray
    """(3, 3) of any scale, in the axes of the rate."""
    note: str
    """What the measurements are taken to be."""


@dataclass(frozen=True)
class Subject(Generic[S]):
    """A trajectory to be judged, extended beyond the arc that was or will be seen."""

    title: str
    estimator: Linearised[S]
    arc: ReferenceArc[S]
    """With the extension."""
    timing: Timing
    """Of the arc."""
    prior_covariance: FloatArray
    """(n, n) before the first frame."""

    @property
    def frames(self) -> int:
        """How many frames of the thinned and extended arc belong to the arc itself."""
        return self.timing.frames

    @property
    def omega_body(self) -> FloatArray:
        """(3,) at the end of the arc, rad/s."""
        return self.estimator.omega_body(self.arc.states[self.frames - 1])

    @staticmethod
    def of(title: str, at_s: float, timing: Timing, estimator: Linearised[S]) -> "Subject[S]":
        """The arc that leads through the estimator's state at a time."""
        start, first_s = estimator.state, float(timing.times_s[0])
        if at_s != first_s:
            start = estimator.propagate(start, at_s, first_s - at_s)[0]
        arc = reference_arc(
            estimator.propagate, start, timing.times_s, estimator.sensor, timing.weights
        )
        return Subject(title, estimator, arc, timing, estimator.prior(start))


def attitude_subject(
    title: str,
    table: AttitudeInertiaTable,
    start: RotationState,
    times_s: FloatArray,
    attitude_variance_rad2: float | None = None,
    note: str | None = None,
    estimator: str = "attitude_inertia",
) -> Subject[RotationState]:
    """Of attitudes alone, from a state at the first of times (n,) on.

    ``attitude_variance_rad2`` about each axis replaces the table's.
    """
    variance = attitude_variance_rad2 or np.radians(table.attitude_sd_deg) ** 2
    noise = variance * np.eye(3)
    timing = timing_of(times_s, start.omega_body)
    model = TorqueFreeModel(table.angular_acceleration_psd_rad2_s3, table.propagation)
    prior = initial_belief(table)[2]
    # What the first attitude alone leaves, many times over: the prior says nothing of attitude.
    prior[THETA, THETA] = 1e4 * noise
    sd_deg = np.degrees(np.sqrt(variance))

    def sensor(seen: RotationState, k: int) -> FloatArray:
        measured = AttitudeSet(seen.R_world_body, noise)
        return whitened(measured.jacobian(seen), measured.noise)

    linearised = Linearised(
        estimator=estimator,
        reported=ROTATION,
        state=start,
        propagate=model.propagate,
        sensor=sensor,
        prior=lambda state: prior,
        omega_body=lambda state: state.omega_body,
        inertia=inertia_of(start.parameters),
        note=note or f"An attitude of {sd_deg:.3g} deg in every frame.",
    )
    return Subject.of(title, float(timing.times_s[0]), timing, linearised)


def measured_attitudes_subject(
    title: str,
    table: AttitudeInertiaTable,
    start: RotationState,
    times_s: FloatArray,
    variances_rad2: FloatArray,
    chained: bool,
) -> Subject[RotationState]:
    """Of attitudes found in frames at times (n,), of variances about an axis (m,) with m <= n.

    Each is given the geometric mean of the variances. Frames that are not measured are made up for
    by weight. ``chained`` says whether they come from images of one camera.
    """
    typical = float(np.exp(np.mean(np.log(variances_rad2))))
    share = min(1.0, len(variances_rad2) / max(len(times_s) - 1, 1))
    sd_deg = float(np.degrees(np.sqrt(typical)))
    note = (
        f"An attitude of {sd_deg:.3g} deg about an axis in {share:.0%} of the frames, each with an "
        "error of its own."
    )
    if chained:
        note += (
            " Those of a chain of images share the errors of its key frames: together they tell "
            "more of the rate, and less of the attitude."
        )
    estimator = "image_motion, its attitudes to attitude_inertia" if chained else "attitude_inertia"
    return attitude_subject(title, table, start, times_s, typical / share, note, estimator)


class _Views:
    """Which points the frames of a recording saw, and whence; it is repeated beyond its end."""

    def __init__(self, tracks: StereoTracks, motion: TargetMotion) -> None:
        self.tracks = tracks
        times_s = np.array([frame.time_s for frame in tracks.frames])
        self.timing = timing_of(times_s, motion.state.omega_body)
        self.points = np.stack(list(motion.points.values()))
        self._slot = {feature: k for k, feature in enumerate(motion.points)}

    def slots(self, k: int) -> IntArray:
        """(m,) places in the state of the points that frame k sees."""
        frame = self.tracks.frames[self.timing.index(k)]
        found = [self._slot[f] for f in frame.features.tolist() if f in self._slot]
        return np.array(found, dtype=np.intp)

    def R_rig_hill(self, k: int, r_hill: FloatArray) -> FloatArray:
        """(3, 3): as recorded; beyond the recording the rig looks at the target."""
        if k >= self.timing.frames:
            return R_cam_hill(r_hill)
        frame = self.tracks.frames[self.timing.index(k)]
        hill = self.tracks.orbit.R_hill_world(frame.time_s)
        return np.asarray(frame.R_cam_world @ hill.T)

    @property
    def note(self) -> str:
        """What is measured."""
        rig = self.tracks.rig
        return (
            f"Pixels of {rig.pixel_sigma_px:g} px of {len(self.points)} points, in the frames in "
            "which they were seen; the recording is repeated beyond its end."
        )


def principal_subject(
    title: str, table: PrincipalAxesTable, tracks: StereoTracks, motion: TargetMotion
) -> Subject[PrincipalState]:
    """Of the principal-axes filter, along the motion through a state at the first frame or later.

    The axes of the body are turned into principal ones; features without a point are left out.
    """
    at, views = motion.state, _Views(tracks, motion)
    moments, axes = np.linalg.eigh(at.inertia)
    R_body_principal = axes[:, ::-1].copy()
    R_body_principal[:, 2] *= np.sign(np.linalg.det(R_body_principal))
    state = PrincipalState(
        R_world_body=at.R_world_body @ R_body_principal,
        omega_body=R_body_principal.T @ at.omega_body,
        ratios=ratios_from_moments(moments[::-1]),
        r_hill=at.r_hill,
        v_hill=at.v_hill,
        points=views.points @ R_body_principal,
    )
    model = PrincipalAxesModel(
        tracks.orbit, table.acceleration_psd_m2_s3, table.angular_acceleration_psd_rad2_s3
    )

    def sensor(seen: PrincipalState, k: int) -> FloatArray:
        slots, rig, time_s = views.slots(k), tracks.rig, float(views.timing.times_s[k])
        hill = tracks.orbit.R_hill_world(time_s)
        R_cam_world = views.R_rig_hill(k, seen.r_hill) @ hill
        p_world = seen.points[slots] @ seen.R_world_body.T + hill.T @ seen.r_hill
        frame = TrackFrame(time_s, R_cam_world, slots, rig.project(p_world @ R_cam_world.T))
        view = FeatureView(frame, rig, hill, slots)
        return whitened(view.jacobian(seen), view.noise)

    sd = np.array([*_PRINCIPAL_PRIOR_SD, *[_POINT_SD_M] * views.points.size])
    linearised = Linearised(
        estimator="principal_axes",
        reported=PRINCIPAL,
        state=state,
        propagate=model.propagate,
        sensor=sensor,
        prior=lambda state: np.diag(sd**2),
        omega_body=lambda state: state.omega_body,
        inertia=np.diag(moments[::-1]),
        note=views.note,
    )
    return Subject.of(title, motion.time_s, views.timing, linearised)


def bank_subject(
    title: str, table: InertiaBankTable, tracks: StereoTracks, motion: TargetMotion
) -> Subject[RelativeStates]:
    """Of one filter of the bank: the one that believes in the inertia given."""
    at, views, orbit = motion.state, _Views(tracks, motion), tracks.orbit
    state = RelativeStates(
        r_hill=at.r_hill,
        v_hill=at.v_hill,
        R_hill_body=orbit.R_hill_world(motion.time_s) @ at.R_world_body,
        omega_body=at.omega_body,
        points_body=views.points,
        coupled=table.kinematic_coupling,
    )
    model = RelativeMotion(
        orbit,
        at.inertia,
        np.asarray(np.linalg.inv(at.inertia), np.float64),
        table.acceleration_psd_m2_s3,
        table.angular_acceleration_psd_rad2_s3,
    )

    def sensor(seen: RelativeStates, k: int) -> FloatArray:
        slots, R_rig_hill = views.slots(k), views.R_rig_hill(k, seen.r_hill)
        pixels = tracks.rig.project(seen.positions()[slots] @ R_rig_hill.T)
        measured = PixelMeasurements(tracks.rig, R_rig_hill, slots, reduced_pixels(pixels))
        return whitened(measured.jacobian(seen), measured.noise)

    linearised = Linearised(
        estimator="inertia_bank",
        reported=BANK,
        state=state,
        propagate=model.propagate,
        sensor=sensor,
        prior=lambda start: _bank_prior(table, start),
        omega_body=lambda state: state.omega_body,
        inertia=at.inertia,
        note=f"{views.note} One hypothesis of the inertia, held fixed, is taken as true.",
    )
    return Subject.of(title, motion.time_s, views.timing, linearised)


def _bank_prior(table: InertiaBankTable, start: RelativeStates) -> FloatArray:
    """(n, n) the table's, independent in body terms; of the points nothing is known."""
    sd = np.full(start.size, _POINT_SD_M)
    sd[0:3], sd[3:6] = table.mass_centre_sd_m, table.velocity_sd_m_s
    sd[6:9], sd[9:12] = np.radians(table.attitude_sd_deg), np.radians(table.rate_sd_deg_s)
    to_own = np.linalg.inv(start.to_body_errors())
    return np.asarray((to_own * sd**2) @ to_own.T)
