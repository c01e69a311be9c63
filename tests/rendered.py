"""A satellite that another ray caster renders: nothing of pcnav's simulation is in it."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import trimesh
from scipy.spatial.transform import Rotation

from pcnav.core._open3d import open3d
from pcnav.core.arrays import FloatArray

K = np.array([[130.0, 0.0, 79.5], [0.0, 130.0, 59.5], [0.0, 0.0, 1.0]])
WIDTH, HEIGHT, FRAMES, STEP_S, SIGMA_M = 160, 120, 6, 0.2, 0.004
EPOCH_S = 1.7e9
HOLES = (np.nan, np.inf, -1.0, 0.0)
UNIT_M = np.float32(1e-4)
"""Depths are multiples of it, which 16-bit images hold exactly."""


@dataclass(frozen=True)
class Scene:
    """A satellite in millimetres, and what a camera sees of it."""

    mesh: trimesh.Trimesh
    poses: FloatArray
    """(n, 4, 4) true T_cam_model."""
    depths: tuple[np.ndarray, ...]
    times_s: tuple[float, ...]


@lru_cache
def rendered_scene() -> Scene:
    """Six frames of a turning box with a wing, holes of every kind."""
    parts = [trimesh.creation.box((1200, 900, 700)), trimesh.creation.box((1800, 20, 600))]
    parts[1].apply_translation((1500, 0, 80))
    mesh = trimesh.util.concatenate(parts)
    assert isinstance(mesh, trimesh.Trimesh)
    library = open3d()
    caster, tensor = library.t.geometry.RaycastingScene(), library.core.Tensor.from_numpy
    corners = np.asarray(1e-3 * mesh.vertices, dtype=np.float32)
    caster.add_triangles(tensor(corners), tensor(np.asarray(mesh.faces, dtype=np.uint32)))
    # Open3D counts pixels from their corners, pcnav from their centres.
    from_corners = K + np.array([[0.0, 0.0, 0.5], [0.0, 0.0, 0.5], [0.0, 0.0, 0.0]])
    rng, depths, poses = np.random.default_rng(3), [], []
    times_s = tuple(STEP_S * k for k in range(FRAMES))
    for k, t in enumerate(times_s):
        pose = np.eye(4)
        turn = Rotation.from_rotvec([0.4, -0.3, 0.2])
        pose[:3, :3] = (turn * Rotation.from_rotvec(np.radians([3.0, -4.0, 2.0]) * t)).as_matrix()
        pose[:3, 3] = (0.1 + 0.01 * t, -0.05, 5.0)
        rays = caster.create_rays_pinhole(tensor(from_corners), tensor(pose), WIDTH, HEIGHT)
        # Their directions have z = 1, so that what is returned is depth.
        z = caster.cast_rays(rays)["t_hit"].numpy() + rng.normal(0.0, SIGMA_M, (HEIGHT, WIDTH))
        units = np.rint(np.nan_to_num(z, posinf=0.0) / UNIT_M).astype(np.float32)
        depths.append(np.where(np.isfinite(z), units * UNIT_M, HOLES[k % len(HOLES)]))
        poses.append(pose)
    return Scene(mesh, np.array(poses), tuple(d.astype(np.float32) for d in depths), times_s)
