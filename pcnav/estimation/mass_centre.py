"""The 20-state model of Yu 2019: relative orbit, mass centre, attitude, rate and inertia ratios.

The pages with (34)-(41) of the paper are missing; state order and frames are those of DESIGN and
the Jacobians are derived here.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from pcnav.arrays import BoolArray, FloatArray
from pcnav.dynamics.inertia_parameters import parameters_from_ratios, ratios_jacobian
from pcnav.dynamics.orbit import hill_process_noise, hill_transition
from pcnav.dynamics.rigid_body import euler_derivatives, inertia_from_ratios
from pcnav.estimation.error_state import Measurement, MotionModel
from pcnav.spatial import exp_rotation, left_jacobian, skew
from pcnav.state import (
    COM_MODEL,
    OMEGA_BODY,
    R_HILL,
    STATE_SIZE,
    THETA_BODY,
    NavigationState,
)

_LARGEST_TURN_RAD = 0.1
"""Rotation in one Runge-Kutta step: its error, of order turn^5 / 120, stays below 1e-7 rad."""


@dataclass(frozen=True)
class MassCentreModel(MotionModel[NavigationState]):
    """Hill's relative orbit and torque-free rotation; mass properties do not change."""

    mean_motion_rad_s: float
    acceleration_psd_m2_s3: float
    angular_acceleration_psd_rad2_s3: float

    def propagate(
        self, state: NavigationState, time_s: float, step_s: float
    ) -> tuple[NavigationState, FloatArray, FloatArray]:
        """See `MotionModel.propagate`. The model does not depend on ``time_s``."""
        transition = np.eye(STATE_SIZE)
        orbit = hill_transition(self.mean_motion_rad_s, step_s)
        transition[:6, :6] = orbit
        relative = orbit @ np.concatenate([state.r_hill, state.v_hill])
        turn, rotation = _propagate_rotation(state, step_s)
        transition[9:, 9:] = rotation
        moved = NavigationState(
            r_hill=relative[:3],
            v_hill=relative[3:],
            com_model=state.com_model,
            R_world_body=state.R_world_body @ turn.R,
            omega_body=turn.omega,
            inertia_ratios=state.inertia_ratios,
        )
        return moved, transition, self._process_noise(step_s)

    @lru_cache(maxsize=64)  # noqa: B019 - the models are few and frozen, the steps of a run as well
    def _process_noise(self, step_s: float) -> FloatArray:
        noise = np.zeros((STATE_SIZE, STATE_SIZE))
        noise[:6, :6] = hill_process_noise(
            self.mean_motion_rad_s, step_s, self.acceleration_psd_m2_s3
        )
        q = self.angular_acceleration_psd_rad2_s3 * np.eye(3)
        noise[THETA_BODY, THETA_BODY] = q * step_s**3 / 3.0
        noise[THETA_BODY, OMEGA_BODY] = noise[OMEGA_BODY, THETA_BODY] = q * step_s**2 / 2.0
        noise[OMEGA_BODY, OMEGA_BODY] = q * step_s
        return noise


@dataclass(frozen=True)
class _Turn:
    R: FloatArray
    omega: FloatArray


def _propagate_rotation(state: NavigationState, step_s: float) -> tuple[_Turn, FloatArray]:
    """Turn of the body over the step; (11, 11) transition of theta, omega and inertia errors."""
    inertia, inverse, by_parameters = _inertia_forms(state.inertia_ratios.tobytes())
    substeps = max(
        1, int(np.ceil(np.linalg.norm(state.omega_body) * abs(step_s) / _LARGEST_TURN_RAD))
    )
    h = step_s / substeps
    R, omega = np.eye(3), state.omega_body
    transition = np.eye(11)
    for _ in range(substeps):
        turn, step_transition = _rotation_step(inertia, inverse, omega, h)
        R, omega = R @ turn.R, turn.omega
        transition = step_transition @ transition
    # So far by the ratios. They do not change over the step, so neither does this factor.
    transition[:6, 6:] = transition[:6, 6:] @ by_parameters
    return _Turn(R, omega), transition


