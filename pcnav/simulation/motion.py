"""The true motion of a scenario: relative orbit, torque-free rotation, and whence it is seen.

Without disturbances the rotation, and the orbits of two point masses, are integrated to a relative
tolerance of 1e-12. White disturbance accelerations, where asked for, are drawn step by step
between the frames.
"""

from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np
from scipy.integrate import solve_ivp

from pcnav.config.pipeline_file import Pipeline
from pcnav.config.scenario import OrbitModel, OrbitTable
from pcnav.core.arrays import FloatArray
from pcnav.core.errors import InputError
from pcnav.core.spatial import exp_rotation, make_transform, rotation_from_xyzw, xyzw_from_rotation
from pcnav.dynamics import blocks
from pcnav.dynamics.kepler import KeplerOrbit, propagate_relative, step_relative
from pcnav.dynamics.orbit import R_hill_world, hill_transition
from pcnav.dynamics.rotation_step import rotate, torque_free
from pcnav.dynamics.state import NavigationState
from pcnav.dynamics.trajectory import Trajectory

_MAX_TURN_RAD = 0.02
"""Rotation in one Runge-Kutta step: its error, of order turn^5 / 120, stays below 1e-10 rad."""


@dataclass(frozen=True)
class TrueMotion:
    """A true motion and the camera, at the chaser's mass centre, that sees it."""

    truth: Trajectory
    """All blocks, and the poses of the model in the camera."""
    T_cam_world: FloatArray
    """(n, 4, 4)"""
    R_hill_world: FloatArray
    """(n, 3, 3)"""

    @staticmethod
    def of(truth: Trajectory, T_cam_world: FloatArray, R_hill_world: FloatArray) -> "TrueMotion":
        """Of a motion that has all blocks; the poses follow from them."""
        poses = [
            NavigationState.of(truth, k).T_cam_model(T_cam_world[k], R_hill_world[k])
            for k in range(len(truth))
        ]
        return TrueMotion(replace(truth, T_cam_target=np.stack(poses)), T_cam_world, R_hill_world)

    def __len__(self) -> int:
        return len(self.truth)

    def state(self, k: int) -> NavigationState:
        """The true state in frame k."""
        return NavigationState.of(self.truth, k)


def frame_times(pipeline: Pipeline) -> FloatArray:
    """(n,) times of the frames, s; the first is 0."""
    return np.arange(pipeline.scenario.frames) / pipeline.scenario.frame_rate_hz


def start_of(pipeline: Pipeline) -> NavigationState:
    """The true state at time 0, at which world and Hill axes are the same."""
    body, orbit = pipeline.body, pipeline.orbit
    return NavigationState(
        r_hill=np.array(orbit.r_hill_m),
        v_hill=np.array(orbit.v_hill_m_s),
        com_model=np.array(body.com_model_m),
        R_world_body=exp_rotation(np.deg2rad(np.array(body.attitude_rotvec_deg))),
        omega_body=np.deg2rad(np.array(body.omega_body_deg_s)),
        inertia_ratios=np.array(body.inertia_ratios),
    )


def true_motion(pipeline: Pipeline, source: Path | str = "pipeline") -> TrueMotion:
    """The motion of a pipeline's scenario before a camera that is fixed in the Hill frame.

    ``source`` is the file an `InputError` names: raised for an orbit that is no circle.
    """
    if pipeline.orbit.model is OrbitModel.KEPLER:
        expected = 'expected "hill" or "two_body": depth sequences are made on circular orbits'
        raise InputError(source, "orbit.model", expected)
    times_s, start = frame_times(pipeline), start_of(pipeline)
    R, omega = rotate_torque_free(start.R_world_body, start.omega_body, start.inertia, times_s)
    truth = trajectory_of(times_s, start, _circular_orbit(pipeline.orbit, times_s), R, omega)
    n = pipeline.orbit.mean_motion_rad_s
    hill = np.stack([R_hill_world(float(t), n) for t in times_s])
    T_cam_world = make_transform(pipeline.camera.R_cam_hill @ hill, np.zeros(3))
    return TrueMotion.of(truth, T_cam_world, hill)


