"""The target's translation between two frames, as far as what is known allows (section 2.4).

Matches give R and the direction of t in ``p_second = R p_first + t``, hence for the target's mass
centre ``T_second = R T_first + t``. That is one side of a triangle, in direction alone: what else
is known decides what follows. Places are those of the mass centre, which a camera does not see:
its direction and range come from other sensors or from a model of the target.

The displacement is ``T_second - T_first`` in the axes of the first camera; printed (6) and (10)
have lost the sign between their terms.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from pcnav.core.arrays import FloatArray
from pcnav.core.spatial import rotation_fault


class Verdict(StrEnum):
    """How much of the translation is found."""

    FOUND = "found"
    TWO_ANSWERS = "two_answers"
    """Two places of the mass centre fit."""
    DIRECTION_ONLY = "direction_only"
    """The direction of the displacement and the ratio of the ranges."""
    MOVES = "moves"
    """That the target translates, and no more."""
    OPEN = "open"
    """Nothing; even a target that only rotates would look like this."""
    CONTRADICTION = "contradiction"
    """No place of the mass centre fits what is said to be known."""


@dataclass(frozen=True)
class Known:
    """What is known of the mass centre besides the images. Directions are unit vectors (3,)."""

    direction_first: FloatArray | None = None
    """From the camera, its axes at the first frame."""
    direction_second: FloatArray | None = None
    """From the camera, its axes at the second frame."""
    range_first_m: float | None = None
    range_second_m: float | None = None
    length_m: float | None = None
    """Of t."""


@dataclass(frozen=True)
class Places:
    """The mass centre at both frames, m, and how it moved."""

    first_m: FloatArray
    """(3,) axes of the first camera."""
    second_m: FloatArray
    """(3,) axes of the second camera."""
    displacement_m: FloatArray
    """(3,) axes of the first camera."""


@dataclass(frozen=True)
class Translation:
    """The answer, or what it lacks."""

    verdict: Verdict
    places: tuple[Places, ...] = ()
    """One when found; two when two fit. With `DIRECTION_ONLY` in units of the first range."""
    missing: str = ""
    """What would be needed, in words."""


@dataclass(frozen=True)
class RelativeView:
    """What the images say of two frames."""

    R_second_first: FloatArray
    """(3, 3)"""
    direction: FloatArray
    """(3,) of t."""
    R_cameras: FloatArray
    """(3, 3) R_second_first of the camera itself, inertial: I for one at rest."""
    tolerance_rad: float = 1e-3
    """Directions that differ by less are taken as equal."""


def translation(view: RelativeView, known: Known) -> Translation:
    """The mass centre's displacement between two frames. Raises `ValueError` for no rotation."""
    fault = rotation_fault(view.R_second_first) or rotation_fault(view.R_cameras)
    if fault is not None:
        raise ValueError(f"expected rotations: {fault}")
    if known.direction_first is None and known.direction_second is None:
        return Translation(Verdict.OPEN, missing="a direction to the mass centre at either frame")
    both_sides = _known_sides(view, known)
    if both_sides is not None:
        return both_sides
    if known.direction_first is not None and known.direction_second is not None:
        return _by_directions(view, known)
    return _moves(view, known)


def _known_sides(view: RelativeView, known: Known) -> Translation | None:
    """Assumptions 1 and 2: places or a place and the length of t; None where they do not apply."""
    R, t = view.R_second_first, view.direction
    first = _place(known.direction_first, known.range_first_m)
    second = _place(known.direction_second, known.range_second_m)
    if first is not None and second is not None:
        return _found(view, [(first, second)])
    if first is not None and known.length_m is not None:
        return _found(view, [(first, R @ first + known.length_m * t)])
    if second is not None and known.length_m is not None:
        return _found(view, [(R.T @ (second - known.length_m * t), second)])
    if first is not None and known.direction_second is None and known.range_second_m is not None:
        lengths = _lengths(R @ first, t, known.range_second_m)
        return _found(view, [(first, R @ first + length * t) for length in lengths])
    if second is not None and known.direction_first is None and known.range_first_m is not None:
        lengths = _lengths(second, -t, known.range_first_m)
        return _found(view, [(R.T @ (second - length * t), second) for length in lengths])
    return None


