"""What a comparison with a rendered view says of the navigation state.

A face gives information about the error of the pose it was rendered at, often not about all six
components: a plane determines no shift within itself. The measurement keeps the combinations
that are known, scaled to unit variance.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import cholesky, solve_triangular

from pcnav.core.arrays import FloatArray
from pcnav.core.spatial import exp_rotation, left_jacobian, log_rotation, skew
from pcnav.dynamics.orbit import R_hill_world
from pcnav.dynamics.state import (
    COM_MODEL,
    OMEGA_BODY,
    R_HILL,
    STATE_SIZE,
    THETA_BODY,
    V_HILL,
    NavigationState,
)
from pcnav.estimators.depth.camera_noise import EXACT, CameraNoise
from pcnav.perception.modality import POSE_SIZE, Evidence

_MIN_SHARE = 1e-9
"""Combinations with less than this share of the largest information are unknown: rounding."""
_ABOUT_SD = 1.5
"""So many deviations away lie the poses that are tried about one."""


@dataclass(frozen=True)
class ObserverPose:
    """Where the camera is at the time of a frame."""

    T_cam_world: FloatArray
    """(4, 4)"""
    R_hill_world: FloatArray
    """(3, 3)"""
    noise: CameraNoise = EXACT
    """Of T_cam_world."""

    @staticmethod
    def of(
        T_cam_world: FloatArray,
        time_s: float,
        mean_motion_rad_s: float,
        noise: CameraNoise = EXACT,
    ) -> "ObserverPose":
        """At a time, for a chaser on a circular orbit."""
        return ObserverPose(T_cam_world, R_hill_world(time_s, mean_motion_rad_s), noise)

    @property
    def R_cam_hill(self) -> FloatArray:
        """(3, 3)"""
        return np.asarray(self.T_cam_world[:3, :3] @ self.R_hill_world.T)


UncertainPose = tuple[FloatArray, FloatArray]
"""T_cam_model (4, 4) and the covariance (6, 6) of its error."""


class PoseReference:
    """The pose that the faces of a frame were compared with; they share its small computations."""

    def __init__(
        self, T_cam_model: FloatArray, observer: ObserverPose, rate: FloatArray | None = None
    ) -> None:
        """``T_cam_model`` is (4, 4); ``rate`` (6,) the target's own motion, as `pose_rate`, that
        the frame was compared under, where it matters."""
        self.T_cam_model, self.observer, self.rate = T_cam_model, observer, rate
        self._last: tuple[NavigationState, FloatArray, FloatArray] | None = None

    def linearised(self, state: NavigationState) -> tuple[FloatArray, FloatArray]:
        """`pose_error` (6,) of a state's pose, and its derivative (6, 20) by the error state."""
        if self._last is None or self._last[0] is not state:
            observer = self.observer
            pose = state.T_cam_model(observer.T_cam_world, observer.R_hill_world)
            error = pose_error(self.T_cam_model, pose)
            by_state = pose_jacobian(state, observer)
            # log(exp(turn) exp(d)) = turn + J_r(turn)^-1 d.
            by_state[3:] = np.linalg.solve(left_jacobian(-error[3:]), by_state[3:])
            self._last = (state, error, by_state)
        return self._last[1:]

    def linearised_rate(self, state: NavigationState) -> tuple[FloatArray, FloatArray]:
        """`pose_rate` (6,) of a state less that of the reference, and its derivative (6, 20)."""
        assert self.rate is not None, "it matters"
        off = pose_rate(state, self.observer) - self.rate
        return off, pose_rate_jacobian(state, self.observer)


