"""State, motion and measurement of the filter on attitudes alone (Deng 2024).

The states are the paper's eleven (15): attitude, rate, and five ratios of the inertia over Jzz. The
numbers of the printed quaternion (10) are those of a Hamilton quaternion of ``R_world_body``, and
its error (25) is ``q = q_hat * dq``: the rotation vector of pcnav, ``R = R_hat exp(theta)``, is
twice the printed ``dq_v``. The printed update adds components of quaternions (36), which is right
only near the identity; here the error is injected by rotation. Errors of the inertia are those of
``N = 3 J / tr(J)``, for the reasons given in `pcnav.dynamics.inertia_parameters`;
`printed_ratios_jacobian` turns them into those of the printed ratios.

States, model and measurements work without a leading dimension in `ErrorStateFilter` and with one
in `BatchedFilter`.
"""

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from pcnav.config.attitude_inertia import Propagation
from pcnav.core.arrays import FloatArray, IntArray
from pcnav.core.spatial import exp_rotation, left_jacobian, log_rotation, rotation_from_xyzw, skew
from pcnav.dynamics.blocks import ROTATION_LAYOUT
from pcnav.dynamics.inertia_parameters import INERTIA_UNITS, inertia_of, inside, shares
from pcnav.dynamics.process_noise import white_acceleration_noise
from pcnav.dynamics.rotation_step import Slope, at_rest, rotate, torque_free_by_inertia
from pcnav.filtering.error_state import MotionModel

THETA, OMEGA, INERTIA = ROTATION_LAYOUT.slices
"""Attitude error (body axes, right, rad), rate (rad/s), N_yy, N_zz, N_xy, N_xz, N_yz."""
SIZE = ROTATION_LAYOUT.size
_QUANTITIES = 8
"""Rate and inertia."""

_PRINTED_ENTRIES = ((0, 0), (1, 1), (0, 1), (0, 2), (1, 2))


def parameters_from_printed(ratios: FloatArray) -> FloatArray:
    """(..., 5) parameters of N of the printed ratios (..., 5): (13)."""
    xx, yy, xy, xz, yz = np.moveaxis(ratios, -1, 0)
    scale = 3.0 / (xx + yy + 1.0)
    return np.stack([scale * yy, scale, scale * xy, scale * xz, scale * yz], axis=-1)


def printed_from_parameters(parameters: FloatArray) -> FloatArray:
    """(..., 5) Jxx, Jyy, Jxy, Jxz, Jyz over Jzz."""
    inertia = inertia_of(parameters)
    entries = np.stack([inertia[..., i, j] for i, j in _PRINTED_ENTRIES], axis=-1)
    return np.asarray(entries / inertia[..., 2, 2, None])


def printed_ratios_jacobian(parameters: FloatArray) -> FloatArray:
    """(..., 5, 5) derivative of `printed_from_parameters`."""
    inertia = inertia_of(parameters)
    by_entries = np.stack([INERTIA_UNITS[:, i, j] for i, j in _PRINTED_ENTRIES])
    ratios = printed_from_parameters(parameters)
    of_scale = ratios[..., :, None] * INERTIA_UNITS[:, 2, 2]
    return np.asarray((by_entries - of_scale) / inertia[..., 2, 2, None, None])


