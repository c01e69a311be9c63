"""The navigation state that truth, filter and result files share."""

from dataclasses import dataclass

import numpy as np

from pcnav.core.arrays import FloatArray
from pcnav.core.spatial import exp_rotation, left_jacobian, log_rotation, make_transform
from pcnav.dynamics.blocks import (
    ATTITUDE,
    CENTRE,
    MASS_CENTRE_LAYOUT,
    POSITION,
    RATE,
    RATIOS,
    VELOCITY,
)
from pcnav.dynamics.inertia_parameters import (
    inside,
    parameters_from_ratios,
    ratios_from_parameters,
    ratios_jacobian,
    thinness,
)
from pcnav.dynamics.rigid_body import inertia_from_ratios
from pcnav.dynamics.trajectory import Trajectory

STATE_SIZE = MASS_CENTRE_LAYOUT.size
R_HILL, V_HILL, COM_MODEL, THETA_BODY, OMEGA_BODY, INERTIA_RATIOS = MASS_CENTRE_LAYOUT.slices
"""Slices of the error state, in the order of DESIGN.

Inside the filter the last five are errors of the parameters of
`pcnav.dynamics.inertia_parameters`. At the edges (results, evaluation) they are errors of the
ratios themselves: `NavigationState.ratio_error` and `ratio_covariance`.
"""


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

    @staticmethod
    def of(motion: Trajectory, k: int) -> "NavigationState":
        """The state in frame k of a motion that has all blocks."""
        return NavigationState(
            r_hill=motion[POSITION][k],
            v_hill=motion[VELOCITY][k],
            com_model=motion[CENTRE][k],
            R_world_body=motion[ATTITUDE][k],
            omega_body=motion[RATE][k],
            inertia_ratios=motion[RATIOS][k],
        )

    @property
    def inertia(self) -> FloatArray:
        """(3, 3) inertia matrix over Ixx, body axes."""
        return inertia_from_ratios(self.inertia_ratios)

    @property
    def values(self) -> dict[str, FloatArray]:
        """By name of a block; see `pcnav.dynamics.blocks`."""
        return {
            POSITION.name: self.r_hill,
            VELOCITY.name: self.v_hill,
            CENTRE.name: self.com_model,
            ATTITUDE.name: self.R_world_body,
            RATE.name: self.omega_body,
            RATIOS.name: self.inertia_ratios,
        }

    def retract(self, error: FloatArray) -> "NavigationState":
        """The state moved by a (20,) error: additive, the attitude by ``R exp(theta)``.

        The inertia's part adds to its parameters. Raises `ValueError` where Ixx would vanish.
        """
        inertia = parameters_from_ratios(self.inertia_ratios) + error[INERTIA_RATIOS]
        return NavigationState(
            r_hill=self.r_hill + error[R_HILL],
            v_hill=self.v_hill + error[V_HILL],
            com_model=self.com_model + error[COM_MODEL],
            R_world_body=self.R_world_body @ exp_rotation(error[THETA_BODY]),
            omega_body=self.omega_body + error[OMEGA_BODY],
            inertia_ratios=ratios_from_parameters(inertia),
        )

    @property
    def loose(self) -> slice:
        """See `pcnav.filtering.map_arc_fit.ArcState`: the inertia, until it has been seen."""
        return INERTIA_RATIOS

    @property
    def curved(self) -> slice:
        """See `ManifoldState`: the attitude."""
        return THETA_BODY

    def retraction_block(self, error: FloatArray) -> FloatArray:
        """(3, 3) See `ManifoldState`: ``exp(a + da) = exp(a) exp(J_r(a) da)``."""
        return left_jacobian(-error[THETA_BODY])

    def local(self, other: "NavigationState") -> FloatArray:
        """The (20,) error that takes this state to ``other``: the inverse of `retract`."""
        error = self.ratio_error(other)
        ours, theirs = (parameters_from_ratios(s.inertia_ratios) for s in (self, other))
        error[INERTIA_RATIOS] = theirs - ours
        return error

    def ratio_error(self, other: "NavigationState") -> FloatArray:
        """(20,) as `local`, but the last five are the differences of the inertia ratios.

        What results, metrics and tables are in; `ratio_covariance` is the covariance of it.
        """
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

    def admissible(self, error: FloatArray, covariance: FloatArray) -> FloatArray:
        """The (20,) error that leads to the inertia of a body, nearest to the one given.

        Nearest in the metric of the covariance (20, 20) of the moved state's error: what is known
        well stays, and every other state moves with the inertia as they are correlated.
        """
        inertia = parameters_from_ratios(self.inertia_ratios)
        push, moved = inside(
            inertia + error[INERTIA_RATIOS], covariance[INERTIA_RATIOS, INERTIA_RATIOS]
        )
        changed = error + covariance[:, INERTIA_RATIOS] @ push
        changed[INERTIA_RATIOS] = moved - inertia
        return np.asarray(changed)

    def thinness(self) -> tuple[FloatArray, FloatArray]:
        """How far the inertia is from those of bodies, as residuals (3,) for a least-squares fit.

        Zero for any body that is not very thin. With their derivative by the error (3, 20).
        """
        residual, by_inertia = thinness(parameters_from_ratios(self.inertia_ratios))
        jacobian = np.zeros((3, STATE_SIZE))
        jacobian[:, INERTIA_RATIOS] = by_inertia
        return residual, jacobian

    def T_cam_model(self, T_cam_world: FloatArray, R_hill_world: FloatArray) -> FloatArray:
        """(4, 4) pose of the model frame in the camera at the same instant."""
        p_world_com = R_hill_world.T @ self.r_hill
        p_world_model = p_world_com - self.R_world_body @ self.com_model
        return np.asarray(T_cam_world @ make_transform(self.R_world_body, p_world_model))


def ratio_covariance(state: NavigationState, covariance: FloatArray) -> FloatArray:
    """(20, 20) a filter's covariance with its inertia part turned into that of the ratios.

    To first order at the state: ``T P T^T``, T the identity but for the Jacobian of the ratios.
    """
    to_ratios = ratios_jacobian(parameters_from_ratios(state.inertia_ratios))
    turned = covariance.copy()
    turned[INERTIA_RATIOS] = to_ratios @ turned[INERTIA_RATIOS]
    turned[:, INERTIA_RATIOS] = turned[:, INERTIA_RATIOS] @ to_ratios.T
    return np.asarray(0.5 * (turned + turned.T))