@dataclass(frozen=True)
class PoseMeasurement:
    """Combinations of the error of a predicted pose, each with unit variance.

    The error is `pose_error` from the reference to the true pose as the camera would see it from
    where it is recorded to be. Measurements of one frame may err in common, too.
    """

    reference: PoseReference
    rows: FloatArray
    """(m, 6) the combinations."""
    value: FloatArray
    """(m,) measured."""
    shared: FloatArray | None = None
    """(m, k) derivative of the value by errors of unit variance that the frame shares, if any: the
    sensor's, then those of the camera's pose."""
    by_rate: FloatArray | None = None
    """(m, 6) derivative of the value by the target's own motion, as `pose_rate`, where the frame
    takes time."""
    considered: FloatArray | None = None
    """(m, k) derivative of the value by errors of unit variance that it is gated by and not weighed
    by, if any."""

    @staticmethod
    def from_information(
        reference: PoseReference,
        information: FloatArray,
        vector: FloatArray,
        lever_m: float,
        by_rate: FloatArray | None = None,
    ) -> "PoseMeasurement":
        """From an information matrix (6 + k, 6 + k), maybe singular, and information times error
        (6 + k,), of the pose and k errors that the frame shares.

        ``lever_m`` makes rotations comparable with shifts: half the target's size. ``by_rate``
        (6 + k, 6) is the vector's derivative by the target's own motion.
        """
        [found] = PoseMeasurement.of_each(reference, [Evidence(information, vector)], lever_m)
        if by_rate is None:
            return found
        return replace(found, by_rate=square_root(information, by_rate, lever_m)[1])

    @staticmethod
    def of_each(
        reference: PoseReference, evidence: Sequence[Evidence], lever_m: float
    ) -> "list[PoseMeasurement]":
        """The same of each face of a frame, all of which share as many errors."""
        found: list[PoseMeasurement] = []
        by_camera = None
        if reference.observer.noise.is_there:
            by_camera = reference.observer.noise.by_unit(reference.T_cam_model)
        if not evidence:
            return found
        information, vector = zip(*evidence, strict=True)
        for rows, value in square_roots(information, vector, lever_m):
            of_pose, shared = rows[:, :POSE_SIZE], rows[:, POSE_SIZE:]
            if by_camera is not None:
                shared = np.hstack([shared, of_pose @ by_camera])
            some = shared if shared.shape[1] else None
            found.append(PoseMeasurement(reference, of_pose, value, some))
        return found

    def considering(
        self, information: FloatArray, by_error: FloatArray | None, lever_m: float
    ) -> "PoseMeasurement":
        """The same, made of an information matrix (6 + k, 6 + k) whose vector errors of unit
        variance move by the rows (m, 6 + k) of ``by_error``, which it is gated by."""
        if by_error is None:
            return self
        return replace(self, considered=square_root(information, by_error.T, lever_m)[1])

    @property
    def in_camera(self) -> "PoseMeasurement":
        """What it says of the pose in the camera, whatever errors the camera's own pose has."""
        if self.shared is None or not self.reference.observer.noise.is_there:
            return self
        return replace(self, shared=self.shared[:, :-POSE_SIZE])

    @property
    def covariance(self) -> FloatArray:
        """(m, m) the identity, and what the shared errors add to it."""
        own = np.eye(len(self.value))
        return own if self.shared is None else own + self.shared @ self.shared.T

    def residual(self, state: NavigationState) -> FloatArray:
        """(m,) measured minus predicted, in standard deviations."""
        residual = self.value - self.rows @ self.reference.linearised(state)[0]
        if self.by_rate is not None:
            residual = residual - self.by_rate @ self.reference.linearised_rate(state)[0]
        return np.asarray(residual)

    def jacobian(self, state: NavigationState) -> FloatArray:
        """(m, 20) derivative of the prediction by the error state."""
        jacobian = self.rows @ self.reference.linearised(state)[1]
        if self.by_rate is not None:
            jacobian = jacobian + self.by_rate @ self.reference.linearised_rate(state)[1]
        return np.asarray(jacobian)


def joined(measurements: Sequence[PoseMeasurement]) -> PoseMeasurement:
    """All that faces compared with one pose say, in six combinations at most; in twelve where what
    they say depends on how the target moves."""
    rows = np.vstack([measurement.rows for measurement in measurements])
    by_rate = [measurement.by_rate for measurement in measurements]
    rates = [each for each in by_rate if each is not None]
    if rates:
        rows = np.hstack([rows, np.vstack(rates)])
    value = np.concatenate([measurement.value for measurement in measurements])
    common = [measurement.shared for measurement in measurements if measurement.shared is not None]
    if common:
        shared = np.vstack(common)
        root = cholesky(np.eye(len(value)) + shared @ shared.T, lower=True)
        both = solve_triangular(root, np.column_stack([rows, value]), lower=True)
        rows, value = both[:, :-1], both[:, -1]
    # An orthogonal turn of whitened rows keeps them white; what is left of the values beyond the
    # sixth (or twelfth) says nothing of the pose.
    q, r = np.linalg.qr(rows)
    by_pose, moving = r[:, :POSE_SIZE], r[:, POSE_SIZE:] if rates else None
    return PoseMeasurement(measurements[0].reference, by_pose, q.T @ value, by_rate=moving)


def seen_pose(predicted: UncertainPose, measurements: Sequence[PoseMeasurement]) -> UncertainPose:
    """The pose in the camera as a frame shows it, whose camera's own pose is noisy.

    The error of the camera's pose is that of the prediction, not of what the frame measures.

    Args:
        predicted: with the noise of the camera's pose.
        measurements: of the frame, at least one.
    """
    at = joined([measurement.in_camera for measurement in measurements])
    known = np.asarray(np.linalg.inv(predicted[1]))
    reference = at.reference.T_cam_model
    covariance = np.asarray(np.linalg.inv(known + at.rows.T @ at.rows))
    vector = known @ pose_error(reference, predicted[0]) + at.rows.T @ at.value
    return moved_pose(reference, covariance @ vector), covariance


