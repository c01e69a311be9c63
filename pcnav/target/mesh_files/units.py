"""The unit of a mesh file: stated by the user, declared by the file, or doubtful."""

import numpy as np
import trimesh
from trimesh.units import unit_conversion

from pcnav.config.length_unit import LengthUnit
from pcnav.files.text_table import number

_MIN_SIZE_M, _MAX_SIZE_M = 0.02, 150.0
"""Between the smallest satellite and the largest station lies what a target measures."""
_USUAL_M = 5.0


def declared_scale(geometry: trimesh.Trimesh) -> float | None:
    """Metres per unit of a geometry whose file says it; None where it does not."""
    declared = geometry.units
    if declared is None:
        return None
    try:
        return float(unit_conversion(str(declared), "meters"))
    except (ValueError, KeyError):
        return None


def unit_doubt(diameter_m: float, metres_per_unit: float) -> str | None:
    """A question, where a mesh is of a size that hardly any target has; None otherwise.

    ``metres_per_unit`` is the scale by which the file was read.
    """
    if _MIN_SIZE_M <= diameter_m <= _MAX_SIZE_M:
        return None
    return f"{length_text(diameter_m)} across: {unit_question(diameter_m / metres_per_unit)}"


def unit_question(size_in_units: float, like_m: float = _USUAL_M) -> str:
    """Which unit a mesh may be in, that is so many of its units large, for it to be of a size."""
    fitting = sorted(LengthUnit, key=lambda unit: _ratio(size_in_units * unit.metres, like_m))
    best = fitting[0]
    fits = _MIN_SIZE_M <= size_in_units * best.metres <= _MAX_SIZE_M
    if not fits:
        return "in which unit is the mesh (--mesh-unit)?"
    return f"is the mesh in {best.plural} (--mesh-unit {best.value})?"


def length_text(metres: float) -> str:
    """A length as people say it: 5.2 mm, 0.15 m, 25 m, 17 km."""
    if metres >= 2e3:
        return f"{number(metres / 1e3)} km"
    return f"{number(metres)} m" if metres >= 0.02 else f"{number(1e3 * metres)} mm"


def _ratio(a: float, b: float) -> float:
    return float(abs(np.log(a / b)))
