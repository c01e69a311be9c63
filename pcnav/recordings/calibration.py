"""How well the camera, its clock and the target's mesh are known: what errs alike in all frames."""

from dataclasses import dataclass, fields

import numpy as np

from pcnav.core.arrays import FloatArray
from pcnav.core.camera import PinholeCamera
from pcnav.recordings.frame_checks import required_numbers


@dataclass(frozen=True)
class Calibration:
    """Standard deviations of errors that stay what they are through a recording.

    The defaults are those of a recording that says nothing: what is left after a careful
    calibration of a camera, a clock that stamps frames as they arrive, a mesh made from drawings.
    Errors of 0.2 %, 0.5 px, 5 mm and 0.2 % together are then within the ellipsoid of 99.9 %.
    """

    focal_sd: float = 0.0012
    """Of the focal length, over itself."""
    centre_sd_px: float = 0.3
    """Of each coordinate of the principal point."""
    range_offset_sd_m: float = 0.003
    """Of an offset that all ranges share."""
    range_scale_sd: float = 0.0012
    """Of the scale of all ranges."""
    mesh_scale_sd: float = 0.0012
    """Of the target's size, over that of its mesh."""
    stamp_jitter_sd_s: float = 0.003
    """Of each time stamp, independent from frame to frame."""
    time_offset_sd_s: float = 0.0
    """Of what all time stamps are off by."""
    mount_position_sd_m: float = 0.0
    """Of each component of where the camera sits, beside where ``T_cam_world`` has it; camera
    axes."""
    mount_attitude_sd_rad: float = 0.0
    """Of how it is turned about each of its axes, likewise."""

    def __post_init__(self) -> None:
        """Raises `InputError` for a number that is negative or not finite."""
        values = {each.name: getattr(self, each.name) for each in fields(self)}
        required_numbers("calibration", **values)

    @property
    def is_exact(self) -> bool:
        """Whether nothing errs."""
        return self == EXACT

    def of_image(self, camera: PinholeCamera) -> FloatArray:
        """(6,) deviations of what `pcnav.perception.calibration_fields` has the fields of."""
        return np.array(
            [
                self.focal_sd,
                self.centre_sd_px / camera.fx,
                self.centre_sd_px / camera.fy,
                self.range_offset_sd_m,
                self.range_scale_sd,
                self.mesh_scale_sd,
            ]
        )


EXACT = Calibration(*(0.0,) * len(fields(Calibration)))
"""Everything is as it is said to be."""
NOT_STATED = Calibration()
"""Of a recording that says nothing of it."""
