"""A target that moves in any way: pose and twist under white accelerations of a learnt level.

For targets that are carried, held, driven, or seen by a camera whose motion nobody stated. Nothing
is learnt of the mass: its centre and inertia stay as they were believed, without a part in the
filter's covariance, and what is reported has the belief's spread (`with_belief`).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from pcnav.config.depth import FilterTable
from pcnav.core.arrays import FloatArray
from pcnav.core.spatial import exp_rotation, left_jacobian, log_rotation, skew
from pcnav.dynamics.mass_prior import MassBelief
from pcnav.dynamics.orbit import hill_transition
from pcnav.dynamics.process_noise import hill_process_noise, white_acceleration_noise
from pcnav.dynamics.state import (
    COM_MODEL,
    INERTIA_RATIOS,
    OMEGA_BODY,
    R_HILL,
    STATE_SIZE,
    THETA_BODY,
    V_HILL,
    NavigationState,
)
from pcnav.estimators.depth.acceleration_levels import AccelerationLevels
from pcnav.estimators.depth.round_axes import InChosenAxes, RoundAxes
from pcnav.filtering.error_state import (
    ErrorStateFilter,
    Measurement,
    MotionModel,
    Snapshot,
    symmetric,
)
from pcnav.filtering.predictive import Surprise, predicted

_POSE_SD_FRACTION, _POSE_SD_RAD = 1.0, 0.5
"""Spread about a first pose, over the diameter and in rad: the frame decides."""
BRIDGED = (0.06, 0.15)
"""Deviation of a pose, over the diameter and in rad, that a comparison still finds home from."""
LINKED = (0.3, 0.5)
"""... that poses found without a prediction are linked over; and how far a target of which one pose
is known may have moved in the next frame."""
_LINEAR_RAD = 0.01
_LOST_FRACTION, _LOST_RAD = 1.0, 1.0
"""A pose that uncertain is no pose any more."""


@dataclass(frozen=True)
class KinematicModel(MotionModel[NavigationState]):
    """Pose and twist go on as they are, but for white accelerations; Hill's orbit aside."""

    mean_motion_rad_s: float
    acceleration_psd_m2_s3: float = 0.0
    angular_acceleration_psd_rad2_s3: float = 0.0

    def propagate(
        self, state: NavigationState, time_s: float, step_s: float
    ) -> tuple[NavigationState, FloatArray, FloatArray]:
        """See `MotionModel.propagate`. The model does not depend on ``time_s``."""
        orbit = hill_transition(self.mean_motion_rad_s, step_s)
        relative = orbit @ np.concatenate([state.r_hill, state.v_hill])
        # A rate that is constant in the world is so in the body that turns with it.
        turn = state.omega_body * step_s
        R_before_after = exp_rotation(turn)
        transition = np.eye(STATE_SIZE)
        transition[:6, :6] = orbit
        transition[THETA_BODY, THETA_BODY] = R_before_after.T
        transition[THETA_BODY, OMEGA_BODY] = left_jacobian(-turn) * step_s
        moved = replace(
            state,
            r_hill=relative[:3],
            v_hill=relative[3:],
            R_world_body=state.R_world_body @ R_before_after,
        )
        return moved, transition, self.noise(step_s)

    def noise(self, step_s: float) -> FloatArray:
        """(20, 20) what the accelerations add in a step."""
        by_translation, by_rotation = noise_by_density(self.mean_motion_rad_s, step_s)
        return np.asarray(
            self.acceleration_psd_m2_s3 * by_translation
            + self.angular_acceleration_psd_rad2_s3 * by_rotation
        )


def noise_by_density(mean_motion_rad_s: float, step_s: float) -> tuple[FloatArray, FloatArray]:
    """(20, 20) each: what accelerations of density one add in a step, translation and rotation."""
    by_translation, by_rotation = np.zeros((2, STATE_SIZE, STATE_SIZE))
    by_translation[:6, :6] = hill_process_noise(mean_motion_rad_s, step_s, 1.0)
    by_rotation[9:15, 9:15] = white_acceleration_noise(1.0, step_s)
    return by_translation, by_rotation


