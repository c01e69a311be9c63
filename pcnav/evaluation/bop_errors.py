"""The pose errors of the BOP challenge: MSSD, MSPD, and the average recalls made of them.

Hodan et al. 2020, "BOP Challenge 2020 on 6D Object Localization", section 2.3: the largest distance
of a vertex of the model between true and estimated pose, in space and in the image, under that of
the model's symmetries that makes it least.
"""

from dataclasses import dataclass

import numpy as np
import trimesh

from pcnav.core.arrays import FloatArray
from pcnav.core.spatial import transform_points
from pcnav.target.roundness import Roundness

MSSD_THRESHOLDS: FloatArray = np.arange(1.0, 11.0, dtype=np.float64) * 0.05
"""Shares of the model's diameter."""
MSPD_THRESHOLDS_PX: FloatArray = np.arange(1.0, 11.0, dtype=np.float64) * 5.0
"""Of an image 640 px wide."""
_BOP_WIDTH_PX = 640.0
_MAX_VERTICES = 2000
_POINTS_AT_ONCE = 1_000_000


@dataclass(frozen=True)
class BopErrors:
    """One value a frame, nan where a pose is missing."""

    mssd_m: FloatArray
    """(n,)"""
    mspd_px: FloatArray
    """(n,)"""


def bop_vertices(mesh: trimesh.Trimesh) -> FloatArray:
    """(m, 3) the vertices of a mesh, m; of a large one those of its hull, where distances are
    largest, and as many others as fit, spread over all."""
    vertices = np.unique(np.asarray(mesh.vertices, dtype=np.float64), axis=0)
    if len(vertices) <= _MAX_VERTICES:
        return vertices
    hull = np.asarray(mesh.convex_hull.vertices, dtype=np.float64)
    step = -(-len(vertices) // max(1, _MAX_VERTICES - len(hull)))
    return np.concatenate([hull, vertices[::step]])


def bop_errors(
    vertices: FloatArray,
    T_cam_model_true: FloatArray,
    T_cam_model: FloatArray,
    symmetry_transforms: FloatArray,
    intrinsics: FloatArray,
    roundness: Roundness | None = None,
) -> BopErrors:
    """MSSD and MSPD of true and estimated poses (n, 4, 4).

    Args:
        vertices: (m, 3) of the model, m.
        T_cam_model_true: (n, 4, 4)
        T_cam_model: (n, 4, 4)
        symmetry_transforms: (k, 4, 4) motions that leave the model unchanged, the identity among
            them.
        intrinsics: (n, 4) fx, fy, cx, cy, px; the lens is left out, as BOP does.
        roundness: of a model that can be turned by any angle: the true pose is then turned as it
            comes nearest to the estimated one.
    """
    mssd, mspd = np.full(len(T_cam_model), np.nan), np.full(len(T_cam_model), np.nan)
    finite = [np.isfinite(T).all(axis=(1, 2)) for T in (T_cam_model_true, T_cam_model)]
    frames = np.flatnonzero(finite[0] & finite[1])
    size = max(1, _POINTS_AT_ONCE // (len(vertices) * len(symmetry_transforms)))
    for start in range(0, len(frames), size):
        batch = frames[start : start + size]
        true = T_cam_model_true[batch, None] @ symmetry_transforms
        estimated = T_cam_model[batch, None]
        if roundness is not None:
            relative = np.swapaxes(true[..., :3, :3], -1, -2) @ estimated[..., :3, :3]
            true = true @ roundness.towards(relative)
        p_true, p = transform_points(true, vertices), transform_points(estimated, vertices)
        mssd[batch] = np.linalg.norm(p - p_true, axis=-1).max(axis=2).min(axis=1)
        mspd[batch] = _in_image(p, p_true, intrinsics[batch]).max(axis=2).min(axis=1)
    return BopErrors(mssd, mspd)


def recall(errors: FloatArray, thresholds: FloatArray) -> FloatArray:
    """(n,) share of thresholds (k,) that errors (n,) stay below; 0 for what is nan."""
    return np.asarray((errors[:, None] < thresholds).mean(axis=1))


def mspd_thresholds_px(width_px: int) -> FloatArray:
    """(k,) thresholds of the MSPD for an image of a width."""
    return np.asarray(MSPD_THRESHOLDS_PX * width_px / _BOP_WIDTH_PX)


def _in_image(p: FloatArray, p_true: FloatArray, intrinsics: FloatArray) -> FloatArray:
    """(n, k, m) px between the images of points (n, k, m, 3) in the cameras of n frames; infinite
    where one is behind the camera."""
    focal = intrinsics[:, None, None, :2]
    with np.errstate(divide="ignore", invalid="ignore"):
        apart = focal * (p[..., :2] / p[..., 2:] - p_true[..., :2] / p_true[..., 2:])
    is_seen = (p[..., 2] > 0.0) & (p_true[..., 2] > 0.0)
    return np.where(is_seen, np.linalg.norm(apart, axis=-1), np.inf)