@lru_cache(maxsize=8)
def _inertia_forms(ratios: bytes) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Inertia over Ixx, its inverse, and the Jacobian (5, 5) of the ratios by their parameters.

    Of ratios (5,) as bytes: along an arc they stay what they are, so their forms are kept.
    """
    values = np.frombuffer(ratios)
    inertia = inertia_from_ratios(values)
    jacobian = ratios_jacobian(parameters_from_ratios(values))
    return inertia, np.asarray(np.linalg.inv(inertia)), jacobian


def _rotation_step(
    inertia: FloatArray, inverse: FloatArray, omega: FloatArray, h: float
) -> tuple[_Turn, FloatArray]:
    """One step of Runge-Kutta (rate, variational equations) and of Magnus (attitude), both order 4.

    The rate's derivatives D = d omega / d (omega, ratios), (3, 8), obey ``D' = A D + [0 B]`` with
    the Jacobians A and B of Euler's equation. The attitude turns by ``exp(phi)`` with
    ``phi = h/6 (w0 + 4 w1/2 + w1) + h^2/12 w0 x w1`` (Magnus, in body axes); an attitude error
    is carried by ``exp(-phi)`` and an error of phi enters through the right Jacobian.
    """
    derivatives = np.hstack([np.eye(3), np.zeros((3, 5))])

    def slope(w: FloatArray, D: FloatArray) -> tuple[FloatArray, FloatArray]:
        acceleration, A, B = euler_derivatives(inertia, inverse, w)
        rate = A @ D
        rate[:, 3:] += B
        return acceleration, rate

    a1, d1 = slope(omega, derivatives)
    a2, d2 = slope(omega + 0.5 * h * a1, derivatives + 0.5 * h * d1)
    a3, d3 = slope(omega + 0.5 * h * a2, derivatives + 0.5 * h * d2)
    a4, d4 = slope(omega + h * a3, derivatives + h * d3)
    after = omega + h / 6.0 * (a1 + 2.0 * a2 + 2.0 * a3 + a4)
    D_after = derivatives + h / 6.0 * (d1 + 2.0 * d2 + 2.0 * d3 + d4)
    # Cubic Hermite interpolation gives the mid-point to order 4.
    middle = 0.5 * (omega + after) + h / 8.0 * (a1 - a4)
    D_middle = 0.5 * (derivatives + D_after) + h / 8.0 * (d1 - d4)
    phi = h / 6.0 * (omega + 4.0 * middle + after) + h**2 / 12.0 * (skew(omega) @ after)
    D_phi = h / 6.0 * (derivatives + 4.0 * D_middle + D_after) + h**2 / 12.0 * (
        skew(omega) @ D_after - skew(after) @ derivatives
    )
    R = exp_rotation(phi)
    transition = np.eye(11)
    transition[:3, :3] = R.T
    transition[:3, 3:] = left_jacobian(-phi) @ D_phi
    transition[3:6, 3:] = D_after
    return _Turn(R, after), transition


@dataclass(frozen=True)
class RectangleMeasurement(Measurement[NavigationState]):
    """The pose of a recognised rectangle, or what of it is known.

    Six components in the axes of the catalogue rectangle: the measured centroid minus where the
    state puts it, x, y, z (Yu 2019 (32)), then the rotation from predicted to measured frame about
    x, y (from the normals) and z (yaw). ``known`` picks those that the observation determines: a
    square has no yaw, a cut face only z and the two tilts.
    """

    rectangle: str
    T_model_rect: FloatArray
    """(4, 4) catalogue pose."""
    T_cam_rect: FloatArray
    """(4, 4) measured pose with the ambiguity resolved."""
    known: BoolArray
    """(6,) components that carry information."""
    full_covariance: FloatArray
    """(6, 6) in the axes of the measured rectangle."""
    T_cam_hill: FloatArray
    """(4, 4) the camera in the Hill frame at the time of the frame."""
    R_hill_world: FloatArray
    """(3, 3) at the time of the frame."""

    @property
    def name(self) -> str:
        """The rectangle's name in the catalogue."""
        return self.rectangle

    @property
    def covariance(self) -> FloatArray:
        """(m, m) of the known components."""
        return self.full_covariance[np.ix_(self.known, self.known)]

    def residual(self, state: NavigationState) -> FloatArray:
        """(m,) measured minus predicted: m, then rad."""
        centroid, R_rect = self._in_rectangle_axes(state)
        normal, short = R_rect[:, 2], R_rect[:, 0]
        yaw = np.arctan2(short[1], short[0])
        return np.concatenate([centroid, [-normal[1], normal[0], yaw]])[self.known]

    def jacobian(self, state: NavigationState) -> FloatArray:
        """(m, 20) derivative of the prediction by the error state."""
        R_rect_model = self.T_model_rect[:3, :3].T
        R_body_cam = self._R_body_cam(state)
        p_body = R_body_cam @ (self.T_cam_rect[:3, 3] - self._com_cam(state))
        _, R_rect = self._in_rectangle_axes(state)
        # A small turn theta of the body moves a fixed vector v, seen in body axes, by [v]x theta.
        residual = np.zeros((6, STATE_SIZE))
        residual[:3, R_HILL] = -R_rect_model @ R_body_cam @ self.T_cam_hill[:3, :3]
        residual[:3, COM_MODEL] = R_rect_model
        residual[:3, THETA_BODY] = R_rect_model @ skew(p_body)
        R_model_rect = self.T_model_rect[:3, :3]
        normal_by_theta = R_rect_model @ skew(R_model_rect @ R_rect[:, 2])
        residual[3, THETA_BODY] = -normal_by_theta[1]
        residual[4, THETA_BODY] = normal_by_theta[0]
        short = R_rect[:, 0]
        short_by_theta = R_rect_model @ skew(R_model_rect @ short)
        residual[5, THETA_BODY] = (short[0] * short_by_theta[1] - short[1] * short_by_theta[0]) / (
            short[0] ** 2 + short[1] ** 2
        )
        return -residual[self.known]

    def _in_rectangle_axes(self, state: NavigationState) -> tuple[FloatArray, FloatArray]:
        """Measured centroid (3,) and axes (3, 3) seen in the catalogue rectangle's frame."""
        R_body_cam = self._R_body_cam(state)
        p_model = R_body_cam @ (self.T_cam_rect[:3, 3] - self._com_cam(state)) + state.com_model
        R_rect_model = self.T_model_rect[:3, :3].T
        centroid = R_rect_model @ (p_model - self.T_model_rect[:3, 3])
        return centroid, R_rect_model @ R_body_cam @ self.T_cam_rect[:3, :3]

    def _R_body_cam(self, state: NavigationState) -> FloatArray:
        R_hill_body = self.R_hill_world @ state.R_world_body
        return np.asarray((self.T_cam_hill[:3, :3] @ R_hill_body).T)

    def _com_cam(self, state: NavigationState) -> FloatArray:
        return np.asarray(self.T_cam_hill[:3, :3] @ state.r_hill + self.T_cam_hill[:3, 3])