def pose_error(T_cam_from: FloatArray, T_cam_to: FloatArray) -> FloatArray:
    """(6,) from one pose (4, 4) to another: shift of the origin (m, camera axes), rotation vector
    (rad, model axes)."""
    shift = T_cam_to[:3, 3] - T_cam_from[:3, 3]
    return np.concatenate([shift, log_rotation(T_cam_from[:3, :3].T @ T_cam_to[:3, :3])])


def moved_pose(T_cam_model: FloatArray, error: FloatArray) -> FloatArray:
    """(4, 4) the pose moved by an error (6,): the inverse of `pose_error`."""
    moved = T_cam_model.copy()
    moved[:3, 3] += error[:3]
    moved[:3, :3] = moved[:3, :3] @ exp_rotation(error[3:])
    return moved


def poses_about(T_cam_model: FloatArray, covariance: FloatArray) -> Iterator[FloatArray]:
    """Poses (4, 4) on both sides of one, on the principal axes of its spread (6, 6).

    A fit from the pose itself may end beside a target that lies within the spread.
    """
    variances, axes = np.linalg.eigh(covariance)
    for step in (_ABOUT_SD * np.sqrt(np.maximum(variances, 0.0)) * axes).T:
        if step.any():
            yield moved_pose(T_cam_model, step)
            yield moved_pose(T_cam_model, -step)


def pose_jacobian(state: NavigationState, observer: ObserverPose) -> FloatArray:
    """(6, 20) change of the pose (as `pose_error`) by the error state.

    From ``p_cam = R_cam_hill r - R_cam_body com`` and the attitude error in body axes.
    """
    R_cam_body = observer.T_cam_world[:3, :3] @ state.R_world_body
    jacobian = np.zeros((6, STATE_SIZE))
    jacobian[:3, R_HILL] = observer.R_cam_hill
    jacobian[:3, COM_MODEL] = -R_cam_body
    jacobian[:3, THETA_BODY] = R_cam_body @ skew(state.com_model)
    jacobian[3:, THETA_BODY] = np.eye(3)
    return jacobian


def pose_rate(state: NavigationState, observer: ObserverPose) -> FloatArray:
    """(6,) by which the target's own motion changes its pose in the camera (as `pose_error`), m/s
    and rad/s."""
    R_cam_body = observer.T_cam_world[:3, :3] @ state.R_world_body
    about_centre = np.cross(state.omega_body, -state.com_model)
    of_origin = observer.R_cam_hill @ state.v_hill + R_cam_body @ about_centre
    return np.concatenate([of_origin, state.omega_body])


def pose_rate_jacobian(state: NavigationState, observer: ObserverPose) -> FloatArray:
    """(6, 20) change of `pose_rate` by the error state."""
    R_cam_body = observer.T_cam_world[:3, :3] @ state.R_world_body
    jacobian = np.zeros((6, STATE_SIZE))
    # Of R_cam_hill v + R_cam_body (com x omega).
    jacobian[:3, V_HILL] = observer.R_cam_hill
    jacobian[:3, COM_MODEL] = -R_cam_body @ skew(state.omega_body)
    jacobian[:3, OMEGA_BODY] = R_cam_body @ skew(state.com_model)
    jacobian[:3, THETA_BODY] = -R_cam_body @ skew(np.cross(state.com_model, state.omega_body))
    jacobian[3:, OMEGA_BODY] = np.eye(3)
    return jacobian


def pose_covariance(
    state: NavigationState, covariance: FloatArray, observer: ObserverPose
) -> FloatArray:
    """(6, 6) covariance of the pose, from that of the state (20, 20)."""
    jacobian = pose_jacobian(state, observer)
    return np.asarray(jacobian @ covariance @ jacobian.T)


def square_root(
    information: FloatArray, vector: FloatArray, lever_m: float
) -> tuple[FloatArray, FloatArray]:
    """Rows (m, 6 + k) and values (m, ...) with ``rows^T rows = information``, ``rows^T value =
    vector``, of one vector (6 + k,) or of several (6 + k, n)."""
    return next(square_roots([information], [vector], lever_m))


def square_roots(
    information: Sequence[FloatArray], vector: Sequence[FloatArray], lever_m: float
) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Of each of several, at least one and all of a size; of one, the calls take longer than the
    work."""
    scale = np.ones(len(vector[0]))
    scale[3:POSE_SIZE] = lever_m
    strengths, axes = np.linalg.eigh(np.stack(information) / np.outer(scale, scale))
    for strength, axis, each in zip(strengths, axes, vector, strict=True):
        known = strength > _MIN_SHARE * max(float(strength[-1]), 0.0)
        root, turned = np.sqrt(strength[known]), axis[:, known].T
        rows = (root[:, None] * turned) * scale
        yield rows, np.asarray((turned @ (each.T / scale).T).T / root).T
