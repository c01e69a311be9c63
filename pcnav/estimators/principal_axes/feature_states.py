"""State and motion of Hu 2024's filter: a target without a model, seen as points.

The body frame is a principal one, so the inertia is given by the ratios (19)

    p_x = (Iy - Iz) / Ix,    p_y = (Iz - Ix) / Iy,    p_z = (Ix - Iy) / Iz,

which obey ``p_x + p_y + p_z + p_x p_y p_z = 0``. Print carries all three; here p_x and p_z are the
parameters and p_y follows, so the covariance cannot claim a third degree of freedom. The error
state has 14 + 3N components where print has 15 + 3N. Its order is that of (26).

The errors differ from print in one more respect. Features show how the points move; where the
principal axes lie in them is shown by the dynamics alone, and slowly. So the attitude error
``theta`` turns the axes under points that stay where they are:

    R = R_hat exp(theta),  f_i = exp(-theta) (f_i_hat + e_i),  omega = exp(-theta) (omega_hat + e_w)

to first order (beyond it see `pcnav.dynamics.principal_inertia` and `PrincipalState._turn_of`)
and no measurement of points depends on it. With errors that simply add, a turn of the axes is a
combination of all errors that depends on the estimate; a filter that linearises about one estimate
after the other then sees information on the axes that no frame gives (Huang, Mourikis and
Roumeliotis 2010, on the same effect in mapping).
"""

from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np

from pcnav.core.arrays import FloatArray
from pcnav.core.spatial import exp_rotation, left_jacobian, skew
from pcnav.dynamics.blocks import ATTITUDE, POSITION, RATE, VELOCITY, Block, Layout
from pcnav.dynamics.kepler import KeplerOrbit, step_relative
from pcnav.dynamics.orbit import hill_transition
from pcnav.dynamics.principal_inertia import (
    MAX_RATIO,
    axes_error,
    moments_from_ratios,
    move_axes,
    transport,
)
from pcnav.dynamics.principal_inertia import ratios_from_moments as ratios_from_moments
from pcnav.dynamics.process_noise import hill_process_noise, white_acceleration_noise
from pcnav.dynamics.rotation_step import Rotation, rotate
from pcnav.filtering.error_state import MotionModel

_P = ("p_x", "p_z")
PRINCIPAL_RATIOS = Block(
    *("principal_ratios", "principal_ratios", "ratios of the principal moments", "1", "1"),
    *(_P, _P, _P, True),
)
PRINCIPAL_LAYOUT = Layout((ATTITUDE, RATE, PRINCIPAL_RATIOS, POSITION, VELOCITY))
"""The error state before the points."""
PA_THETA, PA_OMEGA, PA_RATIOS, PA_R_HILL, PA_V_HILL = PRINCIPAL_LAYOUT.slices
PA_MOTION_SIZE = PRINCIPAL_LAYOUT.size

_INERTIA = np.r_[0:3, 6:8]
"""Attitude and ratios, which err together: see `pcnav.dynamics.principal_inertia`."""
_STRAIGHT_RAD = 3e-5
"""Turns below this bend a point at 2 m by less than a nanometre."""
_TURN_STEPS = 30
_MAX_TURN_RAD = 0.05
"""Rotation in one Runge-Kutta step: its error, of order turn^5 / 120, stays below 3e-9 rad."""


def point_slice(slot: int) -> slice:
    """Where the point at a place of the state lies in the error state."""
    return slice(PA_MOTION_SIZE + 3 * slot, PA_MOTION_SIZE + 3 * slot + 3)