@dataclass(frozen=True)
class RotationState:
    """A free body's rotation and what of its inertia shows in it."""

    R_world_body: FloatArray
    """(..., 3, 3)"""
    omega_body: FloatArray
    """(..., 3) rad/s."""
    parameters: FloatArray
    """(..., 5) N_yy, N_zz, N_xy, N_xz, N_yz with N = 3 J / tr(J), body axes."""

    @property
    def printed_ratios(self) -> FloatArray:
        """(..., 5) Jxx, Jyy, Jxy, Jxz, Jyz over Jzz (15)."""
        return printed_from_parameters(self.parameters)

    @property
    def size(self) -> int:
        """Of the error."""
        return SIZE

    @property
    def curved(self) -> slice:
        """See `ManifoldState`: the attitude."""
        return THETA

    def retract(self, error: FloatArray) -> "RotationState":
        """The state moved by an error (..., 11)."""
        return RotationState(
            self.R_world_body @ exp_rotation(error[..., THETA]),
            self.omega_body + error[..., OMEGA],
            self.parameters + error[..., INERTIA],
        )

    def local(self, other: "RotationState") -> FloatArray:
        """(..., 11) the error that takes this state to another: the inverse of `retract`."""
        turn = log_rotation(np.swapaxes(self.R_world_body, -1, -2) @ other.R_world_body)
        rest = (other.omega_body - self.omega_body, other.parameters - self.parameters)
        return np.concatenate([turn, *rest], axis=-1)

    def printed_error(self, other: "RotationState") -> FloatArray:
        """(..., 11) as `local`, the last five being differences of the printed ratios."""
        error = self.local(other)
        error[..., INERTIA] = other.printed_ratios - self.printed_ratios
        return error

    def retraction_block(self, error: FloatArray) -> FloatArray:
        """See `ManifoldState`: ``exp(a + da) = exp(a) exp(J_r(a) da)``."""
        return left_jacobian(-error[..., THETA])

    def admissible(self, error: FloatArray, covariance: FloatArray) -> FloatArray:
        """The errors (..., 11) that lead to the inertia of a body, nearest to those given.

        In the metric of the covariance (..., 11, 11): every other state moves with the inertia as
        they are correlated.
        """
        flat = error.reshape(-1, SIZE)
        before = np.broadcast_to(self.parameters, (*error.shape[:-1], 5)).reshape(-1, 5)
        spread = covariance.reshape(-1, SIZE, SIZE)
        changed = flat.copy()
        for k, (start, P) in enumerate(zip(before, spread, strict=True)):
            wanted = start + flat[k, INERTIA]
            if shares(wanted)[0][0] < 0.0:
                push, moved = inside(wanted, P[INERTIA, INERTIA])
                changed[k] += P[:, INERTIA] @ push
                changed[k, INERTIA] = moved - start
        return changed.reshape(error.shape)


def printed_covariance(state: RotationState, covariance: FloatArray) -> FloatArray:
    """(..., 11, 11) a covariance with its inertia part turned into that of the printed ratios."""
    change = np.zeros(covariance.shape)
    change[..., :, :] = np.eye(SIZE)
    change[..., INERTIA, INERTIA] = printed_ratios_jacobian(state.parameters)
    return np.asarray(change @ covariance @ np.swapaxes(change, -1, -2))


@dataclass(frozen=True)
class TorqueFreeModel(MotionModel[RotationState]):
    """Free rotation (11), (14) of a body whose inertia does not change."""

    angular_acceleration_psd_rad2_s3: float
    propagation: Propagation = Propagation.INTEGRATED
    printed_variance: float = 0.0
    """Added to each state of print (half angles, deg/s, ratios) at every step: Q of section 4.

    Print gives no units. Its first guess of the rate is a tenth of the true one in deg/s; in rad/s
    Q would be a third of the rate itself at every step.
    """

    def propagate(
        self, state: RotationState, time_s: float, step_s: float
    ) -> tuple[RotationState, FloatArray, FloatArray]:
        """See `MotionModel.propagate`."""
        move = _euler if self.propagation is Propagation.EULER else _integrated
        moved, transition = move(state, step_s)
        return moved, transition, self._noise(moved, abs(step_s))

    def _noise(self, state: RotationState, step_s: float) -> FloatArray:
        noise = np.zeros((*state.omega_body.shape[:-1], SIZE, SIZE))
        q = self.angular_acceleration_psd_rad2_s3
        noise[..., :6, :6] = white_acceleration_noise(q, step_s)
        if self.printed_variance > 0.0:
            one = np.eye(3)
            noise[..., THETA, THETA] += 4.0 * self.printed_variance * one
            noise[..., OMEGA, OMEGA] += np.radians(np.radians(self.printed_variance)) * one
            by_printed = np.linalg.inv(printed_ratios_jacobian(state.parameters))
            squared = by_printed @ np.swapaxes(by_printed, -1, -2)
            noise[..., INERTIA, INERTIA] += self.printed_variance * squared
        return noise


