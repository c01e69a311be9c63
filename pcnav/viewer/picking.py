"""What lies under the pointer: a return, a rectangle; and what a card says of it."""

from dataclasses import dataclass

import numpy as np

from pcnav.core.arrays import BoolArray, FloatArray
from pcnav.runs.records import ACCEPTED, RectangleRecord
from pcnav.viewer.card import Card, Rows
from pcnav.viewer.frames import Shot
from pcnav.viewer.loaded_run import LoadedRun

_REACH = 3.0
"""A return is under the pointer within so many distances of neighbouring returns."""
_DEPTH = 4.0
"""... and as many times deeper than the nearest of these as a steep surface makes it."""
_AXIS_WORDS = {
    "x": "along its width",
    "y": "along its length",
    "z": "along its normal",
    "theta_x": "turn about its width",
    "theta_y": "turn about its length",
    "theta_z": "turn about its normal",
}


@dataclass(frozen=True)
class Ray:
    """What a pointer points along, camera frame."""

    origin: FloatArray
    """(3,) m."""
    direction: FloatArray
    """(3,) of unit length."""


def picked_point(shot: Shot, ray: Ray) -> int | None:
    """Number of the nearest return under the pointer; None for none."""
    if not len(shot.points):
        return None
    off = shot.points.astype(np.float64) - ray.origin
    along = off @ ray.direction
    away = np.linalg.norm(off - along[:, None] * ray.direction, axis=1)
    apart = np.linalg.norm(shot.points, axis=1) / shot.frame.camera.fx
    under = (along > 0.0) & (away < _REACH * apart)
    if not under.any():
        return None
    # Of those in front: what lies behind a surface is not what was meant.
    nearest = float(np.min(along[under]))
    under &= along < nearest + _DEPTH * _REACH * apart
    return int(np.argmin(np.where(under, away, np.inf)))


def picked_rectangle(records: tuple[RectangleRecord, ...], ray: Ray) -> RectangleRecord | None:
    """The nearest rectangle that a ray passes through; None for none."""
    found = [(distance, k) for k, r in enumerate(records) if (distance := _hit(r, ray)) is not None]
    return records[min(found)[1]] if found else None


def _hit(record: RectangleRecord, ray: Ray) -> float | None:
    """Distance at which a ray passes through a rectangle; None where it does not."""
    T = record.T_cam_rect
    if not np.isfinite(T).all():
        return None
    slope = float(T[:3, 2] @ ray.direction)
    if abs(slope) < 1e-9:
        return None
    distance = float(T[:3, 2] @ (T[:3, 3] - ray.origin)) / slope
    p_rect = T[:3, :3].T @ (ray.origin + distance * ray.direction - T[:3, 3])
    half = 0.5 * np.array([record.width_m, record.length_m])
    return distance if distance > 0.0 and bool((np.abs(p_rect[:2]) <= half).all()) else None


def rectangle_card(loaded: LoadedRun, record: RectangleRecord, shot: Shot | None) -> Card:
    """Of a rectangle: residuals, and why it was rejected."""
    used = record.outcome == ACCEPTED
    rows = [
        ["outcome", record.outcome],
        ["size", f"{record.length_m:.3f} × {record.width_m:.3f} m"],
        *gate_rows(record),
        *_residual_rows(shot, _pixels_of(loaded, record, shot)),
        ["case chosen", record.case or "undecided"],
    ]
    name = record.rectangle or "unrecognised rectangle"
    return Card(f"{name}{'' if used else ' (rejected)'}", rows)


def gate_rows(record: RectangleRecord) -> Rows:
    """Squared distance from the prediction, its gate and the worst axis, as far as known."""
    if not np.isfinite(record.squared_distance):
        return [["squared distance", "the filter was not asked"]]
    passed = "within" if record.squared_distance <= record.gate else "beyond"
    told = f"{record.squared_distance:.3g}, {passed} the gate of {record.gate:.3g}"
    rows = [["squared distance", told]]
    if record.worst_axis:
        rows.append(["worst axis", _AXIS_WORDS.get(record.worst_axis, record.worst_axis)])
    return rows


def _pixels_of(loaded: LoadedRun, record: RectangleRecord, shot: Shot | None) -> BoolArray | None:
    """(n,) the returns that show a rectangle of the catalogue."""
    if shot is None or shot.rectangles is None or loaded.target is None:
        return None
    names = [rectangle.name for rectangle in loaded.target.rectangles]
    if record.rectangle not in names:
        return None
    return np.asarray(shot.rectangles == names.index(record.rectangle))


def _residual_rows(shot: Shot | None, pixels: BoolArray | None) -> Rows:
    if shot is None or shot.residual_m is None or pixels is None:
        return []
    residual = shot.residual_m[pixels]
    residual = residual[np.isfinite(residual)]
    if not len(residual):
        return [["residual", "no return explained by it"]]
    mean, sd = 1e3 * float(residual.mean()), 1e3 * float(residual.std())
    every = f", every {shot.stride}. row and column" if shot.stride > 1 else ""
    return [
        ["residual, mean", f"{mean:+.2f} mm"],
        ["residual, sd", f"{sd:.2f} mm of {len(residual)} returns{every}"],
    ]


def point_card(loaded: LoadedRun, shot: Shot, point: int) -> Card:
    """Of a return: place, range and residual."""
    assert loaded.frames is not None
    row, column = (int(each[point]) for each in shot.shown)
    p_cam = shot.points[point].astype(np.float64)
    rows = [
        ["pixel", f"row {row * shot.stride}, column {column * shot.stride}"],
        ["range", f"{np.linalg.norm(p_cam):.4f} m"],
        ["place", ", ".join(f"{value:.4f}" for value in p_cam) + " m, camera axes"],
    ]
    if shot.residual_m is not None:
        residual = float(shot.residual_m[point])
        told = "off the model"
        if np.isfinite(residual):
            told = f"{1e3 * residual:+.2f} mm = {residual / loaded.frames.sigma_m:+.1f} σ of range"
        rows.append(["residual", told])
    if shot.rectangles is not None and loaded.target is not None:
        number = int(shot.rectangles[point])
        rows.append(["face", loaded.target.rectangles[number].name if number >= 0 else "none"])
    if shot.beside is not None and shot.beside[point]:
        rows.append(["belongs to", "another thing: farther from the target than it reaches"])
    return Card("return", rows)