@dataclass(frozen=True)
class PrincipalState:
    """Relative motion of the target, its inertia ratios and its points, principal axes."""

    R_world_body: FloatArray
    """(3, 3)"""
    omega_body: FloatArray
    """(3,) inertial rate, body axes, rad/s."""
    ratios: FloatArray
    """(2,) p_x and p_z."""
    r_hill: FloatArray
    """(3,) mass centre from the chaser's, Hill axes, m."""
    v_hill: FloatArray
    """(3,) its rate of change in Hill axes, m/s."""
    points: FloatArray
    """(N, 3) from the mass centre, body axes, m."""

    def retract(self, error: FloatArray) -> "PrincipalState":
        """The state moved by a (14 + 3N,) error; see the module and `_turn_of`."""
        if not error.any():
            return self
        axes, ratios = move_axes(self.ratios, error[PA_THETA], error[PA_RATIOS])
        turn = axes
        e = error[PA_MOTION_SIZE:].reshape(-1, 3)
        omega, points = self.omega_body + error[PA_OMEGA], self.points + e
        psi = self._turn_of(e)
        if float(psi @ psi) > _STRAIGHT_RAD**2:
            K = skew(psi)
            omega, points = omega - K @ self.omega_body, points + self.points @ K
            turn = exp_rotation(-psi) @ axes
        return PrincipalState(
            R_world_body=self.R_world_body @ axes,
            omega_body=omega @ turn,
            ratios=ratios,
            r_hill=self.r_hill + error[PA_R_HILL],
            v_hill=self.v_hill + error[PA_V_HILL],
            points=points @ turn,
        )

    @property
    def size(self) -> int:
        """Of the error."""
        return PA_MOTION_SIZE + 3 * len(self.points)

    @property
    def curved(self) -> slice:
        """See `ManifoldState`: all of it."""
        return slice(0, self.size)

    def retraction_block(self, error: FloatArray) -> FloatArray:
        """(n, n) See `ManifoldState`."""
        jacobian = np.eye(len(error))
        if not error.any():
            return jacobian
        axes, ratios = move_axes(self.ratios, error[PA_THETA], error[PA_RATIOS])
        jacobian[np.ix_(_INERTIA, _INERTIA)] = transport(self.ratios, axes, ratios)
        back = axes.T
        e = error[PA_MOTION_SIZE:].reshape(-1, 3)
        psi = self._turn_of(e)
        bent = float(psi @ psi) > _STRAIGHT_RAD**2
        if bent:
            # exp(psi) (v + e - psi x v) moves by exp(psi) de, and with psi by the bends.
            E, J, K = exp_rotation(psi), left_jacobian(psi), skew(psi)
            start = np.vstack([self.omega_body, self.points])
            moved = start + np.vstack([error[PA_OMEGA], e]) + start @ K
            by_points = self._turn_by_points()
            bends = back @ (E @ skew(start) - skew(moved @ E.T) @ J) @ by_points
            back = back @ E
        jacobian[PA_OMEGA, PA_OMEGA] = back
        for first in range(PA_MOTION_SIZE, len(error), 3):
            jacobian[first : first + 3, first : first + 3] = back
        if bent:
            jacobian[PA_OMEGA, PA_MOTION_SIZE:] += bends[0]
            jacobian[PA_MOTION_SIZE:, PA_MOTION_SIZE:] += bends[1:].reshape(-1, by_points.shape[1])
        return jacobian

    def local(self, other: "PrincipalState") -> FloatArray:
        """(n,) the error that takes this state to another with the same points."""
        axes, psi = self.R_world_body.T @ other.R_world_body, np.zeros(3)
        theta, change = axes_error(self.ratios, axes, other.ratios)
        points = other.points @ axes.T
        for _ in range(_TURN_STEPS):
            psi = psi + self._turn_of(points @ exp_rotation(psi) - self.points)
        back, K = exp_rotation(-psi), skew(psi)
        omega = back @ axes @ other.omega_body
        return np.concatenate(
            [
                theta,
                omega - self.omega_body + K @ self.omega_body,
                change,
                other.r_hill - self.r_hill,
                other.v_hill - self.v_hill,
                (points @ back.T - self.points - self.points @ K).ravel(),
            ]
        )

    def additive(self) -> FloatArray:
        """(n, n) derivative of plain differences of attitude, rate and points by the error.

        The attitude's is its rotation vector in body axes, the others are differences of
        components: what results and tables are in.
        """
        change = np.eye(self.size)
        change[PA_OMEGA, PA_THETA] = skew(self.omega_body)
        change[PA_MOTION_SIZE:, PA_THETA] = skew(self.points).reshape(-1, 3)
        return change

    def _turn_of(self, e: FloatArray) -> FloatArray:
        """(3,) the rotation that errors (N, 3) of the points amount to beside a common shift.

        After a time without features the points err mostly by one common turn, and the rate with
        them; a turn is no straight line. So the common turn in the errors is applied as a turn to
        points and rate, after what is left of their errors was added: that of the shape, and the
        shift that an error of the mass centre is.
        """
        moments = self._centred.T @ e
        torque = np.array(
            [
                moments[1, 2] - moments[2, 1],
                moments[2, 0] - moments[0, 2],
                moments[0, 1] - moments[1, 0],
            ]
        )
        return np.asarray(self._inverse_spread @ torque)

    @cached_property
    def _centred(self) -> FloatArray:
        return np.asarray(self.points - self.points.mean(axis=0))

    @cached_property
    def _inverse_spread(self) -> FloatArray:
        """(3, 3) inverse of ``sum of |f|^2 1 - f f^T`` about the middle, regular for a line."""
        squares = self._centred.T @ self._centred
        spread = (float(np.trace(squares)) + 1e-9) * np.eye(3) - squares
        return np.asarray(np.linalg.inv(spread), np.float64)

    def _turn_by_points(self) -> FloatArray:
        """(3, 3N) derivative of `_turn_of`."""
        crosses = np.concatenate(list(skew(self._centred)), axis=1)
        return np.asarray(self._inverse_spread @ crosses)

    def admissible(self, error: FloatArray, covariance: FloatArray) -> FloatArray:
        """(n,) the error that leads to ratios a body can have, everything else following suit.

        The triangle inequality of the moments is ``|p| <= 1`` for all three ratios, and p_x and p_z
        imply p_y.
        """
        for k in (PA_RATIOS.start, PA_RATIOS.start + 1, PA_RATIOS.start):
            value = self.ratios[k - PA_RATIOS.start] + error[k]
            excess = value - np.clip(value, -MAX_RATIO, MAX_RATIO)
            if excess != 0.0:
                error = error - covariance[:, k] * (excess / covariance[k, k])
        return error


