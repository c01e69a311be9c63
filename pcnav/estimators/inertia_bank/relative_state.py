"""The 13 + 3N states of Segal 2011, one or many at once: relative orbit, attitude, rate and points.

The nominal state is the paper's: mass centre and its velocity in Hill axes, attitude, angular rate,
and N feature points fixed in the body. The rate kept is the inertial one in body axes instead of
the relative one in Hill axes, ``D w - w_C`` (16e): one motion in two
descriptions. Derived afresh, (19) is Euler's equation seen from the chaser; its brackets are
damaged in print.

Kinematic coupling (25) is ``rho_i'' = rho_0'' + w' x P_i + w x (w x P_i)``, with the lever arm from
the mass centre (the print has rho_i). It is the second derivative of ``rho_i = rho_0 + D P_i`` (2)
for a point fixed in the body, so it holds no physics that (2) lacks: a filter that measures through
(2) is coupled already. What can change is what the filter's errors are, that is, about what it is
linear. Here ``coupled`` means that errors are those of what images show: of the positions rho_i in
Hill axes, carried in time by (25), and of the field of velocities ``nu + w x rho`` that all points
of the target share, with ``nu = v - w x r`` and w in Hill axes. Without it they are those of the
paper's state without (25), that of (22)-(24) with the points: v, w in Hill axes, and P_i in the
body. The mass centre and the attitude of the body axes are known badly for long; in coupled errors
neither has a part in what is seen and how it moves, at any state, while in the others their errors
multiply those of rates and points, and a filter that drops the products becomes overconfident.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import block_diag

from pcnav.core.arrays import FloatArray, IntArray, picked
from pcnav.core.spatial import exp_rotation, left_jacobian, log_rotation, skew
from pcnav.core.stereo import StereoRig
from pcnav.dynamics.blocks import ATTITUDE, POSITION, RATE, VELOCITY, Layout
from pcnav.dynamics.kepler import KeplerOrbit, step_relative
from pcnav.dynamics.process_noise import white_acceleration_noise
from pcnav.dynamics.rotation_step import rotate, torque_free

RELATIVE_LAYOUT = Layout((POSITION, VELOCITY, ATTITUDE, RATE))
"""Errors before the points: r, v (coupled: nu), attitude (body axes, right), rate."""
IB_R_HILL, IB_V_HILL, IB_THETA, IB_OMEGA = RELATIVE_LAYOUT.slices
IB_MOTION_SIZE = RELATIVE_LAYOUT.size
IB_MOTION = slice(0, IB_MOTION_SIZE)


@dataclass(frozen=True)
class RelativeStates:
    """A target with N points, or B of them. Errors (..., 12 + 3N): r, v, theta, omega, points."""

    r_hill: FloatArray
    """(..., 3) mass centre from the chaser's, m."""
    v_hill: FloatArray
    """(..., 3) its rate of change in Hill axes, m/s."""
    R_hill_body: FloatArray
    """(..., 3, 3) D(q) of the paper, in the axes of DESIGN."""
    omega_body: FloatArray
    """(..., 3) inertial angular velocity, body axes, rad/s."""
    points_body: FloatArray
    """(..., N, 3) from the mass centre, m."""
    coupled: bool
    """Whether errors are those of the field of velocities and of positions; see above."""

    @property
    def size(self) -> int:
        """Of the error."""
        return IB_MOTION_SIZE + 3 * int(self.points_body.shape[-2])

    @property
    def curved(self) -> slice:
        """See `ManifoldState`."""
        return slice(IB_THETA.start, IB_OMEGA.stop)

    def positions(self) -> FloatArray:
        """(..., N, 3) the points from the chaser, rho_i of (2), Hill axes, m."""
        turned = self.points_body @ np.swapaxes(self.R_hill_body, -1, -2)
        return np.asarray(self.r_hill[..., None, :] + turned)

    def retract(self, error: FloatArray) -> "RelativeStates":
        """The states moved by errors (..., 12 + 3N)."""
        by_points = error[..., IB_MOTION_SIZE:].reshape(self.points_body.shape)
        r = self.r_hill + error[..., IB_R_HILL]
        turn = exp_rotation(error[..., IB_THETA])
        R = self.R_hill_body @ turn
        omega = self.omega_body + error[..., IB_OMEGA]
        v = self.v_hill + error[..., IB_V_HILL]
        if self.coupled:
            before, after = self._in_hill(self.omega_body), self._in_hill(omega)
            v = v - np.cross(before, self.r_hill) + np.cross(after, r)
            points = (self.positions() + by_points - r[..., None, :]) @ R
        else:
            points = self.points_body + by_points
        # The rate keeps what it is in Hill axes, whatever the attitude does.
        omega = (omega[..., None, :] @ turn)[..., 0, :]
        return RelativeStates(r, v, R, omega, points, self.coupled)

    def retraction_block(self, error: FloatArray) -> FloatArray:
        """See `ManifoldState`: of attitude and rate; the others add, whatever the attitude does."""
        block = np.zeros((*error.shape[:-1], 6, 6))
        block[..., :3, :3] = left_jacobian(-error[..., IB_THETA])
        block[..., 3:, 3:] = exp_rotation(-error[..., IB_THETA])
        return block

    def admissible(self, error: FloatArray, covariance: FloatArray) -> FloatArray:
        """The errors as they are: every such state can be."""
        return error

    def local(self, other: "RelativeStates") -> FloatArray:
        """(..., 12 + 3N) the errors that take these states to others: the inverse of `retract`."""
        relative = np.swapaxes(self.R_hill_body, -1, -2) @ other.R_hill_body
        omega = (relative @ other.omega_body[..., None])[..., 0]
        v = other.v_hill - self.v_hill
        if self.coupled:
            v = v - np.cross(self._in_hill(omega), other.r_hill)
            v = v + np.cross(self._in_hill(self.omega_body), self.r_hill)
            points = other.positions() - self.positions()
        else:
            points = other.points_body - self.points_body
        return np.concatenate(
            [
                other.r_hill - self.r_hill,
                v,
                log_rotation(relative),
                omega - self.omega_body,
                points.reshape(*points.shape[:-2], -1),
            ],
            axis=-1,
        )

    def motion_to_body_errors(self) -> FloatArray:
        """(..., 12, 12) matrix from this state's errors of the motion to plain ones in body axes.

        ``d omega = e + [omega]x theta`` with e the error of the rate in Hill axes, along the
        estimated body axes. Coupled: ``dv = d nu + [w]x dr - [r]x D e`` with ``w = D omega``.
        """
        matrix = self._identity(IB_MOTION_SIZE)
        matrix[..., IB_OMEGA, IB_THETA] = skew(self.omega_body)
        if self.coupled:
            matrix[..., IB_V_HILL, IB_R_HILL] = skew(self._in_hill(self.omega_body))
            matrix[..., IB_V_HILL, IB_OMEGA] = -skew(self.r_hill) @ self.R_hill_body
        return matrix

    def motion_from_body_errors(self) -> FloatArray:
        """(..., 12, 12) the inverse of `motion_to_body_errors`."""
        return np.asarray(np.linalg.inv(self.motion_to_body_errors()), np.float64)

    def to_body_errors(self) -> FloatArray:
        """(..., n, n) as `motion_to_body_errors`, with the points.

        Coupled: ``dP = D^T (eta - dr) + [P]x theta`` with eta the error of a position.
        """
        matrix = self._identity(self.size)
        matrix[..., IB_MOTION, IB_MOTION] = self.motion_to_body_errors()
        if not self.coupled:
            return matrix
        R_body_hill = np.swapaxes(self.R_hill_body, -1, -2)
        for i in range(self.points_body.shape[-2]):
            rows = point_slice(i)
            matrix[..., rows, IB_R_HILL] = -R_body_hill
            matrix[..., rows, IB_THETA] = skew(self.points_body[..., i, :])
            matrix[..., rows, rows] = R_body_hill
        return matrix

    def _identity(self, size: int) -> FloatArray:
        """(..., n, n), to be written to."""
        identity = np.zeros((*self.r_hill.shape[:-1], size, size))
        identity[...] = np.eye(size)
        return identity

    def _in_hill(self, body: FloatArray) -> FloatArray:
        """(..., 3) vectors in estimated body axes, turned into Hill axes."""
        return np.asarray((self.R_hill_body @ body[..., None])[..., 0])

    def with_points(self, points_body: FloatArray) -> "RelativeStates":
        """With other points (..., N, 3)."""
        return replace(self, points_body=points_body)


