"""The pose of the target in the first frame, where somebody knows it: how files state it."""

import math
from typing import Annotated, Self

from pydantic import AfterValidator, Strict, model_validator

from pcnav.config.table import Positive, StrictTable, Vector3

_NORM_TOLERANCE = 1e-3
"""Files round quaternions to as few as four digits."""


def _unit(values: tuple[float, float, float, float]) -> tuple[float, float, float, float]:
    length = math.sqrt(sum(value * value for value in values))
    if not abs(length - 1.0) < _NORM_TOLERANCE:
        raise ValueError(f"expected a unit quaternion, got one of length {length:.4g}")
    return values


UnitQuaternion = Annotated[tuple[float, float, float, float], Strict(False), AfterValidator(_unit)]


class FirstPoseTable(StrictTable):
    """The first pose with its spread: all absent, or at least the pose itself."""

    position_cam_m: Vector3 | None = None
    """Origin of the model in the camera frame of the first frame."""
    quaternion_cam_model_xyzw: UnitQuaternion | None = None
    """Attitude of the model in that frame, R_cam_model, scalar last."""
    position_sd_m: Positive | None = None
    """Standard deviation of each component of the position; None takes a share of its distance."""
    attitude_sd_deg: Positive | None = None
    """Standard deviation of the attitude about each axis; None takes 5 deg."""

    @model_validator(mode="after")
    def _pose_is_whole(self) -> Self:
        if (self.position_cam_m is None) != (self.quaternion_cam_model_xyzw is None):
            raise ValueError(
                "expected both of position_cam_m, quaternion_cam_model_xyzw, or neither"
            )
        spread = (self.position_sd_m, self.attitude_sd_deg)
        if self.position_cam_m is None and spread != (None, None):
            raise ValueError("position_sd_m, attitude_sd_deg: expected a pose that they are of")
        return self
