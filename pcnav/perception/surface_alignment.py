"""Alignment of many poses with one cloud at once: point to plane, to the nearest of surface points.

Cost goes with the number of poses and of returns looked at, not with the faces of the mesh.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from pcnav.core.arrays import FloatArray
from pcnav.core.spatial import exp_rotation

_RETURNS, _FINE_RETURNS = 70, 220
"""Returns that take part, spread over the cloud."""
_REACH_FRACTIONS = (0.12, 0.12, 0.1, 0.08, 0.06)
_FINE_REACH_FRACTIONS = (0.06, 0.05, 0.04, 0.03, 0.03)
"""Of each pass, over the diameter: returns further from the surface have no say."""
_FIT_FRACTION = 0.02
_PRIOR = 1e-3
"""Of the mean information: keeps directions in which nothing is seen from drifting."""


@dataclass(frozen=True)
class Surface:
    """Points of a target's surface that are seen from outside."""

    points: FloatArray
    """(n, 3) model frame, m."""
    normals: FloatArray
    """(n, 3) outward."""
    tree: cKDTree


def aligned(
    T_cam_model: FloatArray,
    cloud: FloatArray,
    surface: Surface,
    diameter_m: float,
    *,
    finely: bool,
) -> tuple[FloatArray, FloatArray]:
    """Poses (k, 4, 4) brought onto a cloud (n, 3, camera frame), and (k,) how well each then fits.

    The fit is 0 to 1: 1 when all returns lie on surfaces that face the sensor.
    """
    n = min(len(cloud), _FINE_RETURNS if finely else _RETURNS)
    chosen = cloud[np.linspace(0, len(cloud) - 1, n).astype(int)]
    R, p = T_cam_model[:, :3, :3].copy(), T_cam_model[:, :3, 3].copy()
    for reach in _FINE_REACH_FRACTIONS if finely else _REACH_FRACTIONS:
        moved = np.einsum("kji,knj->kni", R, chosen[None] - p[:, None])
        distance, normal, weight = _nearest(moved, R, p, surface, reach * diameter_m)
        # Rotation about the model origin, model axes; shift in model axes. Scaled to the radius.
        lever = 0.5 * diameter_m
        H = np.concatenate([normal, np.cross(moved, normal) / lever], axis=2)
        A = np.einsum("kni,kn,knj->kij", H, weight, H)
        b = np.einsum("kni,kn,kn->ki", H, weight, distance)
        A += _PRIOR * np.trace(A, axis1=1, axis2=2)[:, None, None] / 6.0 * np.eye(6)
        A += 1e-12 * np.eye(6)
        step = np.linalg.solve(A, b[..., None])[..., 0]
        turn, shift = exp_rotation(step[:, 3:] / lever), step[:, :3]
        # A return q in model axes goes to exp(w)(q) + s; the pose's inverse moves with it.
        R_new = np.einsum("kij,kjl->kil", R, np.swapaxes(turn, 1, 2))
        p = p - np.einsum("kij,kj->ki", R_new, shift)
        R = R_new
    moved = np.einsum("kji,knj->kni", R, chosen[None] - p[:, None])
    distance, _, weight = _nearest(moved, R, p, surface, 3.0 * _FIT_FRACTION * diameter_m)
    quality = np.exp(-0.5 * (distance / (_FIT_FRACTION * diameter_m)) ** 2) * (weight > 0.0)
    found = np.tile(np.eye(4), (len(R), 1, 1))
    found[:, :3, :3], found[:, :3, 3] = R, p
    return found, np.asarray(quality.mean(axis=1))


def _nearest(
    q: FloatArray, R: FloatArray, p: FloatArray, surface: Surface, reach_m: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """(k, n) what is missing along the normal from points (k, n, 3) to the surface, the normals
    (k, n, 3) and weights (k, n): 0 beyond reach and where the surface faces away."""
    apart, index = surface.tree.query(q.reshape(-1, 3), distance_upper_bound=reach_m)
    apart, index = np.reshape(apart, q.shape[:2]), np.reshape(index, q.shape[:2])
    lost = index == len(surface.points)
    index = np.where(lost, 0, index)
    normal, foot = surface.normals[index], surface.points[index]
    distance = np.einsum("kni,kni->kn", foot - q, normal)
    p_model_cam = -np.einsum("kji,kj->ki", R, p)
    away = np.einsum("kni,kni->kn", p_model_cam[:, None] - foot, normal) <= 0.0
    share = np.where(lost, 1.0, np.minimum(apart / reach_m, 1.0))
    weight = (1.0 - share**2) ** 2 * ~(lost | away)
    return np.where(lost, 0.0, distance), normal, weight