def point_slice(i: int) -> slice:
    """Where point i is in the error."""
    return slice(IB_MOTION_SIZE + 3 * i, IB_MOTION_SIZE + 3 * i + 3)


@dataclass(frozen=True)
class RelativeMotion:
    """Nonlinear relative orbit and torque-free rotation of bodies; points stay where they are."""

    orbit: KeplerOrbit
    inertia: FloatArray
    """(..., 3, 3) body axes, of any scale."""
    inverse: FloatArray
    """(..., 3, 3) of the inertia."""
    acceleration_psd_m2_s3: float
    angular_acceleration_psd_rad2_s3: float

    def propagate(
        self, states: RelativeStates, time_s: float, step_s: float
    ) -> tuple[RelativeStates, FloatArray, FloatArray]:
        """See `MotionModel.propagate`."""
        orbit = self.orbit
        r, v, relative = step_relative(orbit, states.r_hill, states.v_hill, time_s, step_s)
        step = rotate(torque_free(self.inertia, self.inverse), states.omega_body, step_s)
        R_hill1_hill0 = orbit.R_hill_world(time_s + step_s) @ orbit.R_hill_world(time_s).T
        moved = RelativeStates(
            r_hill=r,
            v_hill=v,
            R_hill_body=R_hill1_hill0 @ states.R_hill_body @ step.turn,
            omega_body=step.omega_body,
            points_body=states.points_body,
            coupled=states.coupled,
        )
        F = states._identity(states.size)
        F[..., :6, :6] = relative
        F[..., 6:12, 6:12] = step.transition
        noise = self._motion_noise(abs(step_s))
        own = moved.motion_from_body_errors()
        F[..., IB_MOTION, IB_MOTION] = (
            own @ F[..., IB_MOTION, IB_MOTION] @ states.motion_to_body_errors()
        )
        if not states.coupled:
            Q = np.zeros_like(F)
            Q[..., IB_MOTION, IB_MOTION] = own @ noise @ np.swapaxes(own, -1, -2)
            return moved, F, Q
        _couple(F, states, moved)
        by_motion = _errors_by_motion(moved)
        return moved, F, by_motion @ noise @ np.swapaxes(by_motion, -1, -2)

    def _motion_noise(self, step_s: float) -> FloatArray:
        """(12, 12) what white accelerations add over a step, body errors.

        Without the turn of the axes within the step, which is small between frames.
        """
        densities = (self.acceleration_psd_m2_s3, self.angular_acceleration_psd_rad2_s3)
        return np.asarray(block_diag(*(white_acceleration_noise(q, step_s) for q in densities)))


