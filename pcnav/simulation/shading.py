"""Shaded images of a mesh under a sun: Lambert's law, a texture in the volume, no cast shadows."""

from dataclasses import dataclass

import numpy as np
import trimesh
from scipy.ndimage import map_coordinates

from pcnav.config.sensors import ShadingTable
from pcnav.core.arrays import FloatArray
from pcnav.core.camera import PinholeCamera, pixel_rays
from pcnav.core.spatial import invert_transform, transform_points
from pcnav.recordings.images import GreyImage
from pcnav.target.rendering import DepthRenderer

_LATTICE = 32
"""Nodes per axis of the random lattice of the texture, which repeats."""
_OCTAVES = ((1.0, 0.5), (0.5, 0.5))
"""Size of the blobs over the cell, and weight."""
_BRIGHTEST = 235.0
"""Grey level of a white surface that faces the sun."""


@dataclass(frozen=True)
class Texture:
    """Smooth random brightness in space, fixed to the target: value noise of two sizes.

    It is defined in the volume, so it needs no texture coordinates and does not tear at edges.
    """

    lattice: FloatArray
    """(m, m, m) in 0 to 1."""
    cell_m: float

    @staticmethod
    def random(cell_m: float, seed: int) -> "Texture":
        """One texture per seed."""
        rng = np.random.default_rng(seed)
        return Texture(rng.uniform(size=(_LATTICE,) * 3), cell_m)

    def at(self, points: FloatArray) -> FloatArray:
        """(n,) brightness, about 0 to 1, at points (n, 3) of the target, m."""
        total = np.zeros(len(points))
        for size, weight in _OCTAVES:
            place = points.T / (size * self.cell_m)
            total += weight * map_coordinates(self.lattice, place, order=1, mode="grid-wrap")
        return total


class ImageRenderer:
    """Grey images of one mesh: Lambert's law, its texture, no cast shadows."""

    def __init__(
        self, mesh: trimesh.Trimesh, camera: PinholeCamera, shading: ShadingTable, seed: int = 0
    ) -> None:
        k = shading.supersampling
        self._fine = PinholeCamera(
            *(k * camera.width, k * camera.height, k * camera.fx, k * camera.fy),
            # The centre of the first pixel is at 0 in both images.
            *(k * camera.cx + 0.5 * (k - 1), k * camera.cy + 0.5 * (k - 1)),
        )
        self._shading, self.camera = shading, camera
        self._renderer = DepthRenderer(mesh, self._fine)
        self._normals = np.array(mesh.face_normals, dtype=np.float64)
        self._texture = Texture.random(shading.texture_cell_m, seed)

    def render(
        self, T_cam_model: FloatArray, sun_cam: FloatArray, rng: np.random.Generator
    ) -> GreyImage:
        """The image at a pose (4, 4), m, with the direction to the sun (3,) in camera axes."""
        rendered = self._renderer.render(T_cam_model)
        rows, columns = rendered.window
        face = rendered.triangle[rows, columns]
        hit = face >= 0
        rays = pixel_rays(self._fine)[rows, columns][hit]
        depth = rendered.depth_m[rows, columns][hit].astype(np.float64)
        points = transform_points(invert_transform(T_cam_model), rays * depth[:, None])
        normals = self._normals[face[hit]] @ T_cam_model[:3, :3].T
        # A sheet may be seen from its back: its normal is the one that faces the camera.
        normals = np.where(np.sum(normals * rays, axis=1)[:, None] > 0.0, -normals, normals)
        sun = sun_cam / np.linalg.norm(sun_cam)
        table = self._shading
        light = table.ambient + (1.0 - table.ambient) * np.maximum(normals @ sun, 0.0)
        paint = 1.0 - table.texture_contrast * (1.0 - self._texture.at(points))
        fine = np.zeros(face.shape, dtype=np.float64)
        fine[hit] = _BRIGHTEST * light * paint
        grey = np.zeros((self.camera.height, self.camera.width))
        self._fold(fine, rows.start, columns.start, grey)
        grey += table.noise_levels * rng.standard_normal(grey.shape)
        return np.clip(np.rint(grey), 0.0, 255.0).astype(np.uint8)

    def _fold(self, fine: FloatArray, top: int, left: int, grey: FloatArray) -> None:
        """Mean of the rays of each pixel, added into the image."""
        k = self._shading.supersampling
        if not fine.size:
            return
        before = (top % k, left % k)
        after = tuple(-(b + n) % k for b, n in zip(before, fine.shape, strict=True))
        padded = np.pad(fine, ((before[0], after[0]), (before[1], after[1])))
        height, width = padded.shape[0] // k, padded.shape[1] // k
        folded = padded.reshape(height, k, width, k).mean(axis=(1, 3))
        grey[top // k : top // k + height, left // k : left // k + width] += folded
