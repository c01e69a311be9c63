"""The 20-state model of Yu 2019: relative orbit, mass centre, attitude, rate and inertia ratios.

The pages with (34)-(41) of the paper are missing; state order and frames are those of DESIGN and
the Jacobians are derived here.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from pcnav.core.arrays import BoolArray, FloatArray
from pcnav.core.spatial import skew
from pcnav.dynamics.inertia_parameters import parameters_from_ratios, ratios_jacobian
from pcnav.dynamics.orbit import hill_transition, hill_transitions
from pcnav.dynamics.process_noise import hill_process_noise, white_acceleration_noise
from pcnav.dynamics.rigid_body import euler_forms, inertia_from_ratios
from pcnav.dynamics.rotation_path import path_along
from pcnav.dynamics.rotation_step import Slope, rotate
from pcnav.dynamics.state import (
    COM_MODEL,
    R_HILL,
    STATE_SIZE,
    THETA_BODY,
    NavigationState,
)
from pcnav.estimators.depth.camera_noise import EXACT, CameraNoise
from pcnav.filtering.map_arc_fit import ArcModel, Path
from pcnav.perception.association import MeasuredFace


@dataclass(frozen=True)
class MassCentreModel(ArcModel[NavigationState]):
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
        rotation = rotate(_slope(state.inertia_ratios), state.omega_body, step_s, 8)
        transition[9:, 9:] = rotation.transition
        moved = NavigationState(
            r_hill=relative[:3],
            v_hill=relative[3:],
            com_model=state.com_model,
            R_world_body=state.R_world_body @ rotation.turn,
            omega_body=rotation.omega_body,
            inertia_ratios=state.inertia_ratios,
        )
        return moved, transition, self._process_noise(step_s)

    def along(self, state: NavigationState, times_s: FloatArray) -> Path[NavigationState]:
        """See `ArcModel.along`."""
        orbit = hill_transitions(self.mean_motion_rad_s, times_s - times_s[0])
        relative = orbit @ np.concatenate([state.r_hill, state.v_hill])
        slope, inertia = _slope(state.inertia_ratios), inertia_from_ratios(state.inertia_ratios)
        rotation = path_along(slope, inertia, state.omega_body, times_s, 8)
        by_first = np.zeros((len(times_s), STATE_SIZE, STATE_SIZE))
        by_first[:, :6, :6] = orbit
        by_first[:, COM_MODEL, COM_MODEL] = np.eye(3)
        by_first[:, 9:, 9:] = rotation.transition
        states = NavigationState(
            r_hill=relative[:, :3],
            v_hill=relative[:, 3:],
            com_model=np.broadcast_to(state.com_model, (len(times_s), 3)),
            R_world_body=state.R_world_body @ rotation.turn,
            omega_body=rotation.omega_body,
            inertia_ratios=np.broadcast_to(state.inertia_ratios, (len(times_s), 5)),
        )
        return Path(states, by_first)

    @lru_cache(maxsize=64)  # noqa: B019 - the models are few and frozen, the steps of a run as well
    def _process_noise(self, step_s: float) -> FloatArray:
        noise = np.zeros((STATE_SIZE, STATE_SIZE))
        noise[:6, :6] = hill_process_noise(
            self.mean_motion_rad_s, step_s, self.acceleration_psd_m2_s3
        )
        noise[9:15, 9:15] = white_acceleration_noise(self.angular_acceleration_psd_rad2_s3, step_s)
        return noise


@lru_cache(maxsize=8)
def _euler_forms(ratios: bytes) -> tuple[FloatArray, FloatArray]:
    """Euler's equation of a body as forms of its rate w.

    The acceleration is quadratic in w, so its derivative by w is linear, and half of that times w
    is the acceleration itself. Returned are (9, 3), which makes that derivative (3, 3) of w, and
    (15, 9), which makes the derivative (3, 5) by the inertia's parameters of the products of w.

    Of ratios (5,) as bytes: along an arc they stay what they are, so their forms are kept.
    """
    values = np.frombuffer(ratios)
    by_rate, by_ratios = euler_forms(inertia_from_ratios(values))
    by_inertia = np.tensordot(by_ratios, ratios_jacobian(parameters_from_ratios(values)), (1, 0))
    return by_rate.reshape(9, 3), np.moveaxis(by_inertia, -1, 1).reshape(15, 9)


def _slope(ratios: FloatArray) -> Slope:
    """Of a body's rate, by the rate (3) and by the inertia's parameters (5)."""
    by_rate, by_inertia = _euler_forms(ratios.tobytes())

    def slope(rates: FloatArray) -> FloatArray:
        w, batch = rates[..., 0], rates.shape[:-2]
        change = (w @ by_rate.T).reshape(*batch, 3, 3) @ rates
        change[..., 0] *= 0.5
        products = (w[..., :, None] * w[..., None, :]).reshape(*batch, 9)
        change[..., 4:] += (products @ by_inertia.T).reshape(*batch, 3, 5)
        return np.asarray(change)

    return slope


@dataclass(frozen=True)
class RectangleMeasurement:
    """The pose of a recognised rectangle, or what of it is known.

    Six components in the axes of the catalogue rectangle: the measured centroid minus where the
    state puts it, x, y, z (Yu 2019 (32)), then the rotation from predicted to measured frame about
    x, y (from the normals) and z (yaw). ``known`` picks those that the observation determines: a
    square has no yaw, a cut face only z and the two tilts.
    """

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
    camera_noise: CameraNoise = EXACT
    """Of T_cam_hill."""

    @staticmethod
    def of(
        face: MeasuredFace,
        T_cam_hill: FloatArray,
        R_hill_world: FloatArray,
        camera_noise: CameraNoise = EXACT,
    ) -> "RectangleMeasurement":
        """Of a face as a frame shows it."""
        return RectangleMeasurement(
            T_model_rect=face.rectangle.T_model_rect,
            T_cam_rect=face.T_cam_rect,
            known=face.known,
            full_covariance=face.covariance,
            T_cam_hill=T_cam_hill,
            R_hill_world=R_hill_world,
            camera_noise=camera_noise,
        )

    @property
    def covariance(self) -> FloatArray:
        """(m, m) of the known components, with what the camera's pose adds to it."""
        own = self.full_covariance[np.ix_(self.known, self.known)]
        return own + self.shared @ self.shared.T if self.camera_noise.is_there else own

    @property
    def shared(self) -> FloatArray:
        """(m, k) derivative by errors of the camera's pose, of unit variance, which all rectangles
        of the frame share."""
        made = self.camera_noise.by_unit(self.T_cam_rect)
        made[:3] = self.T_cam_rect[:3, :3].T @ made[:3]
        return made[self.known]

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
