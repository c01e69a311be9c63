"""What errors of the calibration add to the covariance of a filter that knows nothing of them.

They are considered, not estimated (Schmidt 1966): the filter stays as it is, and beside it goes
what each of them makes of its state. One that stays what it is moves the state by the same
transitions and gains as the filter's own error; what is drawn anew for every frame adds up as
noise does.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from pcnav.core.arrays import FloatArray
from pcnav.core.camera import PinholeCamera
from pcnav.dynamics.state import R_HILL, STATE_SIZE, THETA_BODY
from pcnav.estimators.depth.camera_noise import CameraNoise
from pcnav.estimators.depth.influence import Influence
from pcnav.estimators.depth.measuring import Kalman
from pcnav.estimators.depth.pose_measurement import ObserverPose, pose_rate
from pcnav.perception.calibration_evidence import evidence_of_fields
from pcnav.perception.calibration_fields import FIELD_NAMES
from pcnav.perception.modality import POSE_SIZE
from pcnav.perception.render_compare import Comparison
from pcnav.recordings.calibration import NOT_STATED, Calibration

_NAMES = (*FIELD_NAMES, "time offset", *("camera mount",) * POSE_SIZE)


@dataclass(frozen=True)
class SeenBy:
    """A frame that a filter was updated with, and how well its camera is known."""

    camera: PinholeCamera
    calibration: Calibration
    comparison: Comparison
    used: tuple[bool, ...]
    """Which of its faces were."""


class CalibrationErrors:
    """Of one track."""

    def __init__(self) -> None:
        self._by_error = np.zeros((STATE_SIZE, len(_NAMES)))
        """By errors of one standard deviation that stay what they are."""
        self._by_jitter = np.zeros((STATE_SIZE, STATE_SIZE))
        """(20, 20) covariance."""
        self._counted = np.zeros(len(_NAMES) + 1, dtype=np.bool_)
        """Of each error, and of time stamps: whether it was stated, and moves the target in the
        camera."""
        self._in_a_jitter = np.zeros(STATE_SIZE)
        """How the state changes in one standard deviation of a time stamp."""

    @property
    def covariance(self) -> FloatArray:
        """(20, 20) of all of them."""
        return np.asarray(self._by_error @ self._by_error.T + self._of_stamps)

    @property
    def in_camera(self) -> FloatArray:
        """(20, 20) of those that move the target in the camera, as far as they were stated: where
        the camera sits on the chaser moves both alike, and what is assumed where nothing was stated
        would leave the pose of a small target open for good."""
        by_error = self._by_error[:, self._counted[:-1]]
        return np.asarray(by_error @ by_error.T + self._counted[-1] * self._of_stamps)

    @property
    def budget(self) -> Mapping[str, FloatArray]:
        """(20, 20) of each by its name."""
        parts = {"time stamps": self._of_stamps}
        for name, moved in zip(_NAMES, self._by_error.T, strict=True):
            parts[name] = parts.get(name, 0.0) + np.outer(moved, moved)
        return parts

    @property
    def _of_stamps(self) -> FloatArray:
        """What they do to the state, and by how much it is that of another time than its own."""
        return np.asarray(self._by_jitter + np.outer(self._in_a_jitter, self._in_a_jitter))

    def predict(self, transition: FloatArray) -> None:
        """Follow a filter whose error (20) was just moved by (20, 20)."""
        self._by_error = transition @ self._by_error
        self._by_jitter = transition @ self._by_jitter @ transition.T

    def take_in(
        self,
        influence: Influence,
        kalman: Kalman,
        observer: ObserverPose,
        seen: SeenBy,
        frames: int,
    ) -> None:
        """Follow a filter that was just updated with a frame.

        Args:
            influence: of the frame on the filter.
            kalman: the filter.
            observer: where the camera was.
            seen: the frame.
            frames: of the track, so far.
        """
        calibration, comparison = seen.calibration, seen.comparison
        if calibration.is_exact:
            return
        stated = calibration.of_image(seen.camera) != NOT_STATED.of_image(seen.camera)
        jitters = calibration.stamp_jitter_sd_s != NOT_STATED.stamp_jitter_sd_s
        self._counted = np.array([*stated, True, *(False,) * POSE_SIZE, jitters])
        fields = evidence_of_fields(comparison.seen, comparison.places(seen.used))
        fields = fields * calibration.of_image(seen.camera)
        rate = pose_rate(kalman.state, observer)
        self._in_a_jitter[R_HILL] = calibration.stamp_jitter_sd_s * kalman.state.v_hill
        self._in_a_jitter[THETA_BODY] = calibration.stamp_jitter_sd_s * kalman.state.omega_body
        moved = np.hstack(
            [
                influence.by_evidence @ influence.of_pose @ fields,
                influence.by_pose(calibration.time_offset_sd_s * rate[:, None]),
                influence.by_pose(_by_mount(calibration, comparison.T_cam_model)),
            ]
        )
        self._by_error = influence.kept @ self._by_error + moved
        jitter = influence.by_pose(calibration.stamp_jitter_sd_s * rate[:, None])
        share = 1.0 if influence.of_first is None else 1.0 / frames
        before = influence.kept @ self._by_jitter @ influence.kept.T
        self._by_jitter = before + share * jitter @ jitter.T


def _by_mount(calibration: Calibration, T_cam_model: FloatArray) -> FloatArray:
    """(6, 6) by which a pose (4, 4) in the camera is off, by errors of where the camera sits."""
    mount = CameraNoise(calibration.mount_position_sd_m, calibration.mount_attitude_sd_rad)
    return mount.by_unit(T_cam_model) if mount.is_there else np.zeros((POSE_SIZE, POSE_SIZE))