class KinematicFilter:
    """The filter of a target that moves in any way, and the level of its accelerations."""

    def __init__(
        self,
        state: NavigationState,
        mean_motion_rad_s: float,
        diameter_m: float,
        table: FilterTable,
        axes: RoundAxes | None = None,
    ) -> None:
        """At a pose that the next measurement decides; the rates of the state are a guess.

        ``axes`` are those of a round target.
        """
        self._n, self._diameter_m = mean_motion_rad_s, diameter_m
        self._model: MotionModel[NavigationState] = KinematicModel(mean_motion_rad_s)
        if axes is not None:
            self._model = InChosenAxes(self._model, axes)
        sd = np.zeros(STATE_SIZE)
        sd[R_HILL], sd[THETA_BODY] = _POSE_SD_FRACTION * diameter_m, _POSE_SD_RAD
        self.kalman = ErrorStateFilter(
            state,
            np.diag(sd**2) if axes is None else axes.prior(np.diag(sd**2)),
            gate_probability=table.gate_probability,
            max_iterations=table.iterations,
        )
        self._levels: AccelerationLevels | None = None
        self._twist_is_known = False
        self._before = self.kalman.snapshot()
        self._unforced = self.kalman.covariance.copy()
        self._by_density: tuple[FloatArray, FloatArray] | None = None

    def suggest(self, densities: FloatArray, step_s: float) -> None:
        """Begin about accelerations of densities (2,), in frames about ``step_s`` apart."""
        self._levels = AccelerationLevels(self._diameter_m, step_s)
        self._levels.suggest(densities)

    def predict(self, time_s: float, step_s: float) -> None:
        """Move forward by ``step_s`` from ``time_s`` under the accelerations learnt so far."""
        if self._levels is None:
            self._levels = AccelerationLevels(self._diameter_m, step_s)
        if not self._twist_is_known:
            self._open_twist(step_s)
        self.kalman.predict(self._model, time_s, step_s)
        self._by_density = noise_by_density(self._n, step_s)
        self._unforced = self.kalman.covariance.copy()
        self._force(self.densities)

    def learn(self, measurements: Sequence[Measurement[NavigationState]]) -> Surprise:
        """Take in how far measurements lie from the prediction; how surprising they were before.

        The filter is left as predicted, under what has now been learnt.
        """
        at = predicted(self._before.state, measurements)
        surprise = at.surprise(self._before.covariance)
        if self._by_density is not None and self._levels is not None:
            H = at.jacobian
            added = tuple(H @ noise @ H.T for noise in self._by_density)
            self._levels.learn(at.innovation, at.spread(self._unforced), added)
            self.reset()
        return surprise

    def widen(self, step: tuple[float, float] = BRIDGED) -> None:
        """Go back to the prediction, as if a jolt had moved the target by so much since the frame
        before: deviations over the diameter and in rad."""
        if self._by_density is None:
            return
        by_translation, by_rotation = self._by_density
        # What has moved the target so far has changed its twist as well.
        place, turn = (step[0] * self._diameter_m) ** 2, step[1] ** 2
        densities = np.array([place / by_translation[0, 0], turn / by_rotation[9, 9]])
        self.kalman.restore(self._before)
        self._force(np.maximum(densities, self.densities))

    def reset(self) -> None:
        """Go back to the prediction under the accelerations learnt."""
        self.kalman.restore(self._before)
        if self._by_density is not None:
            self._force(self.densities)

    def take_in(self, measurements: Sequence[Measurement[NavigationState]]) -> None:
        """Update with measurements that another filter found the way to.

        What the level learnt cannot explain is taken for a jolt; what no jolt explains is left out.
        """
        # A turn that is known to half a degree is as good as linear.
        turn = float(np.sqrt(np.max(np.diag(self.kalman.covariance)[THETA_BODY])))
        once = 1 if turn < _LINEAR_RAD else None
        if not any(self.kalman.update(measurements, max_iterations=once).accepted):
            self.widen()
            self.kalman.update(measurements)

    def believe(self, belief: MassBelief, R_hill_world: FloatArray) -> None:
        """Be told of another mass: position and velocity are those of its centre from now on."""

        def told(state: NavigationState, covariance: FloatArray) -> Snapshot[NavigationState]:
            by_error = _mass_jacobian(state, belief, R_hill_world)
            moved = with_mass(state, belief, R_hill_world)
            return Snapshot(moved, symmetric(by_error @ covariance @ by_error.T))

        unforced = told(self._before.state, self._unforced)
        self._before = told(self._before.state, self._before.covariance)
        self._unforced = unforced.covariance
        self.kalman.restore(told(self.kalman.state, self.kalman.covariance))

    @property
    def is_lost(self) -> bool:
        """Whether so little is known of the pose that there is none."""
        variance = np.diag(self.kalman.covariance)
        place = float(np.sqrt(np.max(variance[R_HILL])))
        turn = float(np.sqrt(np.max(variance[THETA_BODY])))
        return place > _LOST_FRACTION * self._diameter_m or turn > _LOST_RAD

    @property
    def densities(self) -> FloatArray:
        """(2,) power spectral densities learnt: m^2/s^3 and rad^2/s^3; zero before any step."""
        return np.zeros(2) if self._levels is None else self._levels.densities

    def _force(self, densities: FloatArray) -> None:
        assert self._by_density is not None, "there was a prediction"
        by_translation, by_rotation = self._by_density
        covariance = self._unforced + densities[0] * by_translation + densities[1] * by_rotation
        self._before = Snapshot(self.kalman.state, symmetric(covariance))
        self.kalman.restore(self._before)

    def _open_twist(self, step_s: float) -> None:
        sd = np.array([LINKED[0] * self._diameter_m, LINKED[1]]) / step_s
        covariance = self.kalman.covariance.copy()
        for block, deviation in ((V_HILL, sd[0]), (OMEGA_BODY, sd[1])):
            covariance[block] = covariance[:, block] = 0.0
            covariance[block, block] = deviation**2 * np.eye(3)
        self.kalman.restore(Snapshot(self.kalman.state, covariance))
        self._twist_is_known = True


