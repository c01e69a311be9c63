"""The true motion of a scenario: relative orbit, torque-free rotation and camera poses."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.integrate import solve_ivp

from pcnav.config.pipeline_file import Pipeline
from pcnav.config.scenario import BodyTable, OrbitModel, OrbitTable
from pcnav.config.sensors import CameraTable
from pcnav.core.arrays import FloatArray
from pcnav.core.camera import PinholeCamera, R_cam_hill
from pcnav.core.errors import InputError
from pcnav.core.spatial import exp_rotation, make_transform, rotation_from_xyzw, xyzw_from_rotation
from pcnav.dynamics.orbit import R_hill_world, hill_transition, propagate_two_body
from pcnav.dynamics.rigid_body import inertia_from_ratios, is_physical_inertia
from pcnav.dynamics.state import NavigationState


@dataclass(frozen=True)
class TrueMotion:
    """Truth at every frame time."""

    times_s: FloatArray
    """(n,) starts at 0."""
    states: tuple[NavigationState, ...]
    T_cam_world: FloatArray
    """(n, 4, 4) camera poses."""
    R_hill_world: FloatArray
    """(n, 3, 3)"""

    def T_cam_model(self, index: int) -> FloatArray:
        """(4, 4) true pose of the model frame in the camera at one frame."""
        state = self.states[index]
        return state.T_cam_model(self.T_cam_world[index], self.R_hill_world[index])


def true_motion(pipeline: Pipeline, source: Path | str = "pipeline") -> TrueMotion:
    """Integrate the scenario of a pipeline.

    ``source`` is the file an `InputError` names: raised when no mass distribution has the
    inertia ratios, or when the boresight has no direction.
    """
    inertia = inertia_from_ratios(np.array(pipeline.body.inertia_ratios))
    if not is_physical_inertia(inertia):
        expected = "expected ratios of a physical inertia matrix: positive principal moments"
        raise InputError(
            source, "body.inertia_ratios", f"{expected}, none larger than the other two together"
        )
    if pipeline.orbit.model is OrbitModel.KEPLER:
        expected = 'expected "hill" or "two_body": depth sequences are made on circular orbits'
        raise InputError(source, "orbit.model", expected)
    n = pipeline.orbit.mean_motion_rad_s
    times_s = np.arange(pipeline.scenario.frames) / pipeline.scenario.frame_rate_hz
    orbit = _relative_orbit(pipeline.orbit, times_s)
    R_world_body, omega_body = _rotation(pipeline.body, inertia, times_s)
    com_model = np.array(pipeline.body.com_model_m)
    ratios = np.array(pipeline.body.inertia_ratios)
    states = tuple(
        NavigationState(row[:3], row[3:], com_model, R, omega, ratios)
        for row, R, omega in zip(orbit, R_world_body, omega_body, strict=True)
    )
    R_hill_world_all = np.stack([R_hill_world(float(t), n) for t in times_s])
    R_cam_world = camera_rotation(pipeline.camera, source) @ R_hill_world_all
    return TrueMotion(times_s, states, make_transform(R_cam_world, np.zeros(3)), R_hill_world_all)


def pinhole_camera(table: CameraTable) -> PinholeCamera:
    """The camera of a pipeline's [camera] table."""
    fov_rad = float(np.deg2rad(table.horizontal_fov_deg))
    return PinholeCamera.from_field_of_view(table.width_px, table.height_px, fov_rad)


def camera_rotation(table: CameraTable, source: Path | str = "pipeline") -> FloatArray:
    """(3, 3) R_cam_hill of a camera looking along the boresight, OpenCV axes.

    Image down is nadir (+z) as far as the boresight allows; a camera that looks along nadir or
    zenith has along-track (+x) up in the image. Raises `InputError` for a zero boresight.
    """
    boresight = np.array(table.boresight_hill)
    if not boresight.any():
        raise InputError(source, "camera.boresight_hill", "expected a direction, got 0, 0, 0")
    return R_cam_hill(boresight)


def _relative_orbit(table: OrbitTable, times_s: FloatArray) -> FloatArray:
    """(n, 6) position and velocity in Hill axes."""
    r_hill, v_hill = np.array(table.r_hill_m), np.array(table.v_hill_m_s)
    if table.model is OrbitModel.TWO_BODY:
        return propagate_two_body(r_hill, v_hill, table.mean_motion_rad_s, times_s)
    start = np.concatenate([r_hill, v_hill])
    return np.stack([hill_transition(table.mean_motion_rad_s, float(t)) @ start for t in times_s])


def _rotation(
    body: BodyTable, inertia: FloatArray, times_s: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """(n, 3, 3) R_world_body and (n, 3) body rates of a torque-free body."""
    attitude = exp_rotation(np.deg2rad(np.array(body.attitude_rotvec_deg)))
    omega = np.deg2rad(np.array(body.omega_body_deg_s))
    return rotate_torque_free(attitude, omega, inertia, times_s)


def rotate_torque_free(
    R_world_body: FloatArray, omega_body: FloatArray, inertia: FloatArray, times_s: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """(n, 3, 3) attitudes and (n, 3) body rates (rad/s) at increasing times; state given at [0].

    The attitude is integrated as a quaternion, ``q' = q * (omega, 0) / 2``, with DOP853 to a
    relative tolerance of 1e-12 and normalised afterwards. The scale of the inertia is free.
    """
    if len(times_s) == 1:
        return R_world_body[None], omega_body[None]
    inverse = np.linalg.inv(inertia)

    def derivative(_: float, state: FloatArray) -> FloatArray:
        # Plain floats: a numpy call on three numbers costs more than the arithmetic.
        x, y, z, w, p, q, r = state.tolist()
        a, b, c = (inertia @ state[4:]).tolist()
        torque = np.array([b * r - c * q, c * p - a * r, a * q - b * p])
        attitude_rate = (
            0.5 * (w * p + y * r - z * q),
            0.5 * (w * q + z * p - x * r),
            0.5 * (w * r + x * q - y * p),
            -0.5 * (x * p + y * q + z * r),
        )
        return np.concatenate([attitude_rate, inverse @ torque])

    start = np.concatenate([xyzw_from_rotation(R_world_body), omega_body])
    span = (float(times_s[0]), float(times_s[-1]))
    # The rate's absolute tolerance follows the rate: a slow tumble is as exact as a fast one.
    tolerance = np.array([1e-13] * 4 + [1e-13 * float(np.linalg.norm(omega_body)) + 1e-300] * 3)
    solution = solve_ivp(
        derivative, span, start, method="DOP853", t_eval=times_s, rtol=1e-12, atol=tolerance
    )
    return rotation_from_xyzw(solution.y[:4].T), np.asarray(solution.y[4:].T)