@dataclass(frozen=True)
class PrincipalAxesModel(MotionModel[PrincipalState]):
    """Torque-free rotation (21) and the chaser's relative orbit (4).

    The disturbance torque is the same about all axes; J of (22) makes it an angular acceleration.
    On an eccentric orbit the linear Hill equations give way to two point masses.
    """

    orbit: KeplerOrbit
    acceleration_psd_m2_s3: float
    angular_acceleration_psd_rad2_s3: float
    """About the body's x axis."""

    def propagate(
        self, state: PrincipalState, time_s: float, step_s: float
    ) -> tuple[PrincipalState, FloatArray, FloatArray]:
        """See `MotionModel.propagate`."""
        size = state.size
        rotation = propagate_rotation(state.omega_body, state.ratios, step_s)
        # From errors as they are defined here to plain differences, over the step, and back.
        to_plain = rotation.transition
        to_plain[:, PA_THETA] += to_plain[:, PA_OMEGA] @ skew(state.omega_body)
        from_plain = np.zeros((size, 6))
        from_plain[PA_THETA, PA_THETA] = from_plain[PA_OMEGA, PA_OMEGA] = np.eye(3)
        from_plain[PA_OMEGA, PA_THETA] = -skew(rotation.omega_body)
        from_plain[PA_MOTION_SIZE:, PA_THETA] = -skew(state.points).reshape(-1, 3)
        transition = np.eye(size)
        transition[:, :8] = from_plain @ to_plain[:6]
        transition[PA_RATIOS, PA_RATIOS] += np.eye(2)
        transition[PA_MOTION_SIZE:, PA_THETA] -= from_plain[PA_MOTION_SIZE:, PA_THETA]
        r, v, transition[8:14, 8:14] = self._orbit_step(state, time_s, step_s)
        moved = replace(
            state,
            R_world_body=state.R_world_body @ rotation.turn,
            omega_body=rotation.omega_body,
            r_hill=r,
            v_hill=v,
        )
        # (39): the same torque about all axes, for steps in which the body turns little.
        torque = 1.0 / moments_from_ratios(state.ratios) ** 2
        q = self.angular_acceleration_psd_rad2_s3 * torque
        noise = from_plain @ white_acceleration_noise(q, step_s) @ from_plain.T
        noise[8:14, 8:14] = hill_process_noise(
            self.orbit.mean_motion_rad_s, step_s, self.acceleration_psd_m2_s3
        )
        return moved, transition, noise

    def _orbit_step(
        self, state: PrincipalState, time_s: float, step_s: float
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        if self.orbit.eccentricity > 0.0:
            return step_relative(self.orbit, state.r_hill, state.v_hill, time_s, step_s)
        hill = hill_transition(self.orbit.mean_motion_rad_s, step_s)
        moved = hill @ np.concatenate([state.r_hill, state.v_hill])
        return moved[:3], moved[3:], hill


def propagate_rotation(omega: FloatArray, ratios: FloatArray, duration_s: float) -> Rotation:
    """Torque-free rotation over a time, of rate (3,) and ratios (2,), with derivatives by both."""
    return rotate(partial(_slope, ratios), omega, duration_s, 5, _MAX_TURN_RAD)


def _slope(ratios: FloatArray, rates: FloatArray) -> FloatArray:
    """(3, 6) time derivative of the rate (21) and of its derivatives: M and N of (30)."""
    x, y, z = rates[:, 0].tolist()
    px, pz = ratios.tolist()
    scale = 1.0 / (1.0 + px * pz)
    py = -(px + pz) * scale
    M = np.array([[0.0, px * z, px * y], [py * z, 0.0, py * x], [pz * y, pz * x, 0.0]])
    slope = M @ rates
    # M holds every product twice, once for either factor.
    slope[:, 0] *= 0.5
    slope[0, 4] += y * z
    slope[1, 4] -= (1.0 - pz * pz) * scale * scale * x * z
    slope[1, 5] -= (1.0 - px * px) * scale * scale * x * z
    slope[2, 5] += x * y
    return slope