def _by_directions(view: RelativeView, known: Known) -> Translation:
    """Assumptions 3 and 4: both directions; the ratio of the ranges closes the triangle."""
    assert known.direction_first is not None and known.direction_second is not None
    R, t = view.R_second_first, view.direction
    d1, d2 = R @ known.direction_first, known.direction_second
    # r2 d2 - length t = r1 R d1: two unknowns per unit of r1 in three equations.
    if np.linalg.norm(np.cross(d2, t)) < view.tolerance_rad:
        needed = "the range at the second frame: t points at the mass centre"
        return Translation(Verdict.OPEN, missing=needed)
    (ratio, length), *_ = np.linalg.lstsq(np.stack([d2, -t], axis=1), d1, rcond=None)
    # Directions and motion that are not of one plane close no triangle.
    off = float(np.linalg.norm(ratio * d2 - length * t - d1))
    if ratio <= 0.0 or length < -view.tolerance_rad or off > view.tolerance_rad * max(1.0, ratio):
        missing = "directions that agree with the measured motion"
        return Translation(Verdict.CONTRADICTION, missing=missing)
    r1 = known.range_first_m
    if r1 is None and known.range_second_m is not None:
        r1 = known.range_second_m / float(ratio)
    scale = 1.0 if r1 is None else r1
    found = _found(view, [(scale * known.direction_first, scale * float(ratio) * d2)])
    if r1 is None:
        needed = "the range at one frame, or the length of t"
        if known.length_m is not None and length > view.tolerance_rad:
            scale = known.length_m / float(length)
            return _found(view, [(scale * known.direction_first, scale * float(ratio) * d2)])
        return Translation(Verdict.DIRECTION_ONLY, found.places, needed)
    return found


def _moves(view: RelativeView, known: Known) -> Translation:
    """Assumption 5: one direction; a target that only rotates has t along ``C T - R T``."""
    missing = "the direction at the other frame, or the range here and the length of t"
    C, R = view.R_cameras, view.R_second_first
    if known.direction_first is not None:
        still = (C - R) @ known.direction_first
    else:
        assert known.direction_second is not None
        still = known.direction_second - R @ C.T @ known.direction_second
    length = float(np.linalg.norm(still))
    if length < view.tolerance_rad:
        return Translation(Verdict.MOVES, missing=missing)
    off = float(np.arctan2(np.linalg.norm(np.cross(still, view.direction)), still @ view.direction))
    # The direction of `still` is as sure as the rotation is against its own size.
    verdict = Verdict.MOVES if off > view.tolerance_rad / min(length, 1.0) else Verdict.OPEN
    return Translation(verdict, missing=missing)


def _place(direction: FloatArray | None, range_m: float | None) -> FloatArray | None:
    return None if direction is None or range_m is None else range_m * direction


def _lengths(start: FloatArray, t: FloatArray, range_m: float) -> list[float]:
    """Lengths >= 0 of t for which ``|start + length t|`` is the range."""
    along = float(start @ t)
    under = along**2 - float(start @ start) + range_m**2
    if under < 0.0:
        return []
    return [length for length in sorted({-along - under**0.5, -along + under**0.5}) if length >= 0]


def _found(view: RelativeView, pairs: Sequence[tuple[FloatArray, FloatArray]]) -> Translation:
    places = tuple(Places(a, b, view.R_cameras.T @ b - a) for a, b in pairs)
    if not places:
        missing = "ranges that agree with the measured motion"
        return Translation(Verdict.CONTRADICTION, missing=missing)
    if len(places) > 1:
        missing = "the direction at the other frame"
        return Translation(Verdict.TWO_ANSWERS, places, missing)
    return Translation(Verdict.FOUND, places)
