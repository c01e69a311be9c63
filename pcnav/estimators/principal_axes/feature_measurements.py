"""Measurements of Hu 2024's filter: pixels of features, or points and attitude as in print."""

from dataclasses import dataclass

import numpy as np

from pcnav.core.arrays import FloatArray, IntArray
from pcnav.core.spatial import left_jacobian, log_rotation
from pcnav.core.stereo import StereoRig
from pcnav.estimators.principal_axes.feature_states import (
    MOTION_SIZE,
    R_HILL,
    THETA,
    PrincipalState,
    point_slice,
)
from pcnav.filtering.error_state import Measurement
from pcnav.recordings.tracks import TrackFrame

_NEAREST_M = 0.05
"""Points are predicted no closer to the plane of the cameras; the gate refuses such anyway."""


class FeatureView:
    """The features of a frame as a state predicts them, all at once.

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
        p_rig[:, 2] = np.maximum(p_rig[:, 2], _NEAREST_M)
        by_rig = self._rig.projection_jacobian(p_rig)
        by_point = by_rig @ R_rig_body
        jacobian = np.zeros((n, 4, MOTION_SIZE + 3 * len(state.points)))
        # The error of the attitude turns the axes under the points: it moves none of them.
        jacobian[:, :, R_HILL] = by_rig @ self._R_rig_hill
        for k, slot in enumerate(self._slots.tolist()):
            start = MOTION_SIZE + 3 * slot
            jacobian[k, :, start : start + 3] = by_point[k]
        return self._frame.pixels - self._rig.project(p_rig), jacobian

    def measurements(self) -> "list[PixelMeasurement]":
        """One per feature."""
        return [PixelMeasurement(self, k) for k in range(len(self._slots))]


@dataclass(frozen=True)
class PixelMeasurement(Measurement[PrincipalState]):
    """The four pixel coordinates of one feature: (1) and (32) in one."""

    view: FeatureView
    row: int

    @property
    def name(self) -> str:
        """The feature."""
        return f"feature {self.view.features[self.row]}"

    @property
    def covariance(self) -> FloatArray:
        """(4, 4) px^2."""
        return self.view.covariance

    def residual(self, state: PrincipalState) -> FloatArray:
        """(4,) px."""
        return np.asarray(self.view.at(state)[0][self.row])

    def jacobian(self, state: PrincipalState) -> FloatArray:
        """(4, n)"""
        return np.asarray(self.view.at(state)[1][self.row])


@dataclass(frozen=True)
class PointMeasurement(Measurement[PrincipalState]):
    """A triangulated point in Hill axes: (32)."""

    feature: int
    slot: int
    p_hill: FloatArray
    """(3,) m."""
    noise: FloatArray
    """(3, 3) m^2, Hill axes."""
    R_hill_world: FloatArray

    @property
    def name(self) -> str:
        """The feature."""
        return f"feature {self.feature}"

    @property
    def covariance(self) -> FloatArray:
        """(3, 3) m^2."""
        return self.noise

    def residual(self, state: PrincipalState) -> FloatArray:
        """(3,) m."""
        R_hill_body = self.R_hill_world @ state.R_world_body
        return np.asarray(self.p_hill - state.r_hill - R_hill_body @ state.points[self.slot])

    def jacobian(self, state: PrincipalState) -> FloatArray:
        """(3, n) the rows of H in (35), in the errors of `feature_states`."""
        R_hill_body = self.R_hill_world @ state.R_world_body
        jacobian = np.zeros((3, MOTION_SIZE + 3 * len(state.points)))
        jacobian[:, R_HILL] = np.eye(3)
        jacobian[:, point_slice(self.slot)] = R_hill_body
        return jacobian


@dataclass(frozen=True)
class AttitudeMeasurement(Measurement[PrincipalState]):
    """The attitude of the determined principal frame: (31).

    It comes from the same pixels as the points: a filter that takes both counts them twice.
    """

    R_world_body: FloatArray
    """(3, 3) measured."""
    noise: FloatArray
    """(3, 3) rad^2, body axes."""

    @property
    def name(self) -> str:
        """What it is."""
        return "attitude"

    @property
    def covariance(self) -> FloatArray:
        """(3, 3) rad^2."""
        return self.noise

    def residual(self, state: PrincipalState) -> FloatArray:
        """(3,) rotation vector from the state's attitude to the measured one, rad."""
        return log_rotation(state.R_world_body.T @ self.R_world_body)

    def jacobian(self, state: PrincipalState) -> FloatArray:
        """(3, n): ``log(exp(-theta) exp(e)) = e - J_l(e)^-1 theta``."""
        jacobian = np.zeros((3, MOTION_SIZE + 3 * len(state.points)))
        jacobian[:, THETA] = np.linalg.inv(left_jacobian(self.residual(state)))
        return jacobian
