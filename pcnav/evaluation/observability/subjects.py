"""Trajectories to be judged: of the runs and pipelines of every estimator.

The true motion of a pipeline, or the one that leads to the last estimate of a run, is followed over
the arc and beyond it by the estimator's own model. An arc of many frames is thinned; a frame of the
thinned arc then stands for several.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from pcnav.config.attitude_inertia import AttitudeInertiaTable
from pcnav.config.inertia_bank import InertiaBankTable
from pcnav.config.principal_axes import PrincipalAxesTable
from pcnav.core.arrays import FloatArray, IntArray
from pcnav.core.camera import R_cam_hill
from pcnav.dynamics.inertia_parameters import inertia_of
from pcnav.dynamics.kepler import KeplerOrbit
from pcnav.estimators.attitude_inertia.estimator import initial_belief
from pcnav.estimators.attitude_inertia.rotation_model import (
    THETA,
    AttitudeSet,
    RotationState,
    TorqueFreeModel,
)
from pcnav.estimators.inertia_bank.relative_state import (
    IB_MOTION_SIZE,
    PixelMeasurements,
    RelativeMotion,
    RelativeStates,
    reduced_pixels,
)
from pcnav.estimators.principal_axes.feature_measurements import FeatureView
from pcnav.estimators.principal_axes.feature_states import (
    PA_MOTION_SIZE,
    PrincipalAxesModel,
    PrincipalState,
    ratios_from_moments,
)
from pcnav.evaluation.observability.information import reference_arc
from pcnav.evaluation.observability.report import Subject
from pcnav.evaluation.observability.told import BANK_GROUPS, PRINCIPAL, ROTATION, Told
from pcnav.filtering.batched_filter import Together
from pcnav.filtering.error_state import ManifoldState, Measurement, MotionModel
from pcnav.recordings.tracks import StereoTracks, TrackFrame

S = TypeVar("S", bound=ManifoldState)

_MAX_FRAMES = 150
"""Of an arc; more are thinned out."""
_MAX_TURN_RAD = 0.4
"""Of the target between frames of a thinned arc."""
_MAX_BEYOND = 700
_GROWTH = 0.05
"""Of the time since the start, between frames at most."""
_EXTENSION = 4.0
"""Length of the extended arc over that of the arc."""
_PRIOR_SD = {"position": 10.0, "velocity": 1.0, "attitude": 1.0, "rate": 0.2, "ratios": 0.5}
"""Of what a principal-axes filter begins with: nothing (m, m/s, rad, rad/s, 1)."""
_POINT_SD_M = 3.0


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
    seen = len(times_s)
    if span_s <= 0.0:
        return Timing(times_s[:1], np.ones(1), 1, times_s)
    interval_s = span_s / (seen - 1)
    speed = max(float(np.linalg.norm(omega_body)), 1e-9)
    max_s = max(interval_s, min(span_s / _MAX_FRAMES, _MAX_TURN_RAD / speed))
    past = [0.0]
    while past[-1] < span_s * (1.0 - 1e-9):
        step_s = float(np.clip(_GROWTH * past[-1], interval_s, max_s))
        past.append(min(past[-1] + step_s, span_s))
    frames = len(past)
    most = max(1, min(round((_EXTENSION - 1.0) * span_s / max_s), _MAX_BEYOND))
    past += [span_s + (k + 1) * max_s for k in range(most)]
    steps = np.diff(past, prepend=-interval_s)
    return Timing(start + np.array(past), steps / interval_s, frames, times_s)


def attitude_subject(
    title: str,
    table: AttitudeInertiaTable,
    start: RotationState,
    times_s: FloatArray,
    attitude_covariance: FloatArray | None = None,
) -> Subject[RotationState]:
    """Of attitudes alone, from a state at the first of times (n,) on.

    ``attitude_covariance`` (3, 3), rad^2, replaces the table's.
    """
    timing = timing_of(times_s, start.omega_body)
    model = TorqueFreeModel(table.angular_acceleration_psd_rad2_s3, table.propagation)
    noise = np.radians(table.attitude_sd_deg) ** 2 * np.eye(3)
    noise = noise if attitude_covariance is None else attitude_covariance

    def sensor(state: RotationState, k: int) -> list[Measurement[RotationState]]:
        return [Together(AttitudeSet(state.R_world_body, noise))]

    arc = reference_arc(model, start, timing.times_s, sensor, timing.weights)
    prior = initial_belief(table)[2]
    # What the first attitude alone leaves, many times over: the prior says nothing of attitude.
    prior[THETA, THETA] = 1e4 * noise
    return Subject(
        title=title,
        estimator="attitude_inertia",
        told=ROTATION,
        arc=arc,
        frames=timing.frames,
        frames_seen=len(timing.recorded_s),
        prior_covariance=prior,
        omega_body=arc.states[timing.frames - 1].omega_body,
        inertia=inertia_of(start.parameters),
        note=f"An attitude of {np.degrees(np.sqrt(np.trace(noise) / 3.0)):.3g} deg in every frame.",
    )


def measured_attitudes_subject(
    title: str,
    table: AttitudeInertiaTable,
    start: RotationState,
    times_s: FloatArray,
    noise: FloatArray,
    chained: bool,
) -> Subject[RotationState]:
    """Of attitudes found in frames at times (n,), of covariances (m, 3, 3) with m <= n, rad^2.

    Each is given the geometric mean of the variances. Frames that are not measured are made up for
    by weight. ``chained`` says whether they come from images of one camera.
    """
    typical = float(np.exp(np.mean(np.log(np.trace(noise, axis1=1, axis2=2) / 3.0))))
    share = min(1.0, len(noise) / max(len(times_s) - 1, 1))
    subject = attitude_subject(title, table, start, times_s, typical / share * np.eye(3))
    sd_deg = float(np.degrees(np.sqrt(typical)))
    note = (
        f"An attitude of {sd_deg:.3g} deg about an axis in {share:.0%} of the frames, each with an "
        "error of its own."
    )
    if not chained:
        return replace(subject, note=note)
    note += (
        " Those of a chain of images share the errors of its key frames: together they tell more "
        "of the rate, and less of the attitude."
    )
    return replace(subject, note=note, estimator="image_motion, its attitudes to attitude_inertia")


@dataclass(frozen=True)
class FeatureMotion:
    """A target of feature points at one time."""

    time_s: float
    r_hill: FloatArray
    v_hill: FloatArray
    R_world_body: FloatArray
    omega_body: FloatArray
    inertia: FloatArray
    """(3, 3) of any scale."""
    points: Mapping[int, FloatArray]
    """(3,) by feature, from the mass centre, body axes, m."""


class _Sightings:
    """Which points the frames of a recording saw, and whence; it is repeated beyond its end."""

    def __init__(self, tracks: StereoTracks, timing: Timing, features: tuple[int, ...]) -> None:
        self.tracks, self._timing = tracks, timing
        self._slot = {feature: k for k, feature in enumerate(features)}

    def slots(self, k: int) -> IntArray:
        """(m,) places in the state of the points that frame k sees."""
        frame = self.tracks.frames[self._timing.index(k)]
        found = [self._slot[f] for f in frame.features.tolist() if f in self._slot]
        return np.array(found, dtype=np.intp)

    def R_rig_hill(self, k: int, r_hill: FloatArray) -> FloatArray:
        """(3, 3): as recorded; beyond the recording the rig looks at the target."""
        if k >= self._timing.frames:
            return R_cam_hill(r_hill)
        frame = self.tracks.frames[self._timing.index(k)]
        hill = self.tracks.orbit.R_hill_world(frame.time_s)
        return np.asarray(frame.R_cam_world @ hill.T)

    @property
    def note(self) -> str:
        """What is measured."""
        rig = self.tracks.rig
        return (
            f"Pixels of {rig.pixel_sigma_px:g} px of {len(self._slot)} points, in the frames in "
            "which they were seen; the recording is repeated beyond its end."
        )


def principal_subject(
    title: str, table: PrincipalAxesTable, tracks: StereoTracks, at: FeatureMotion
) -> Subject[PrincipalState]:
    """Of the principal-axes filter, along the motion through a state at the first frame or later.

    The axes of the body are turned into principal ones; features without a point are left out.
    """
    moments, axes = np.linalg.eigh(at.inertia)
    R_body_principal = axes[:, ::-1].copy()
    R_body_principal[:, 2] *= np.sign(np.linalg.det(R_body_principal))
    points = np.stack(list(at.points.values())) @ R_body_principal
    state = PrincipalState(
        R_world_body=at.R_world_body @ R_body_principal,
        omega_body=R_body_principal.T @ at.omega_body,
        ratios=ratios_from_moments(moments[::-1]),
        r_hill=at.r_hill,
        v_hill=at.v_hill,
        points=points,
    )
    model = PrincipalAxesModel(
        tracks.orbit, table.acceleration_psd_m2_s3, table.angular_acceleration_psd_rad2_s3
    )
    timing = timing_of(np.array([frame.time_s for frame in tracks.frames]), state.omega_body)
    sights = _Sightings(tracks, timing, tuple(at.points))

    def sensor(seen: PrincipalState, k: int) -> list[Measurement[PrincipalState]]:
        slots, rig = sights.slots(k), tracks.rig
        hill = tracks.orbit.R_hill_world(float(timing.times_s[k]))
        R_cam_world = sights.R_rig_hill(k, seen.r_hill) @ hill
        p_world = seen.points[slots] @ seen.R_world_body.T + hill.T @ seen.r_hill
        pixels = rig.project(p_world @ R_cam_world.T)
        frame = TrackFrame(float(timing.times_s[k]), R_cam_world, slots, pixels)
        return list(FeatureView(frame, rig, hill, slots).measurements())

    start = carried(model, state, at.time_s, float(timing.times_s[0]))
    arc = reference_arc(model, start, timing.times_s, sensor, timing.weights)
    sd = np.full(PA_MOTION_SIZE + points.size, _POINT_SD_M)
    blocks = (("attitude", 3), ("rate", 3), ("ratios", 2), ("position", 3), ("velocity", 3))
    sd[:PA_MOTION_SIZE] = np.concatenate([np.full(size, _PRIOR_SD[name]) for name, size in blocks])
    return Subject(
        title=title,
        estimator="principal_axes",
        told=PRINCIPAL,
        arc=arc,
        frames=timing.frames,
        frames_seen=len(timing.recorded_s),
        prior_covariance=np.diag(sd**2),
        omega_body=arc.states[timing.frames - 1].omega_body,
        inertia=np.diag(moments[::-1]),
        note=sights.note,
    )


def bank_subject(
    title: str, table: InertiaBankTable, tracks: StereoTracks, at: FeatureMotion
) -> Subject[RelativeStates]:
    """Of one filter of the bank: the one that believes in the inertia given."""
    orbit: KeplerOrbit = tracks.orbit
    points = np.stack(list(at.points.values()))
    state = RelativeStates(
        r_hill=at.r_hill,
        v_hill=at.v_hill,
        R_hill_body=orbit.R_hill_world(at.time_s) @ at.R_world_body,
        omega_body=at.omega_body,
        points_body=points,
        coupled=table.kinematic_coupling,
    )
    model = RelativeMotion(
        orbit,
        at.inertia,
        np.asarray(np.linalg.inv(at.inertia), np.float64),
        table.acceleration_psd_m2_s3,
        table.angular_acceleration_psd_rad2_s3,
    )
    timing = timing_of(np.array([frame.time_s for frame in tracks.frames]), at.omega_body)
    sights = _Sightings(tracks, timing, tuple(at.points))

    def sensor(seen: RelativeStates, k: int) -> list[Measurement[RelativeStates]]:
        slots, R_rig_hill = sights.slots(k), sights.R_rig_hill(k, seen.r_hill)
        if not len(slots):
            return []
        pixels = tracks.rig.project(seen.positions()[slots] @ R_rig_hill.T)
        sight = PixelMeasurements(tracks.rig, R_rig_hill, slots, reduced_pixels(pixels))
        return [Together(sight)]

    start = carried(model, state, at.time_s, float(timing.times_s[0]))
    arc = reference_arc(model, start, timing.times_s, sensor, timing.weights)
    return Subject(
        title=title,
        estimator="inertia_bank",
        told=Told(BANK_GROUPS, _bank_edge),
        arc=arc,
        frames=timing.frames,
        frames_seen=len(timing.recorded_s),
        prior_covariance=_bank_prior(table, start),
        omega_body=arc.states[timing.frames - 1].omega_body,
        inertia=at.inertia,
        note=f"{sights.note} One hypothesis of the inertia, held fixed, is taken as true.",
    )


def _bank_prior(table: InertiaBankTable, start: RelativeStates) -> FloatArray:
    """(n, n) the table's, independent in body terms; of the points nothing is known."""
    sd = np.full(start.size, _POINT_SD_M)
    sd[0:3], sd[3:6] = table.mass_centre_sd_m, table.velocity_sd_m_s
    sd[6:9], sd[9:12] = np.radians(table.attitude_sd_deg), np.radians(table.rate_sd_deg_s)
    to_own = np.linalg.inv(start.to_body_errors())
    return np.asarray((to_own * sd**2) @ to_own.T)


def _bank_edge(state: RelativeStates) -> FloatArray:
    return np.asarray(state.to_body_errors()[:IB_MOTION_SIZE])


def carried(model: MotionModel[S], state: S, from_s: float, to_s: float) -> S:
    """The state at another time of its own motion."""
    return state if from_s == to_s else model.propagate(state, from_s, to_s - from_s)[0]
