"""From what an image stores to z-depth in metres, whose holes are 0."""

import numpy as np

from pcnav.core.arrays import BoolArray, DepthImage, FloatArray
from pcnav.core.camera import PinholeCamera, range_per_depth
from pcnav.recordings.depth_form import DepthForm, DepthIs
from pcnav.recordings.depth_image import StoredDepth

FAR_M = 1e5
"""No depth sensor sees further: renderers write such a depth where a ray hits nothing."""
_FULL_SCALE = 65535
"""Largest value of 16 bits, which many sensors write where nothing came back."""
_BELOW_FULL_SCALE = 64
"""A surface that lies at full scale by chance is also seen within so many units below it."""


def depth_in_metres(
    stored: StoredDepth, step_m: float, form: DepthForm, camera: PinholeCamera
) -> DepthImage:
    """z-depth (height, width), m, of a stored image; 0 = no return.

    Holes are 0, the stored unit that the form names, full scale of 16 bits where no surface
    explains it, anything negative or not finite, and floats beyond `FAR_M`.
    """
    is_float = stored.dtype.kind == "f"
    holes = _holes(stored, form)
    if form.depth_is is DepthIs.RANGE:
        depth_m = _z_of_range(stored, step_m, camera)
    else:
        depth_m = np.asarray(stored * np.float32(step_m), dtype=np.float32)
    if holes is not None:
        depth_m[holes] = 0.0
    if is_float:
        depth_m[depth_m >= FAR_M] = 0.0
    return depth_m


def _z_of_range(stored: StoredDepth, step_m: float, camera: PinholeCamera) -> DepthImage:
    # Divided in float64: a stored range loses no digit more than a stored depth does.
    range_m: FloatArray = stored.astype(np.float64) * step_m
    return np.asarray(range_m / range_per_depth(camera), dtype=np.float32)


def _holes(stored: StoredDepth, form: DepthForm) -> BoolArray | None:
    """(height, width) pixels that hold no depth, beside those that are 0; None without any."""
    holes: BoolArray | None = None
    if stored.dtype.kind == "f":
        # Also true of what is no number.
        holes = ~((stored >= 0.0) & (stored < np.inf))
    elif stored.dtype.kind == "i":
        holes = stored < 0
    found = [] if holes is None else [holes]
    if form.invalid_units is not None:
        found.append(stored == form.invalid_units)
    full = stored == _FULL_SCALE
    if full.any() and _is_hole_value(stored, int(np.count_nonzero(full))):
        found.append(full)
    return np.logical_or.reduce(found) if found else None


def _is_hole_value(stored: StoredDepth, count: int) -> bool:
    """Whether full scale, at so many pixels, is a mark and no depth.

    A surface there has a slope and noise, and is seen just below it at least as often.
    """
    below = (stored >= _FULL_SCALE - _BELOW_FULL_SCALE) & (stored < _FULL_SCALE)
    return count > int(np.count_nonzero(below))