def _couple(F: FloatArray, before: RelativeStates, after: RelativeStates) -> None:
    """Add the points to a transition (..., n, n) of coupled errors of the motion, in place.

    ``eta_i = dr + D (dP_i - [P_i]x theta)`` after the step, with ``dP_i`` unchanged over it and
    taken from the errors before it: what (25) integrates to over a step.
    """
    motion = F[..., IB_MOTION, IB_MOTION]
    R1 = after.R_hill_body
    turn = R1 @ np.swapaxes(before.R_hill_body, -1, -2)
    moved = motion[..., IB_R_HILL, :].copy()
    moved[..., IB_R_HILL] -= turn
    turned = -motion[..., IB_THETA, :]
    turned[..., IB_THETA] += np.eye(3)
    arms = R1[..., None, :, :] @ skew(before.points_body) @ turned[..., None, :, :]
    for i in range(before.points_body.shape[-2]):
        rows = point_slice(i)
        F[..., rows, IB_MOTION] = moved + arms[..., i, :, :]
        F[..., rows, rows] = turn


def _errors_by_motion(states: RelativeStates) -> FloatArray:
    """(..., n, 12) coupled errors of errors of the motion in body terms, the points fixed in it."""
    matrix = np.zeros((*states.r_hill.shape[:-1], states.size, IB_MOTION_SIZE))
    matrix[..., IB_MOTION, :] = states.motion_from_body_errors()
    arms = -states.R_hill_body[..., None, :, :] @ skew(states.points_body)
    for i in range(states.points_body.shape[-2]):
        rows = point_slice(i)
        matrix[..., rows, IB_R_HILL] = np.eye(3)
        matrix[..., rows, IB_THETA] = arms[..., i, :, :]
    return matrix


