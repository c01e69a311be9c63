"""The 20-state filter on idealised clouds, and its errors against the truth."""

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from pcnav.config.pipeline_file import Pipeline
from pcnav.core.arrays import FloatArray
from pcnav.core.spatial import exp_rotation, invert_transform, make_transform
from pcnav.dynamics.inertia_parameters import parameter_covariance
from pcnav.dynamics.rigid_body import inertia_from_ratios, is_physical_inertia
from pcnav.dynamics.state import (
    COM_MODEL,
    INERTIA_RATIOS,
    OMEGA_BODY,
    R_HILL,
    STATE_SIZE,
    THETA_BODY,
    V_HILL,
    NavigationState,
    ratio_covariance,
)
from pcnav.estimators.depth.mass_centre import MassCentreModel, RectangleMeasurement
from pcnav.filtering.error_state import ErrorStateFilter
from pcnav.perception.rectangles import RectangleObservation
from pcnav.simulation.motion import TrueMotion, true_motion

from ..blocks import JUDGED
from . import paper
from .clouds import CloudSensor, Sensor, Spacing, resolved
from .extracted import ExtractedSensor

_KNOWN = np.ones(6, dtype=np.bool_)
_STORED = 400
"""Covariances are kept at so many times over a run."""


@dataclass(frozen=True)
class FilterRun:
    """What the filter made of a motion."""

    time_s: FloatArray
    """(n,)"""
    errors: FloatArray
    """(n, 20) error that takes the estimate to the truth."""
    sd: FloatArray
    """(n, 20) as the filter states it."""
    prior_sd: FloatArray
    """(20,)"""
    nees_time_s: FloatArray
    """(m,)"""
    nees: dict[str, FloatArray]
    """(m,) squared normalised error per degree of freedom, by block."""
    flips: int
    """Frames whose measurement went in with a wrong case of the ambiguity."""
    rejected: int
    """Frames whose measurement failed the gate."""
    missed: int
    """Frames in which the rectangle was not found."""

    @property
    def last_third(self) -> FloatArray:
        """(20,) largest error over the last third of the run."""
        n = len(self.time_s)
        return np.asarray(np.abs(self.errors[2 * n // 3 :]).max(axis=0))


def run_filter(
    motion: TrueMotion,
    pipeline: Pipeline,
    model: MassCentreModel,
    seed: int,
    outliers: int | None = None,
) -> FilterRun:
    """Filter even clouds of every frame, starting as the paper does.

    With so many outliers, if any are stated, they go through RANSAC and recognition beside another
    face. Raises ``ValueError`` when the rectangle is not found in the first frame.

    Position and attitude start at the first observation, the velocity and the mass centre's offset
    at zero, the rate and the ratios at the truth plus a draw from their prior. Ratios that no body
    can have are drawn again: the prior of the ratios is what of the paper's is physical.
    """
    clouds = CloudSensor(motion, pipeline.noise.range_sigma_m, Spacing.EVEN, seed)
    sensor = clouds if outliers is None else ExtractedSensor(clouds, outliers, seed)
    kalman, guess = _started(motion, sensor, pipeline, seed)
    time_s = motion.truth.time_s
    n = len(time_s)
    stored = np.unique(np.linspace(0, n - 1, min(_STORED, n)).astype(int))
    errors, sd = np.empty((2, n, STATE_SIZE))
    covariances, flips, rejected, missed = [], 0, 0, 0
    for k in range(n):
        if k > 0:
            kalman.predict(model, float(time_s[k - 1]), float(time_s[k] - time_s[k - 1]))
            guess = _predicted(kalman.state, motion, sensor, k)
        observation = sensor.observe(k)
        missed += int(observation is None)
        if (
            observation is not None and k > 0
        ):  # the first observation is the starting point: it must not count twice
            measurement = _measurement(motion, sensor, k, observation, guess)
            true_R = sensor.true_T_cam_rect(k)[:3, :3]
            # The trace of a rotation by more than a right angle is below 1.
            flips += int(np.sum(true_R * measurement.T_cam_rect[:3, :3]) < 1.0)
            rejected += int(not all(kalman.update([measurement]).accepted))
        errors[k] = kalman.state.ratio_error(motion.state(k))
        covariance = ratio_covariance(kalman.state, kalman.covariance)
        sd[k] = np.sqrt(np.diag(covariance))
        if k in stored:
            covariances.append(covariance)
    P = np.stack(covariances)
    nees = {name: block.squared(errors[stored], P) / block.size for name, block in JUDGED.items()}
    return FilterRun(time_s, errors, sd, sd[0], time_s[stored], nees, flips, rejected, missed)


def model_of(pipeline: Pipeline) -> MassCentreModel:
    """The motion model with the process noise of a pipeline."""
    return MassCentreModel(
        pipeline.orbit.mean_motion_rad_s,
        pipeline.filter.acceleration_psd_m2_s3,
        pipeline.filter.angular_acceleration_psd_rad2_s3,
    )


def disturbed_motion(pipeline: Pipeline, model: MassCentreModel, seed: int) -> TrueMotion:
    """The pipeline's motion with the white disturbances that the filter assumes.

    The mass centre is drawn from the filter's prior, so that the prior is true on average.
    """
    generator = np.random.default_rng(seed)
    calm = true_motion(pipeline)
    draw = paper.PRIOR_SD * generator.standard_normal(STATE_SIZE)
    state = replace(calm.state(0), com_model=draw[COM_MODEL])
    states = [state]
    moving = np.r_[R_HILL, V_HILL, THETA_BODY, OMEGA_BODY]
    root = np.zeros((STATE_SIZE, STATE_SIZE))
    for before, after in pairwise(calm.truth.time_s):
        step_s = float(after - before)
        state, _, noise = model.propagate(state, float(before), step_s)
        if not root.any():
            root[np.ix_(moving, moving)] = np.linalg.cholesky(noise[np.ix_(moving, moving)])
        state = state.retract(root @ generator.standard_normal(STATE_SIZE))
        states.append(state)
    values = {name: np.stack([each.values[name] for each in states]) for name in state.values}
    disturbed = replace(calm.truth, values=values)
    return TrueMotion.of(disturbed, calm.T_cam_world, calm.R_hill_world)


def _started(
    motion: TrueMotion, sensor: Sensor, pipeline: Pipeline, seed: int
) -> tuple[ErrorStateFilter[NavigationState], FloatArray]:
    generator = np.random.default_rng([seed, 1])
    guess = sensor.true_T_cam_rect(0)[:3, :3] @ exp_rotation(np.array(paper.FIRST_GUESS_RAD))
    first = sensor.observe(0)
    if first is None:
        raise ValueError("the rectangle is not found in the first frame")
    T_cam_rect = resolved(first, guess, sensor.rectangle)
    T_world_cam = invert_transform(motion.T_cam_world[0])
    T_cam_model = T_cam_rect @ invert_transform(sensor.rectangle.T_model_rect)
    T_world_model = T_world_cam @ T_cam_model
    truth = motion.state(0)
    draw = paper.PRIOR_SD * generator.standard_normal(STATE_SIZE)
    state = NavigationState(
        r_hill=motion.R_hill_world[0] @ T_world_model[:3, 3],
        v_hill=np.zeros(3),
        com_model=np.zeros(3),
        R_world_body=T_world_model[:3, :3],
        omega_body=truth.omega_body + draw[OMEGA_BODY],
        inertia_ratios=_first_ratios(truth.inertia_ratios, draw[INERTIA_RATIOS], generator),
    )
    covariance = np.diag(paper.PRIOR_SD**2)
    covariance[INERTIA_RATIOS, INERTIA_RATIOS] = parameter_covariance(
        state.inertia_ratios, paper.PRIOR_SD[INERTIA_RATIOS]
    )
    kalman = ErrorStateFilter(
        state,
        covariance,
        gate_probability=pipeline.filter.gate_probability,
        max_iterations=pipeline.filter.iterations,
    )
    return kalman, guess


def _first_ratios(
    true_ratios: FloatArray, draw: FloatArray, generator: np.random.Generator
) -> FloatArray:
    """(5,) the truth plus the draw (5,), drawn again until a body can have the ratios."""
    sd = paper.PRIOR_SD[INERTIA_RATIOS]
    while not is_physical_inertia(inertia_from_ratios(true_ratios + draw)):
        draw = sd * generator.standard_normal(len(sd))
    return np.asarray(true_ratios + draw)


def _predicted(state: NavigationState, motion: TrueMotion, sensor: Sensor, k: int) -> FloatArray:
    """(3, 3) attitude of the rectangle in the camera as the filter expects it: (22)."""
    T_cam_model = state.T_cam_model(motion.T_cam_world[k], motion.R_hill_world[k])
    return np.asarray((T_cam_model @ sensor.rectangle.T_model_rect)[:3, :3])


def _measurement(
    motion: TrueMotion,
    sensor: Sensor,
    k: int,
    observation: RectangleObservation,
    guess: FloatArray,
) -> RectangleMeasurement:
    R_hill_world = motion.R_hill_world[k]
    return RectangleMeasurement(
        T_model_rect=sensor.rectangle.T_model_rect,
        T_cam_rect=resolved(observation, guess, sensor.rectangle),
        known=_KNOWN,
        full_covariance=observation.covariance[:6, :6],
        T_cam_hill=motion.T_cam_world[k] @ make_transform(R_hill_world.T, np.zeros(3)),
        R_hill_world=R_hill_world,
    )
