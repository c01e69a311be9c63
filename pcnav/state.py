"""The navigation state that truth, filter and result files share."""

from dataclasses import dataclass

import numpy as np

from pcnav.arrays import FloatArray
from pcnav.spatial import exp_rotation, left_jacobian, log_rotation, make_transform

STATE_SIZE = 20
R_HILL = slice(0, 3)
V_HILL = slice(3, 6)
COM_MODEL = slice(6, 9)
THETA_BODY = slice(9, 12)
OMEGA_BODY = slice(12, 15)
INERTIA_RATIOS = slice(15, 20)
"""Slices of the error state, in the order of DESIGN."""


@dataclass(frozen=True)
class NavigationState:
    """Relative motion of the target and the mass properties it reveals."""

    r_hill: FloatArray
    """(3,) target mass centre from the chaser's, Hill axes, m."""
    v_hill: FloatArray
    """(3,) its rate of change seen in the turning Hill frame, m/s."""
    com_model: FloatArray
    """(3,) true mass centre in the model frame, m."""
    R_world_body: FloatArray
    """(3, 3) attitude; body axes are parallel to the model axes."""
    omega_body: FloatArray
    """(3,) inertial angular rate in body axes, rad/s."""
    inertia_ratios: FloatArray
    """(5,) Iyy, Izz, Ixy, Ixz, Iyz over Ixx, as entries of the inertia matrix (Yu 2019 (29))."""

    def retract(self, error: FloatArray) -> "NavigationState":
        """The state moved by a (20,) error: additive, the attitude by ``R exp(theta)``."""
        return NavigationState(
            r_hill=self.r_hill + error[R_HILL],
            v_hill=self.v_hill + error[V_HILL],
            com_model=self.com_model + error[COM_MODEL],
            R_world_body=self.R_world_body @ exp_rotation(error[THETA_BODY]),
            omega_body=self.omega_body + error[OMEGA_BODY],
            inertia_ratios=self.inertia_ratios + error[INERTIA_RATIOS],
        )

    def retraction_jacobian(self, error: FloatArray) -> FloatArray:
        """(20, 20) how a small change of ``error`` moves `retract` of it, in the result's error.

        Identity but for the attitude: ``exp(a + da) = exp(a) exp(J_r(a) da)``.
        """
        jacobian = np.eye(STATE_SIZE)
        jacobian[THETA_BODY, THETA_BODY] = left_jacobian(-error[THETA_BODY])
        return jacobian

    def local(self, other: "NavigationState") -> FloatArray:
        """The (20,) error that takes this state to ``other``: the inverse of `retract`."""
        return np.concatenate(
            [
                other.r_hill - self.r_hill,
                other.v_hill - self.v_hill,
                other.com_model - self.com_model,
                log_rotation(self.R_world_body.T @ other.R_world_body),
                other.omega_body - self.omega_body,
                other.inertia_ratios - self.inertia_ratios,
            ]
        )

    def T_cam_model(self, T_cam_world: FloatArray, R_hill_world: FloatArray) -> FloatArray:
        """(4, 4) pose of the model frame in the camera at the same instant."""
        p_world_com = R_hill_world.T @ self.r_hill
        p_world_model = p_world_com - self.R_world_body @ self.com_model
        return np.asarray(T_cam_world @ make_transform(self.R_world_body, p_world_model))