@dataclass(frozen=True)
class PixelMeasurements:
    """Points seen by a stereo rig at one time (Segal 2011 (4)), of a state or a batch of them.

    A rectified rig measures a point's row twice with independent noise; left column, right column
    and the mean of both rows hold all that the four numbers tell of the state, so s is 3.
    """

    rig: StereoRig
    R_rig_hill: FloatArray
    """(3, 3)"""
    points: IntArray
    """(m,) which points of the state were seen."""
    pixels: FloatArray
    """(..., m, 3) from `reduced_pixels`."""

    def take(self, index: IntArray) -> "PixelMeasurements":
        """See `BatchedMeasurements`."""
        return replace(self, pixels=self.pixels[index])

    @property
    def noise(self) -> FloatArray:
        """(m, 3, 3) px^2."""
        one = self.rig.pixel_sigma_px**2 * np.diag([1.0, 1.0, 0.5])
        return np.broadcast_to(one, (len(self.points), 3, 3))

    def residual(self, states: RelativeStates) -> FloatArray:
        """(..., m, 3) px."""
        return np.asarray(self.pixels - reduced_pixels(self.rig.project(self._in_rig(states))))

    def jacobian(self, states: RelativeStates) -> FloatArray:
        """(..., m, 3, n) by the errors of the states, coupled or not."""
        by_rig = self.rig.projection_jacobian(self._in_rig(states))[..., (0, 2, 1), :]
        by_hill = by_rig @ self.R_rig_hill
        jacobian = np.zeros((*by_hill.shape[:-1], states.size))
        # Without coupling a point moves with the mass centre, the attitude and in the body.
        by_body = None if states.coupled else by_hill @ states.R_hill_body[..., None, :, :]
        if by_body is not None:
            jacobian[..., IB_R_HILL] = by_hill
            jacobian[..., IB_THETA] = -by_body @ skew(states.points_body[..., self.points, :])
        by_point = by_hill if by_body is None else by_body
        for k, i in enumerate(self.points):
            jacobian[..., k, :, point_slice(int(i))] = by_point[..., k, :, :]
        return jacobian

    def _in_rig(self, states: RelativeStates) -> FloatArray:
        return np.asarray(states.positions()[..., self.points, :] @ self.R_rig_hill.T)


@dataclass(frozen=True)
class PixelsAhead:
    """Points seen one step later, as a measurement of the states before the step.

    While a rate is hardly known, its error times that of a depth moves a point by more than the
    noise, and no iteration after a linear prediction brings that back. Here the iterated update
    takes the prediction into its iteration. White accelerations within the step are left out: they
    enter with the prediction that follows.
    """

    later: PixelMeasurements
    model: RelativeMotion
    time_s: float
    """Of the states."""
    step_s: float

    def take(self, index: IntArray) -> "PixelsAhead":
        """See `BatchedMeasurements`."""
        return replace(self, later=self.later.take(index), model=picked(self.model, index))

    @property
    def noise(self) -> FloatArray:
        """(m, 3, 3) px^2."""
        return self.later.noise

    def residual(self, states: RelativeStates) -> FloatArray:
        """(..., m, 3) px."""
        return self.later.residual(self.model.propagate(states, self.time_s, self.step_s)[0])

    def jacobian(self, states: RelativeStates) -> FloatArray:
        """(..., m, 3, n) by the errors of the states before the step."""
        moved, F, _ = self.model.propagate(states, self.time_s, self.step_s)
        return np.asarray(self.later.jacobian(moved) @ F[..., None, :, :])


def reduced_pixels(pixels: FloatArray) -> FloatArray:
    """(..., 3) left column, right column and mean row of (..., 4) pixels."""
    rows = 0.5 * (pixels[..., 1] + pixels[..., 3])
    return np.stack([pixels[..., 0], pixels[..., 2], rows], axis=-1)
