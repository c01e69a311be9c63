"""The true motion of a scenario: relative orbit, rotation, and whence it is seen.

Without disturbances the rotation, and the orbits of two point masses, are integrated to a relative
tolerance of 1e-12. White disturbance accelerations, where asked for, are drawn step by step
between the frames. A motion that is not that of a free body is prescribed by [motion].
"""

from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np
from scipy.integrate import solve_ivp

from pcnav.config.motion import MotionKind, MotionTable, Mover
from pcnav.config.pipeline_file import Pipeline
from pcnav.config.scenario import OrbitModel, OrbitTable
from pcnav.core.arrays import FloatArray
from pcnav.core.errors import InputError
from pcnav.core.spatial import (
    exp_rotation,
    invert_transform,
    make_transform,
    rotation_from_xyzw,
    xyzw_from_rotation,
)
from pcnav.dynamics import blocks
from pcnav.dynamics.kepler import KeplerOrbit, propagate_relative, step_relative
from pcnav.dynamics.orbit import R_hill_world, hill_transition
from pcnav.dynamics.rotation_step import rotate, torque_free
from pcnav.dynamics.state import NavigationState
from pcnav.dynamics.trajectory import Trajectory
from pcnav.simulation.carried import Displacement, displacement

_MAX_TURN_RAD = 0.02
"""Rotation in one Runge-Kutta step: its error, of order turn^5 / 120, stays below 1e-10 rad."""
_MOTION_STREAM = 1
"""Beside the seed: what a motion draws is neither the truth's start nor a frame's noise."""


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
        com_model=body.com_model,
        R_world_body=exp_rotation(np.deg2rad(np.array(body.attitude_rotvec_deg))),
        omega_body=np.deg2rad(np.array(body.omega_body_deg_s)),
        inertia_ratios=body.ratios,
    )


def true_motion(pipeline: Pipeline, source: Path | str = "pipeline") -> TrueMotion:
    """The motion of a pipeline's scenario before a camera that is fixed in the Hill frame, or
    carried about the target where [motion] says so.

    ``source`` is the file an `InputError` names: raised for an orbit that is no circle.
    """
    if pipeline.orbit.model is OrbitModel.KEPLER:
        expected = 'expected "hill" or "two_body": depth sequences are made on circular orbits'
        raise InputError(source, "orbit.model", expected)
    times_s, start, table = frame_times(pipeline), start_of(pipeline), pipeline.motion
    moved = None
    if table.is_displaced:
        rng = np.random.default_rng([pipeline.seed, _MOTION_STREAM])
        moved = displacement(table, times_s, rng)
    if moved is not None and table.mover is Mover.TARGET:
        orbit, R, omega = _displaced(start, times_s, moved)
    else:
        orbit, R, omega = _driven(pipeline.orbit, table, start, times_s)
    truth = trajectory_of(times_s, start, orbit, R, omega)
    n = pipeline.orbit.mean_motion_rad_s
    hill = np.stack([R_hill_world(float(t), n) for t in times_s])
    R_cam_hill = pipeline.camera.R_cam_hill
    T_cam_world = make_transform(R_cam_hill @ hill, np.zeros(3))
    if moved is not None and table.mover is Mover.CAMERA:
        T_cam_world = _about(R_cam_hill @ start.r_hill, moved) @ T_cam_world
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

    See `rotate_driven`. The scale of the inertia is free.
    """
    return rotate_driven(R_world_body, omega_body, inertia, np.zeros(3), times_s)


def rotate_driven(
    R_world_body: FloatArray,
    omega_body: FloatArray,
    inertia: FloatArray,
    acceleration_body: FloatArray,
    times_s: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """As `rotate_torque_free`, under a torque that is constant in body axes: (3,) rad/s^2, the
    angular acceleration it gives the body at rest.

    The attitude is integrated as a quaternion, ``q' = q * (omega, 0) / 2``, with DOP853 to a
    relative tolerance of 1e-12 and normalised afterwards.
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
        return np.concatenate([attitude_rate, inverse @ torque + acceleration_body])

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