def densities_through(times_s: FloatArray, states: Sequence[NavigationState]) -> FloatArray | None:
    """(2,) densities of the accelerations, by how much the mean twists of successive steps differ.

    Of the states' poses at times (n,); None for fewer than three. A mean rate over a step differs
    from that over the next by the variance ``q (dt_1 + dt_2) / 3``. The noise of the poses is not
    taken off.
    """
    if len(states) < 3:
        return None
    steps = np.diff(times_s)[:, None]
    place = np.array([state.r_hill - state.R_world_body @ state.com_model for state in states])
    turns = [log_rotation(a.R_world_body.T @ b.R_world_body) for a, b in pairwise(states)]
    twists = np.stack([np.diff(place, axis=0) / steps, np.array(turns) / steps])
    squares = np.sum(np.diff(twists, axis=1) ** 2, axis=-1) / (steps[:-1, 0] + steps[1:, 0])
    return np.asarray(squares.mean(axis=1))


def with_mass(
    state: NavigationState, belief: MassBelief, R_hill_world: FloatArray
) -> NavigationState:
    """The same pose and twist of the model's frame, told of another mass centre and inertia."""
    R_hill_body = R_hill_world @ state.R_world_body
    shift = belief.com_model - state.com_model
    # The Hill frame's own turn is far slower than any rate that matters here.
    return replace(
        state,
        r_hill=state.r_hill + R_hill_body @ shift,
        v_hill=state.v_hill + R_hill_body @ np.cross(state.omega_body, shift),
        com_model=belief.com_model,
        inertia_ratios=belief.inertia_ratios,
    )


def _mass_jacobian(
    state: NavigationState, belief: MassBelief, R_hill_world: FloatArray
) -> FloatArray:
    """(20, 20) derivative of `with_mass` by the error of the state, whose mass has none."""
    R_hill_body = R_hill_world @ state.R_world_body
    shift = belief.com_model - state.com_model
    jacobian = np.eye(STATE_SIZE)
    jacobian[R_HILL, THETA_BODY] = jacobian[V_HILL, OMEGA_BODY] = -R_hill_body @ skew(shift)
    jacobian[V_HILL, THETA_BODY] = -R_hill_body @ skew(np.cross(state.omega_body, shift))
    return jacobian


def with_belief(
    state: NavigationState, covariance: FloatArray, belief: MassBelief, R_hill_world: FloatArray
) -> FloatArray:
    """(20, 20) a kinematic filter's covariance with the doubt about the mass it was told.

    The camera sees the model's origin: ``r = p + R com`` and ``v = p' + R (omega x com)``, so an
    error of the mass centre is one of position and velocity, and none of the pose.
    """
    R_hill_body = R_hill_world @ state.R_world_body
    by_com = np.zeros((STATE_SIZE, 3))
    by_com[R_HILL] = R_hill_body
    by_com[V_HILL] = R_hill_body @ skew(state.omega_body)
    by_com[COM_MODEL] = np.eye(3)
    total = covariance + by_com @ belief.com_covariance_m2 @ by_com.T
    total[INERTIA_RATIOS, INERTIA_RATIOS] += belief.parameter_covariance
    return np.asarray(0.5 * (total + total.T))