def trajectory_of(
    times_s: FloatArray,
    start: NavigationState,
    orbit: FloatArray,
    R_world_body: FloatArray,
    omega_body: FloatArray,
) -> Trajectory:
    """All blocks over times (n,): of orbits (n, 6) in Hill axes and rotations, and the constants of
    the state at the start."""
    n = len(times_s)
    values = {
        blocks.POSITION.name: orbit[:, :3],
        blocks.VELOCITY.name: orbit[:, 3:],
        blocks.CENTRE.name: np.tile(start.com_model, (n, 1)),
        blocks.ATTITUDE.name: R_world_body,
        blocks.RATE.name: omega_body,
        blocks.RATIOS.name: np.tile(start.inertia_ratios, (n, 1)),
    }
    return Trajectory(times_s, blocks.MASS_CENTRE_LAYOUT, values)


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


def disturbed_orbit(
    model: OrbitModel,
    orbit: KeplerOrbit,
    start: NavigationState,
    times_s: FloatArray,
    acceleration_psd_m2_s3: float,
    rng: np.random.Generator,
) -> FloatArray:
    """(n, 6) true r (m) and v (m/s) in Hill axes at increasing times, from the start at [0]."""
    linear = model is OrbitModel.HILL
    if acceleration_psd_m2_s3 == 0.0 and not linear:
        return propagate_relative(orbit, start.r_hill, start.v_hill, times_s)
    states = [np.concatenate([start.r_hill, start.v_hill])]
    for before, after in pairwise(times_s.tolist()):
        state, step = states[-1], after - before
        if linear:
            moved = hill_transition(orbit.mean_motion_rad_s, step) @ state
        else:
            r, v, _ = step_relative(orbit, state[:3], state[3:], before, step)
            moved = np.concatenate([r, v])
        states.append(moved + np.concatenate(_kick(acceleration_psd_m2_s3, step, rng)))
    return np.stack(states)


def disturbed_rotation(
    start: NavigationState,
    times_s: FloatArray,
    angular_acceleration_psd_rad2_s3: float | FloatArray,
    rng: np.random.Generator,
) -> tuple[FloatArray, FloatArray]:
    """(n, 3, 3) true R_world_body and (n, 3) body rates, rad/s, at increasing times.

    The disturbance is the same about all body axes, or (3,) about each.
    """
    inertia = start.inertia
    if not np.any(angular_acceleration_psd_rad2_s3):
        return rotate_torque_free(start.R_world_body, start.omega_body, inertia, times_s)
    slope = torque_free(inertia, np.asarray(np.linalg.inv(inertia)))
    attitudes, rates = [start.R_world_body], [start.omega_body]
    for before, after in pairwise(times_s.tolist()):
        step = after - before
        done = rotate(slope, rates[-1], step, 0, _MAX_TURN_RAD)
        angle, change = _kick(angular_acceleration_psd_rad2_s3, step, rng)
        attitudes.append(attitudes[-1] @ done.turn @ exp_rotation(angle))
        rates.append(done.omega_body + change)
    return np.stack(attitudes), np.stack(rates)


def _circular_orbit(table: OrbitTable, times_s: FloatArray) -> FloatArray:
    """(n, 6) position and velocity in Hill axes."""
    r_hill, v_hill = np.array(table.r_hill_m), np.array(table.v_hill_m_s)
    if table.model is OrbitModel.TWO_BODY:
        return propagate_relative(KeplerOrbit(table.mean_motion_rad_s), r_hill, v_hill, times_s)
    start = np.concatenate([r_hill, v_hill])
    return np.stack([hill_transition(table.mean_motion_rad_s, float(t)) @ start for t in times_s])


def _kick(
    psd: float | FloatArray, step_s: float, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    """What white noise of a power spectral density adds to a place and to its rate in a step."""
    first, second = rng.standard_normal((2, 3))
    rate = np.sqrt(psd * step_s) * first
    # The place is the integral of the noise's integral: half of the rate's change, and what is
    # independent of it.
    return 0.5 * step_s * rate + np.sqrt(psd * step_s**3 / 12.0) * second, rate
