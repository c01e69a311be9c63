"""The frames of an arc that were compared with rendered views, all at once."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import cholesky, solve_triangular

from pcnav.core.arrays import BoolArray, FloatArray, IntArray
from pcnav.core.spatial import left_jacobian, log_rotation, skew
from pcnav.dynamics.state import COM_MODEL, R_HILL, STATE_SIZE, THETA_BODY, NavigationState
from pcnav.estimators.depth.pose_measurement import PoseMeasurement
from pcnav.filtering.map_arc_fit import ArcMeasurements, OneByOne, TimedMeasurements, Whitened
from pcnav.perception.modality import POSE_SIZE

Timed = TimedMeasurements[NavigationState]


@dataclass(frozen=True)
class ArcOfPoses(ArcMeasurements[NavigationState]):
    """Frames with one measurement of the pose in a batch, whatever else there is one by one."""

    frames: IntArray
    """(f,) with one measurement of the pose."""
    T_cam_model: FloatArray
    """(f, 4, 4) that it is about."""
    T_cam_world: FloatArray
    """(f, 4, 4)"""
    R_hill_world: FloatArray
    """(f, 3, 3)"""
    rows: FloatArray
    """(f, 6, 6) the combinations of its error that were measured, zero beyond the last."""
    value: FloatArray
    """(f, 6) of them."""
    is_measured: BoolArray
    """(f, 6) which there are."""
    others: OneByOne[NavigationState]

    @staticmethod
    def of(arc: Sequence[Timed]) -> "ArcOfPoses":
        """Of an arc, of frames as `condensed` has them at best."""
        poses = [(k, pose) for k, timed in enumerate(arc) if (pose := _only_pose(timed))]
        together = {k for k, _ in poses}
        others = [
            TimedMeasurements(t.time_s, () if k in together else t.measurements)
            for k, t in enumerate(arc)
        ]
        rows, value = (
            np.zeros((len(poses), POSE_SIZE, POSE_SIZE)),
            np.zeros((len(poses), POSE_SIZE)),
        )
        is_measured = np.zeros(value.shape, np.bool_)
        for into, number, there, (_, pose) in zip(rows, value, is_measured, poses, strict=True):
            there[: len(pose.value)] = True
            into[there], number[there] = _whitened(pose)
        references = [pose.reference for _, pose in poses]
        return ArcOfPoses(
            frames=np.array([k for k, _ in poses], np.intp),
            T_cam_model=_stacked([r.T_cam_model for r in references], 4),
            T_cam_world=_stacked([r.observer.T_cam_world for r in references], 4),
            R_hill_world=_stacked([r.observer.R_hill_world for r in references], 3),
            rows=rows,
            value=value,
            is_measured=is_measured,
            others=OneByOne(others),
        )

    def about(self, states: NavigationState) -> list[Whitened]:
        """See `ArcMeasurements.about`: the same as each measurement gives of its state."""
        found = self.others.about(states)
        if not len(self.frames):
            return found
        error, by_state = self._error(states)
        residual = self.value - (self.rows @ error[..., None])[..., 0]
        return [*found, Whitened(self.frames, residual, self.rows @ by_state, self.is_measured)]

    def _error(self, states: NavigationState) -> tuple[FloatArray, FloatArray]:
        """(f, 6) `pose_error` of the states' poses, and its derivative (f, 6, 20) by their errors:
        see `PoseReference.linearised`."""
        R_world_body, com = states.R_world_body[self.frames], states.com_model[self.frames]
        R_cam_world = self.T_cam_world[:, :3, :3]
        R_cam_hill = R_cam_world @ np.swapaxes(self.R_hill_world, -1, -2)
        R_cam_body = R_cam_world @ R_world_body
        p_cam = _times(R_cam_hill, states.r_hill[self.frames]) - _times(R_cam_body, com)
        shift = p_cam + self.T_cam_world[:, :3, 3] - self.T_cam_model[:, :3, 3]
        turn = log_rotation(np.swapaxes(self.T_cam_model[:, :3, :3], -1, -2) @ R_cam_body)
        by_state = np.zeros((len(turn), POSE_SIZE, STATE_SIZE))
        by_state[:, :3, R_HILL] = R_cam_hill
        by_state[:, :3, COM_MODEL] = -R_cam_body
        by_state[:, :3, THETA_BODY] = R_cam_body @ skew(com)
        # log(exp(turn) exp(d)) = turn + J_r(turn)^-1 d.
        by_state[:, 3:, THETA_BODY] = np.linalg.inv(left_jacobian(-turn))
        return np.hstack([shift, turn]), by_state


def _only_pose(timed: Timed) -> PoseMeasurement | None:
    one = timed.measurements[0] if len(timed.measurements) == 1 else None
    if not isinstance(one, PoseMeasurement) or one.by_rate is not None:
        return None
    return one if len(one.value) <= POSE_SIZE else None


def _whitened(pose: PoseMeasurement) -> tuple[FloatArray, FloatArray]:
    """Rows (m, 6) and values (m,) of unit variance."""
    if pose.shared is None:
        return pose.rows, pose.value
    both = np.column_stack([pose.rows, pose.value])
    whitened = solve_triangular(cholesky(pose.covariance, lower=True), both, lower=True)
    return whitened[:, :-1], whitened[:, -1]


def _stacked(matrices: list[FloatArray], size: int) -> FloatArray:
    return np.array(matrices).reshape(-1, size, size)


def _times(matrices: FloatArray, vectors: FloatArray) -> FloatArray:
    return np.asarray((matrices @ vectors[..., None])[..., 0])
