"""What a depth frame has to be, from a file or made by a program: checked once, at its making.

An `InputError` names the frame (or the recording) and the field, in the same words in both cases.
"""

import math
from typing import Any

import numpy as np
import numpy.typing as npt

from pcnav.core.arrays import BoolArray, DepthImage, FloatArray
from pcnav.core.camera import PinholeCamera
from pcnav.core.errors import InputError
from pcnav.core.spatial import nearest_orthogonal

ROTATION_TOLERANCE = 1e-4
"""Largest orthonormality error of a rotation: files round to as few as five digits."""
_EXACT = 1e-9
"""A rotation this good is left as it is."""
_NEAR_PERCENT = 5.0
_MIN_TARGET_PX = 1.0
"""A target that spans less at the nearest returns cannot be what is seen."""
_CHECKED_EVERY = 7
"""Pixels apart, in rows and columns, that suffice to judge the units."""


def checked_depth(where: str, depth_m: npt.NDArray[Any], camera: PinholeCamera) -> DepthImage:
    """(height, width) z-depth, m, as float32, in which all that is no depth is 0.

    NaN, infinities and negative values are holes; the array given is left as it is. Raises
    `InputError` for another shape than the camera's and for what is no array of floats.
    """
    if not isinstance(depth_m, np.ndarray) or depth_m.dtype.kind != "f":
        kind = depth_m.dtype if isinstance(depth_m, np.ndarray) else type(depth_m).__name__
        raise InputError(where, "depth_m", f"expected an array of floats in metres, got {kind}")
    if depth_m.shape != (camera.height, camera.width):
        expected = f"expected {camera.height} rows of {camera.width}, as the camera has"
        raise InputError(where, "depth_m", f"{expected}, got an array of shape {depth_m.shape}")
    depth = np.ascontiguousarray(depth_m, dtype=np.float32)
    # Not a number is neither below nor above: both comparisons are false then.
    if not (float(depth.min()) >= 0.0 and float(depth.max()) < math.inf):
        depth = np.where((depth >= 0.0) & (depth < np.inf), depth, np.float32(0.0))
    return depth


def checked_unseen(where: str, unseen: BoolArray | None, camera: PinholeCamera) -> None:
    """Raises `InputError` for anything but one truth value a pixel."""
    if unseen is None:
        return
    if unseen.dtype != np.bool_ or unseen.shape != (camera.height, camera.width):
        expected = f"expected {camera.height} rows of {camera.width} truth values"
        got = f"got {unseen.dtype} of shape {unseen.shape}"
        raise InputError(where, "unseen", f"{expected}, {got}")


def checked_camera(where: str, camera: PinholeCamera) -> None:
    """Raises `InputError` for a camera without an image."""
    numbers = (camera.fx, camera.fy, camera.cx, camera.cy)
    if not (all(map(math.isfinite, numbers)) and camera.fx > 0.0 and camera.fy > 0.0):
        expected = "expected finite intrinsics and focal lengths above 0"
        raise InputError(where, "camera", f"{expected}, got fx, fy, cx, cy = {numbers}")


def checked_time(where: str, time_s: float) -> None:
    """Raises `InputError` for a time that is no number."""
    if not math.isfinite(time_s):
        raise InputError(where, "time_s", f"expected a finite time, got {time_s}")


def checked_transform(where: str, field: str, T: FloatArray) -> FloatArray:
    """(4, 4) rigid transform; a rotation off by rounding is made orthonormal.

    Raises `InputError` for what is none.
    """
    expected = "expected a rigid transform (4, 4)"
    if not isinstance(T, np.ndarray) or T.shape != (4, 4) or T.dtype.kind not in "fi":
        raise InputError(where, field, f"{expected}, got {getattr(T, 'shape', type(T).__name__)}")
    rows = T.tolist()
    if not all(math.isfinite(x) for row in rows for x in row):
        raise InputError(where, field, f"{expected}, got entries that are not finite")
    if rows[3] != [0.0, 0.0, 0.0, 1.0]:
        raise InputError(where, field, f"{expected}, its last row 0 0 0 1")
    error = _rotation_error(rows)
    if error > ROTATION_TOLERANCE:
        orthonormal = f"orthonormal to {ROTATION_TOLERANCE:g}, determinant 1"
        raise InputError(
            where, field, f"{expected}, its rotation {orthonormal}; off by {error:.2g}"
        )
    if error < _EXACT:
        return T
    rigid = T.astype(np.float64)
    rigid[:3, :3] = nearest_orthogonal(rigid[:3, :3])
    return rigid


def _rotation_error(rows: list[list[float]]) -> float:
    """Largest entry of ``|R R' - I|``; infinite for a reflection. Plain numbers: one is quick."""
    a, b, c = (row[:3] for row in rows[:3])
    products = [
        *(_dot(a, a) - 1.0, _dot(b, b) - 1.0, _dot(c, c) - 1.0),
        *(_dot(a, b), _dot(a, c), _dot(b, c)),
    ]
    cross = [b[1] * c[2] - b[2] * c[1], b[2] * c[0] - b[0] * c[2], b[0] * c[1] - b[1] * c[0]]
    return max(map(abs, products)) if _dot(a, cross) > 0.0 else math.inf


def _dot(a: list[float], b: list[float]) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def required_numbers(where: str, **values: float | None) -> None:
    """Raises `InputError` for a number that is negative or not finite; None is none."""
    for field, value in values.items():
        if value is not None and not (math.isfinite(value) and value >= 0.0):
            raise InputError(where, field, f"expected a finite number from 0 on, got {value}")


def units_doubt(depth_m: DepthImage, camera: PinholeCamera, diameter_m: float) -> str | None:
    """Why the depths of a frame can hardly be metres, in words; None where they may be.

    Where the nearest returns are so far that the target would not fill a pixel there, they are
    millimetres, or the target is not what is seen. None also where there is no return.
    """
    sample = depth_m[::_CHECKED_EVERY, ::_CHECKED_EVERY]
    returns = sample[sample > 0.0]
    if not returns.size:
        return None
    near = float(np.percentile(returns, _NEAR_PERCENT))
    pixels = max(camera.fx, camera.fy) * diameter_m / near
    if pixels >= _MIN_TARGET_PX:
        return None
    return (
        f"expected metres: the target, {diameter_m:.3g} m across, would span {pixels:.2g} px at "
        f"the nearest returns, {near:.4g} away; are they millimetres?"
    )
