"""Depth images as programs have them: arrays of any unit, and a camera that may be a matrix."""

import logging
import math
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from pcnav.config.length_unit import LengthUnit
from pcnav.core.arrays import DepthImage, FloatArray
from pcnav.core.camera import PinholeCamera
from pcnav.core.errors import InputError
from pcnav.recordings.depth_form import PLAIN, DepthForm, DepthIs
from pcnav.recordings.depth_units import depth_in_metres
from pcnav.recordings.frame_checks import checked_camera

DepthUnit: TypeAlias = LengthUnit | str | float | None
"""A unit by name, or its metres; None of floats in metres."""

_LOG = logging.getLogger("pcnav")
_OFF_CENTRE, _CENTRAL = 0.1, 0.03
"""Share of the image by which a principal point is off its middle: oddly, and usually."""


@dataclass(frozen=True)
class DepthArrays:
    """How the arrays of a program become depth frames."""

    camera: PinholeCamera | None
    """None while its size is not known."""
    K: FloatArray | None
    """(3, 3) where a matrix was given."""
    step_m: float | None
    """Metres of one unit; None of floats in metres."""
    form: DepthForm

    @staticmethod
    def of(
        camera: PinholeCamera | npt.ArrayLike,
        unit: DepthUnit,
        depth_is: str,
        invalid_depth: float | None,
    ) -> "DepthArrays":
        """As `pcnav.Tracker` is told. Raises `InputError`."""
        if depth_is not in tuple(DepthIs):
            raise InputError("Tracker", "depth_is", f"expected z or range, got {depth_is}")
        form = replace(PLAIN, invalid_units=invalid_depth, depth_is=DepthIs(depth_is))
        if isinstance(camera, PinholeCamera):
            checked_camera("Tracker", camera)
            return DepthArrays(camera, None, _metres_of(unit), form)
        return DepthArrays(None, _checked_matrix(camera), _metres_of(unit), form)

    def seen_by(self, depth: npt.NDArray[Any]) -> "DepthArrays":
        """With the camera's size known, from a first frame."""
        if self.camera is not None:
            return self
        assert self.K is not None, "a camera is given in one way or the other"
        height, width = depth.shape
        fx, fy, cx, cy = self.K[[0, 1, 0, 1], [0, 1, 2, 2]].tolist()
        camera = PinholeCamera(width, height, fx, fy, cx, cy)
        if _is_off_centre(camera, _OFF_CENTRE) and not _is_off_centre(
            replace(camera, width=height, height=width), _CENTRAL
        ):
            _LOG.warning(
                "Tracker: the principal point (%g, %g) is the middle of an image of %d x %d, but "
                "the depth has %d rows of %d: is it transposed?",
                *(cx, cy, height, width, height, width),
            )
        return replace(self, camera=camera)

    def in_metres(self, where: str, depth: npt.NDArray[Any]) -> DepthImage:
        """(height, width) z-depth, m, 0 where nothing came back.

        Raises `InputError`, which names the frame ``where``, for another size than the camera's.
        """
        camera = self.camera
        assert camera is not None, "its size is known"
        if depth.shape != (camera.height, camera.width):
            expected = f"expected {camera.height} rows of {camera.width}, as the camera has"
            raise InputError(where, "depth", f"{expected}, got an array of shape {depth.shape}")
        step_m = self.step_m
        if step_m is None:
            if depth.dtype.kind != "f":
                expected = f'expected floats in metres, or depth_unit="mm", ... for {depth.dtype}'
                raise InputError(where, "depth", expected)
            step_m = 1.0
        return depth_in_metres(depth, step_m, self.form, camera)


def plain_array(where: str, depth: npt.ArrayLike) -> npt.NDArray[Any]:
    """(height, width) numbers; what is masked is 0. Raises `InputError`."""
    try:
        array = np.asarray(np.ma.filled(depth, 0))
    except (TypeError, ValueError) as error:
        raise InputError(where, "depth", f"expected an array of numbers ({error})") from error
    if array.ndim == 3 and array.shape[2] == 1:
        array = array[..., 0]
    if array.ndim != 2 or 0 in array.shape:
        expected = f"expected one image of rows and columns, got an array of shape {array.shape}"
        raise InputError(where, "depth", expected)
    if array.dtype.kind not in "uif":
        raise InputError(where, "depth", f"expected numbers, got {array.dtype}")
    return array


def _metres_of(unit: DepthUnit) -> float | None:
    if unit is None:
        return None
    if isinstance(unit, str):
        return LengthUnit.named(unit).metres
    if not (math.isfinite(unit) and unit > 0.0):
        raise InputError("Tracker", "depth_unit", f"expected metres above 0, got {unit}")
    return float(unit)


def _checked_matrix(camera: npt.ArrayLike) -> FloatArray:
    expected = "expected a camera matrix [[fx, 0, cx], [0, fy, cy], [0, 0, 1]] or a PinholeCamera"
    try:
        K = np.asarray(camera, dtype=np.float64)
    except (TypeError, ValueError) as error:
        got = f"got {type(camera).__name__}"
        raise InputError("Tracker", "camera", f"{expected}, {got}") from error
    if K.shape != (3, 3):
        raise InputError("Tracker", "camera", f"{expected}, got an array of shape {K.shape}")
    if not (np.isfinite(K).all() and K[0, 0] > 0.0 and K[1, 1] > 0.0):
        raise InputError("Tracker", "camera", f"{expected}, focal lengths above 0")
    if K[2].tolist() != [0.0, 0.0, 1.0] or K[1, 0] != 0.0 or K[0, 1] != 0.0:
        hint = "; is it transposed?" if K[2, 0] and K[2, 1] else "; without skew"
        raise InputError("Tracker", "camera", expected + hint)
    return K


def _is_off_centre(camera: PinholeCamera, share: float) -> bool:
    u, v = camera.cx / (camera.width - 1) - 0.5, camera.cy / (camera.height - 1) - 0.5
    return max(abs(u), abs(v)) > share
