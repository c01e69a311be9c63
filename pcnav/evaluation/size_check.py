"""Whether what is seen is of the size of the target, and which unit would explain it if not."""

import numpy as np

from pcnav.config.length_unit import LengthUnit
from pcnav.core.arrays import FloatArray
from pcnav.core.camera import PinholeCamera
from pcnav.core.spatial import make_transform, rotation_from_xyzw
from pcnav.recordings.frame_survey import FrameSurvey, extent_of
from pcnav.target.mesh_files.units import length_text
from pcnav.target.rendering import DepthRenderer
from pcnav.target.satellite import Target

_VIEWS, _SIZE_PX = 40, 64
_RANGE_DIAMETERS = 5.0
_SPREAD = 1.25
"""What is seen is of another size where it is beyond all views by more than this factor: noise, an
offset and a view unlike all of these make less."""
_MAX_FACTOR = 50.0
"""Returns that span more have other reasons: depths in another unit, or all that lies about."""
_ALIKE = 1.25
"""A unit explains a size that it would make right to this factor."""
_MAX_CUT = 0.5
"""Share of frames cut by the image border above which a small size says nothing."""


def view_spans(target: Target) -> FloatArray:
    """(n,) what a target spans when it is seen whole from many sides, as frames are surveyed, m."""
    quaternions = np.random.default_rng(0).normal(size=(_VIEWS, 4))
    rotations = rotation_from_xyzw(quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True))
    middle = np.asarray(target.mesh.bounds).mean(axis=0)
    distance = np.array([0.0, 0.0, _RANGE_DIAMETERS * target.diameter_m])
    half_angle = np.arctan(0.55 / (_RANGE_DIAMETERS - 0.5))
    camera = PinholeCamera.from_field_of_view(_SIZE_PX, _SIZE_PX, 2.0 * half_angle)
    renderer = DepthRenderer(target.mesh, camera)
    spans = []
    for R in rotations:
        depth_m = renderer.render(make_transform(R, distance - R @ middle)).depth_m
        if depth_m.any():
            spans.append(extent_of(depth_m, camera)[2])
    return np.array(spans)


def size_doubt(survey: FrameSurvey, spans_m: FloatArray, metres_per_unit: float) -> str | None:
    """Why the returns can hardly be those of the target, by their size; None where they may be.

    ``spans_m`` (n,) are those of `view_spans`, of a mesh read by a scale. Returns of other things
    make the target look larger; a target cut by the image border looks smaller than it is.
    """
    seen_m = survey.span_m
    if not spans_m.size or not seen_m > 0.0:
        return None
    low_m, high_m = float(spans_m.min()), float(spans_m.max())
    factor = seen_m / float(np.median(spans_m))
    is_small = seen_m * _SPREAD < low_m and survey.cut_share <= _MAX_CUT
    is_large = seen_m > _SPREAD * high_m
    if not (is_small or is_large) or factor > _MAX_FACTOR:
        return None
    unit = _explaining(seen_m, low_m, high_m, metres_per_unit)
    told = f"the returns span {length_text(seen_m)}, the mesh as it was read"
    told = f"{told} {length_text(low_m)} to {length_text(high_m)} from any side"
    more = "are other things seen, too, or " if is_large else ""
    if unit is not None:
        return f"{told}: {more}is it in {unit.plural} (--mesh-unit {unit.value})?"
    change = f"{factor:.2g} times too small" if is_large else f"{1.0 / factor:.2g} times too large"
    return f"{told}: {more}is it {change}, or in another unit (--mesh-unit)?"


def _explaining(
    seen_m: float, low_m: float, high_m: float, metres_per_unit: float
) -> LengthUnit | None:
    """The unit in which the mesh would be of the size seen, that of the likeliest view first."""
    scales = {unit: unit.metres / metres_per_unit for unit in LengthUnit}
    fitting = [
        unit
        for unit, scale in scales.items()
        if low_m / _ALIKE <= seen_m / scale <= _ALIKE * high_m and abs(scale - 1.0) > 0.01
    ]
    middle_m = np.sqrt(low_m * high_m)
    fitting.sort(key=lambda unit: abs(np.log(seen_m / scales[unit] / middle_m)))
    return fitting[0] if fitting else None
