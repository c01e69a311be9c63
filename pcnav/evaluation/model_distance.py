"""Distances of a model's points between its true and its estimated pose: ADD and ADD-S.

Hinterstoisser et al. 2012, "Model Based Training, Detection and Pose Estimation of Texture-Less 3D
Objects", equations (7) and (8).
"""

from dataclasses import dataclass

import numpy as np
import trimesh
from scipy.spatial import cKDTree

from pcnav.core.arrays import FloatArray
from pcnav.core.spatial import invert_transform, transform_points

_POINTS_AT_ONCE = 200_000
"""Bounds the memory of one batch of poses to some 20 MB."""


@dataclass(frozen=True)
class ModelDistances:
    """Mean distances of the model's points, pose by pose; nan where a pose is not finite."""

    add_m: FloatArray
    """(n,) of each point to itself (ADD)."""
    add_s_m: FloatArray
    """(n,) of each true point to the nearest estimated one (ADD-S), for symmetric targets."""


def surface_points(
    mesh: trimesh.Trimesh, symmetry_motions: FloatArray, count: int = 1000, seed: int = 0
) -> FloatArray:
    """(m, 3) points spread at random over a mesh's surface, model frame, m.

    ``symmetry_motions`` (k, 4, 4), the identity among them, are those that leave the target
    unchanged. Every point comes with its images under them, so that a pose that is off by a
    symmetry has an ADD-S of zero, and not of the distance between random points. At least
    ``count`` points.
    """
    own = -(-count // len(symmetry_motions))
    points, _ = trimesh.sample.sample_surface(mesh, own, seed=seed)
    images = transform_points(symmetry_motions, np.asarray(points, dtype=np.float64))
    return np.asarray(images.reshape(-1, 3))


def model_distances(
    points: FloatArray, T_cam_model_true: FloatArray, T_cam_model: FloatArray
) -> ModelDistances:
    """ADD and ADD-S of true and estimated poses (n, 4, 4), over points (m, 3) of the model, m."""
    add = np.full(len(T_cam_model), np.nan)
    add_s = np.full(len(T_cam_model), np.nan)
    known = np.isfinite(T_cam_model_true).all(axis=(1, 2)) & np.isfinite(T_cam_model).all(
        axis=(1, 2)
    )
    tree = cKDTree(points)
    size = max(1, _POINTS_AT_ONCE // len(points))
    frames = np.flatnonzero(known)
    for start in range(0, len(frames), size):
        batch = frames[start : start + size]
        # Distances do not change when both clouds are seen from the estimated model frame, where
        # the estimated cloud is the one the tree was built of.
        T = invert_transform(T_cam_model[batch]) @ T_cam_model_true[batch]
        moved = transform_points(T, points)
        add[batch] = np.linalg.norm(moved - points, axis=2).mean(axis=1)
        add_s[batch] = np.mean(tree.query(moved)[0], axis=1)
    return ModelDistances(add, add_s)
