"""Measurements of Hu 2024's filter: pixels of features, or points and attitude as in print."""

from dataclasses import dataclass

import numpy as np

from pcnav.core.arrays import FloatArray, IntArray
from pcnav.core.stereo import StereoRig
from pcnav.estimators.principal_axes.feature_states import (
    PA_MOTION_SIZE,
    PA_R_HILL,
    PrincipalState,
    point_slice,
)
from pcnav.filtering.batched_filter import Member
from pcnav.recordings.tracks import TrackFrame

_MIN_DEPTH_M = 0.05
"""Points are predicted no closer to the plane of the cameras; the gate refuses such anyway."""


class FeatureView:
    """The features of a frame as a state predicts them: a `MeasurementSet`.

    The engine asks feature by feature, for residual and Jacobian and again for every iterate:
    what was found for the last state is kept.
    """

    def __init__(
        self, frame: TrackFrame, rig: StereoRig, R_hill_world: FloatArray, slots: IntArray
    ) -> None:
        """``slots`` (n,) are the places in the state of the features of the frame."""
        self._frame, self._rig, self._slots = frame, rig, slots
        self._R_rig_hill = frame.R_cam_world @ R_hill_world.T
        self.R_hill_world = R_hill_world
        self.covariance = rig.pixel_sigma_px**2 * np.eye(4)
        self._state: PrincipalState | None = None
        self._residual, self._jacobian = np.zeros((0, 4)), np.zeros((0, 4, 0))

    @property
    def features(self) -> IntArray:
        """(n,)"""
        return self._frame.features

    def at(self, state: PrincipalState) -> tuple[FloatArray, FloatArray]:
        """(n, 4) measured minus predicted pixels, (n, 4, 14 + 3N) derivative of the predicted."""
        if self._state is not state:
            self._state = state
            self._residual, self._jacobian = self._evaluated(state)
        return self._residual, self._jacobian

    def _evaluated(self, state: PrincipalState) -> tuple[FloatArray, FloatArray]:
        n = len(self._slots)
        R_rig_body = self._frame.R_cam_world @ state.R_world_body
        points = state.points[self._slots]
        p_rig = points @ R_rig_body.T + self._R_rig_hill @ state.r_hill
        p_rig[:, 2] = np.maximum(p_rig[:, 2], _MIN_DEPTH_M)
        by_rig = self._rig.projection_jacobian(p_rig)
        by_point = by_rig @ R_rig_body
        jacobian = np.zeros((n, 4, state.size))
        # The error of the attitude turns the axes under the points: it moves none of them.
        jacobian[:, :, PA_R_HILL] = by_rig @ self._R_rig_hill
        for k, slot in enumerate(self._slots.tolist()):
            start = PA_MOTION_SIZE + 3 * slot
            jacobian[k, :, start : start + 3] = by_point[k]
        return self._frame.pixels - self._rig.project(p_rig), jacobian

    @property
    def noise(self) -> FloatArray:
        """(n, 4, 4) px^2."""
        return np.broadcast_to(self.covariance, (len(self._slots), 4, 4))

    def residual(self, state: PrincipalState) -> FloatArray:
        """(n, 4) px."""
        return self.at(state)[0]

    def jacobian(self, state: PrincipalState) -> FloatArray:
        """(n, 4, 14 + 3N)"""
        return self.at(state)[1]

    def measurements(self) -> list[Member[PrincipalState]]:
        """One per feature: its four pixel coordinates, (1) and (32) in one."""
        return [Member(self, k) for k in range(len(self._slots))]


@dataclass(frozen=True)
class PointMeasurement:
    """A triangulated point in Hill axes: (32)."""

    slot: int
    p_hill: FloatArray
    """(3,) m."""
    covariance: FloatArray
    """(3, 3) m^2, Hill axes."""
    R_hill_world: FloatArray

    def residual(self, state: PrincipalState) -> FloatArray:
        """(3,) m."""
        R_hill_body = self.R_hill_world @ state.R_world_body
        return np.asarray(self.p_hill - state.r_hill - R_hill_body @ state.points[self.slot])

    def jacobian(self, state: PrincipalState) -> FloatArray:
        """(3, n) the rows of H in (35), in the errors of `feature_states`."""
        R_hill_body = self.R_hill_world @ state.R_world_body
        jacobian = np.zeros((3, state.size))
        jacobian[:, PA_R_HILL] = np.eye(3)
        jacobian[:, point_slice(self.slot)] = R_hill_body
        return jacobian
