"""A point of a target by its coordinates or its name."""

from pathlib import Path

import numpy as np

from pcnav.config.pipeline_file import Pipeline
from pcnav.core.arrays import FloatArray
from pcnav.core.errors import InputError
from pcnav.evaluation.forecast.point import TargetPoint
from pcnav.target.satellite import load_target

MASS_CENTRE, ORIGIN = "com", "origin"


def named_point(
    text: str, normal: str | None, folder: Path, pipeline: Pipeline | None
) -> TargetPoint:
    """The point that a text tells: ``x y z`` in m, model frame (of a run without a mesh: body axes
    from the mass centre), ``com``, ``origin``, or the name of a rectangle of the run's mesh, whose
    centroid and outward normal it has. Another normal ``x y z`` may be told.

    Raises `InputError` for a text that is none of these; ``folder`` is the run's.
    """
    stated = None if normal is None else _three(normal, folder, "--normal")
    if stated is not None:
        length = float(np.linalg.norm(stated))
        if not length > 0.0:
            raise InputError(folder, "--normal", "expected a direction, got 0 0 0")
        stated = stated / length
    if text == MASS_CENTRE:
        return TargetPoint("mass centre", None, stated)
    if text == ORIGIN:
        return TargetPoint("origin of the model", np.zeros(3), stated)
    if _is_numbers(text):
        return TargetPoint(f"point {text} m", _three(text, folder, "--point"), stated)
    return _rectangle(text, stated, folder, pipeline)


def _rectangle(
    name: str, normal: FloatArray | None, folder: Path, pipeline: Pipeline | None
) -> TargetPoint:
    if pipeline is None or pipeline.target_mesh is None:
        expected = f'expected "x y z" in m or {MASS_CENTRE}: the run has no mesh, whose faces'
        raise InputError(folder, "--point", f"{expected} would have names, got {name}")
    target = load_target(Path(pipeline.target_mesh), pipeline.mesh_unit)
    for rectangle in target.rectangles:
        if rectangle.name == name:
            T = rectangle.T_model_rect
            if normal is not None:
                return TargetPoint(name, T[:3, 3], normal)
            return TargetPoint(name, T[:3, 3], T[:3, 2], rectangle.two_sided)
    names = ", ".join([MASS_CENTRE, ORIGIN, *(each.name for each in target.rectangles)])
    raise InputError(folder, "--point", f'expected "x y z" in m or one of: {names}; got {name}')


def _is_numbers(text: str) -> bool:
    try:
        return len([float(word) for word in text.replace(",", " ").split()]) > 0
    except ValueError:
        return False


def _three(text: str, folder: Path, field: str) -> FloatArray:
    expected = f'expected "x y z", three numbers, got {text}'
    try:
        values = np.array([float(word) for word in text.replace(",", " ").split()])
    except ValueError as error:
        raise InputError(folder, field, expected) from error
    if values.shape != (3,) or not np.isfinite(values).all():
        raise InputError(folder, field, expected)
    return values