def carry(
    model: TorqueFreeModel, state: RotationState, covariance: FloatArray, step_s: float
) -> tuple[RotationState, FloatArray]:
    """A state and the covariance (..., 11, 11) of its errors, a time later."""
    if step_s <= 0.0:
        return state, covariance
    moved, transition, noise = model.propagate(state, 0.0, step_s)
    P = transition @ covariance @ np.swapaxes(transition, -1, -2) + noise
    return moved, np.asarray(0.5 * (P + np.swapaxes(P, -1, -2)))


def _euler(state: RotationState, step_s: float) -> tuple[RotationState, FloatArray]:
    """One step of ``x + f dT`` with the quaternion normalised, and ``1 + C dT`` ((33), (36))."""
    half = 0.5 * step_s * state.omega_body
    turn = rotation_from_xyzw(np.concatenate([half, np.ones((*half.shape[:-1], 1))], axis=-1))
    change = _slope(state)(at_rest(state.omega_body, _QUANTITIES).rates)
    transition = np.zeros((*half.shape[:-1], SIZE, SIZE))
    transition[..., :, :] = np.eye(SIZE)
    transition[..., THETA, THETA] -= step_s * skew(state.omega_body)
    transition[..., THETA, OMEGA] = step_s * np.eye(3)
    transition[..., OMEGA, OMEGA.start :] += step_s * change[..., 1:]
    omega = state.omega_body + step_s * change[..., 0]
    return RotationState(state.R_world_body @ turn, omega, state.parameters), transition


def _integrated(state: RotationState, step_s: float) -> tuple[RotationState, FloatArray]:
    done = rotate(_slope(state), state.omega_body, step_s, _QUANTITIES)
    R = state.R_world_body @ done.turn
    return RotationState(R, done.omega_body, state.parameters), done.transition


def _slope(state: RotationState) -> Slope:
    inertia = inertia_of(state.parameters)
    return torque_free_by_inertia(inertia, np.asarray(np.linalg.inv(inertia)))


class _Turned(Protocol):
    """A state whose error begins with that of its attitude, ``R = R_hat exp(theta)``."""

    @property
    def R_world_body(self) -> FloatArray: ...

    @property
    def size(self) -> int: ...


@dataclass(frozen=True)
class AttitudeSet:
    """The measured attitude, (18), of a state or of each of a batch: a `MeasurementSet` of one."""

    R_world_body: FloatArray
    """(..., 3, 3) measured, ``R_true exp(error)``."""
    covariance: FloatArray
    """(3, 3) of their errors, body axes, rad^2, the same for all."""

    def take(self, index: IntArray) -> "AttitudeSet":
        """See `BatchedMeasurements`."""
        return AttitudeSet(self.R_world_body[index], self.covariance)

    @property
    def noise(self) -> FloatArray:
        """(1, 3, 3) rad^2."""
        return self.covariance[None]

    def residual(self, states: _Turned) -> FloatArray:
        """(..., 1, 3) rotation vector from the state's attitude to the measured one, rad."""
        turned = np.swapaxes(states.R_world_body, -1, -2) @ self.R_world_body
        return log_rotation(turned)[..., None, :]

    def jacobian(self, states: _Turned) -> FloatArray:
        """(..., 1, 3, n) ``log(exp(-theta) exp(e)) = e - J_l(e)^-1 theta``; (35) has half of it."""
        residual = self.residual(states)
        jacobian = np.zeros((*residual.shape, states.size))
        jacobian[..., THETA] = np.linalg.inv(left_jacobian(residual))
        return jacobian