_Moved = tuple[FloatArray, FloatArray, FloatArray]
"""(n, 6) r and v in Hill axes, (n, 3, 3) R_world_body, (n, 3) body rates."""


def _driven(
    orbit: OrbitTable, table: MotionTable, start: NavigationState, times_s: FloatArray
) -> _Moved:
    """A free motion with what [motion] does to it."""
    if table.kind is MotionKind.SPIN:
        angle = times_s[:, None] * start.omega_body
        R = start.R_world_body @ exp_rotation(angle)
        rates = np.tile(start.omega_body, (len(times_s), 1))
        return _circular_orbit(orbit, start, times_s), R, rates
    if table.kind not in (MotionKind.IMPULSE, MotionKind.TORQUE):
        return _free(orbit, start, times_s)
    before, after = times_s[times_s <= table.at_s], times_s[times_s > table.at_s]
    if not after.size:
        return _free(orbit, start, times_s)
    # The time of the change need not be that of a frame.
    until = np.union1d(before, [table.at_s])
    first = _free(orbit, start, until)
    then = replace(
        start,
        r_hill=first[0][-1, :3],
        v_hill=first[0][-1, 3:],
        R_world_body=first[1][-1],
        omega_body=first[2][-1],
    )
    since, acceleration = np.concatenate([[0.0], after - table.at_s]), np.zeros(3)
    if table.kind is MotionKind.IMPULSE:
        omega = then.omega_body + np.deg2rad(table.impulse_omega_deg_s)
        v_hill = then.v_hill + np.array(table.impulse_v_m_s)
        then = replace(then, v_hill=v_hill, omega_body=omega)
    else:
        acceleration = np.deg2rad(table.torque_deg_s2)
    second = _free(orbit, then, since, acceleration)
    n = len(before)
    orbits, R, rates = (np.concatenate([a[:n], b[1:]]) for a, b in zip(first, second, strict=True))
    return orbits, R, rates


def _free(
    orbit: OrbitTable,
    start: NavigationState,
    times_s: FloatArray,
    acceleration_body: FloatArray | None = None,
) -> _Moved:
    """From the start at [0] on, under no torque but a constant one."""
    acceleration = np.zeros(3) if acceleration_body is None else acceleration_body
    R, omega = rotate_driven(
        start.R_world_body, start.omega_body, start.inertia, acceleration, times_s
    )
    return _circular_orbit(orbit, start, times_s), R, omega


def _displaced(start: NavigationState, times_s: FloatArray, moved: Displacement) -> _Moved:
    """About the straight line from the start on: what is carried is on no orbit."""
    r_hill = start.r_hill + times_s[:, None] * start.v_hill + moved.shift_m
    v_hill = start.v_hill + moved.shift_rate_m_s
    return np.hstack([r_hill, v_hill]), start.R_world_body @ moved.R, moved.omega


def _about(p_cam: FloatArray, moved: Displacement) -> FloatArray:
    """(n, 4, 4) T_moved_cam of a camera that turns about a point before it, and is shifted."""
    away = make_transform(np.eye(3), p_cam)
    turned = make_transform(moved.R, moved.shift_m)
    return np.asarray(away @ turned @ invert_transform(away))


def _circular_orbit(table: OrbitTable, start: NavigationState, times_s: FloatArray) -> FloatArray:
    """(n, 6) position and velocity in Hill axes, of the start at time 0."""
    if table.model is OrbitModel.TWO_BODY:
        orbit = KeplerOrbit(table.mean_motion_rad_s)
        return propagate_relative(orbit, start.r_hill, start.v_hill, times_s)
    state = np.concatenate([start.r_hill, start.v_hill])
    return np.stack([hill_transition(table.mean_motion_rad_s, float(t)) @ state for t in times_s])


def _kick(
    psd: float | FloatArray, step_s: float, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    """What white noise of a power spectral density adds to a place and to its rate in a step."""
    first, second = rng.standard_normal((2, 3))
    rate = np.sqrt(psd * step_s) * first
    # The place is the integral of the noise's integral: half of the rate's change, and what is
    # independent of it.
    return 0.5 * step_s * rate + np.sqrt(psd * step_s**3 / 12.0) * second, rate
