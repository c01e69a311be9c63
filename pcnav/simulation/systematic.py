"""Errors of the simulated depth sensor that pixels share: of a frame, of a face, of a material."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import trimesh

from pcnav.config.pipeline_file import Pipeline
from pcnav.config.sensors import NoiseTable
from pcnav.core.arrays import BoolArray, FloatArray, IntArray
from pcnav.core.spatial import invert_transform, transform_points
from pcnav.simulation.miscalibration import Miscalibration
from pcnav.simulation.noise import Systematic
from pcnav.simulation.surroundings.part import Part
from pcnav.simulation.surroundings.view import SceneView
from pcnav.target.mesh import plane_axes

_SINES = 16
_STREAM = 4
"""Beside the seed: these errors leave the draws of the others as they are."""
_BOUNCES = 24
"""Directions in which a point looks for others that light it."""
_FALSE_SPAN = (0.5, 1.5)
"""Of false returns, in distances of the target."""


@dataclass(frozen=True)
class SystematicErrors:
    """The shared errors of a scene's frames; each frame's follow from the seed alone."""

    noise: NoiseTable
    seed: int
    mesh: trimesh.Trimesh
    poses: FloatArray
    """(n, 4, 4) T_cam_model"""
    face: IntArray | None
    """(n_faces,) flat face of every triangle of the target; None where no error is of a face."""
    return_fractions: tuple[float, ...]
    """Of the parts."""
    false_span_m: tuple[float, float]
    miscalibration: Miscalibration

    @staticmethod
    def of(
        pipeline: Pipeline, mesh: trimesh.Trimesh, poses: FloatArray, parts: Sequence[Part]
    ) -> "SystematicErrors":
        """Of a pipeline's sensor."""
        noise = pipeline.noise
        distance = float(np.linalg.norm(poses[0, :3, 3]))
        low, high = noise.false_return_span_m or tuple(distance * k for k in _FALSE_SPAN)
        shares = tuple(part.return_fraction for part in parts)
        # Of large meshes this takes long.
        uneven = noise.face_offset_sd_m > 0.0 or noise.face_tilt_sd_deg > 0.0
        face = flat_faces(mesh) if uneven else None
        off = Miscalibration.of(pipeline)
        return SystematicErrors(noise, pipeline.seed, mesh, poses, face, shares, (low, high), off)

    def of_frame(self, view: SceneView, k: int, time_s: float) -> Systematic:
        """Of the clean image of a frame."""
        error = self._frame_offset(k, time_s) + self._face_errors(view, k, time_s)
        error = error + self._multipath(view, k)
        range_m = view.seen.depth_m.astype(np.float64) * view.seen.range_per_depth
        error = error + self.miscalibration.range_error(range_m)
        return Systematic(error, self._lost(view, k), self.false_span_m)

    def _rng(self, *what: int) -> np.random.Generator:
        return np.random.default_rng([self.seed, _STREAM, *what])

    def _varying(self, what: int, size: int, correlation_s: float, k: int, t: float) -> FloatArray:
        """(size,) standard normal numbers in frame k: white, or slowly varying.

        The latter are sums of sines of normal frequencies, whose correlation over a time is
        ``exp(-(t / correlation)^2 / 2)`` (Rahimi and Recht 2007).
        """
        if correlation_s == 0.0:
            return self._rng(what, 1, k).standard_normal(size)
        rng = self._rng(what, 0)
        turn = rng.standard_normal((size, _SINES)) / correlation_s
        phase = rng.uniform(0.0, 2.0 * np.pi, (size, _SINES))
        return np.asarray(np.sqrt(2.0 / _SINES) * np.cos(turn * t + phase).sum(axis=1))

    def _frame_offset(self, k: int, time_s: float) -> float:
        noise = self.noise
        if noise.frame_offset_sd_m == 0.0:
            return 0.0
        drawn = self._varying(0, 1, noise.frame_offset_correlation_s, k, time_s)
        return noise.frame_offset_sd_m * float(drawn[0])

    def _face_errors(self, view: SceneView, k: int, time_s: float) -> FloatArray | float:
        """(height, width) offset and tilt of each flat face about its middle in the image."""
        noise = self.noise
        if self.face is None:
            return 0.0
        count = int(self.face.max()) + 1
        drawn = self._varying(1, 3 * count, noise.face_correlation_s, k, time_s).reshape(count, 3)
        shown = view.shows_target
        face = self.face[view.seen.triangle[shown]]
        p_cam = (view.seen.rays * view.seen.depth_m[..., None])[shown][:, :2]
        pixels = np.maximum(np.bincount(face, minlength=count), 1)
        middle = np.stack([np.bincount(face, x, count) / pixels for x in p_cam.T], axis=1)
        slope = np.tan(np.deg2rad(noise.face_tilt_sd_deg)) * drawn[:, 1:]
        tilted = np.sum(slope[face] * (p_cam - middle[face]), axis=1)
        error = np.zeros(shown.shape)
        error[shown] = noise.face_offset_sd_m * drawn[face, 0] + tilted
        return error

    def _lost(self, view: SceneView, k: int) -> BoolArray | None:
        noise = self.noise
        lost = np.zeros(view.part.shape, dtype=np.bool_)
        if noise.hole_incidence_deg < 90.0:
            lost |= incidence_cosine(view) < np.cos(np.deg2rad(noise.hole_incidence_deg))
        if noise.dark_fraction > 0.0:
            shown = view.shows_target
            lost[shown] |= self._is_dark(self._p_model(view, k))
        for number, share in enumerate(self.return_fractions, start=1):
            if share < 1.0:
                drawn = self._rng(2, number, k).random(lost.shape)
                lost |= (view.part == number) & (drawn >= share)
        return lost if lost.any() else None

    def _p_model(self, view: SceneView, k: int) -> FloatArray:
        """(n, 3) points of the target that are seen, model frame, in the order of the pixels."""
        rays = view.seen.rays[view.shows_target]
        depth = view.seen.depth_m[view.shows_target].astype(np.float64)
        p_cam, moving = rays * depth[:, None], view.target.moving
        if moving is None:
            return transform_points(invert_transform(self.poses[k]), p_cam)
        poses = moving.exposure.poses[moving.exposure.index[view.shows_target]]
        p_moved = p_cam - poses[:, :3, 3]
        return np.asarray(np.einsum("nji,nj->ni", poses[:, :3, :3], p_moved))

    def _is_dark(self, p_model: FloatArray) -> BoolArray:
        """(n,) whether points lie in dark patches: below a level of a smooth random field."""
        rng = self._rng(3)
        waves = rng.standard_normal((_SINES, 3)) * np.pi / (2.0 * self.noise.dark_patch_m)
        phase = rng.uniform(0.0, 2.0 * np.pi, _SINES)
        everywhere = np.asarray(self.mesh.sample(4000, seed=self.seed))

        def field(points: FloatArray) -> FloatArray:
            return np.asarray(np.cos(points @ waves.T + phase).sum(axis=1))

        level = np.quantile(field(everywhere), self.noise.dark_fraction)
        return np.asarray(field(p_model) < level)

    def _multipath(self, view: SceneView, k: int) -> FloatArray | float:
        """(height, width) by which light that comes by way of another surface lengthens a range.

        Of one bounce: the mean over what a point sees of the target, of half the detour, weighted
        with the share of its light that comes this way.
        """
        shown = view.shows_target
        if self.noise.multipath_fraction == 0.0 or not shown.any():
            return 0.0
        points = self._p_model(view, k)
        normals = np.asarray(self.mesh.face_normals)[view.seen.triangle[shown]]
        eye = invert_transform(self.poses[k])[:3, 3]
        ranges = np.linalg.norm(points - eye, axis=1)
        facing = np.sign(np.sum((eye - points) * normals, axis=1))[:, None]
        directions = np.einsum("nij,kj->nki", plane_axes(normals * facing), _cosine_directions())
        start = points + 1e-4 * float(np.ptp(np.asarray(self.mesh.bounds))) * normals * facing
        origins = np.repeat(start, _BOUNCES, axis=0)
        hits, ray, _ = self.mesh.ray.intersects_location(
            origins, directions.reshape(-1, 3), multiple_hits=False
        )
        point = ray // _BOUNCES
        way = np.linalg.norm(hits - points[point], axis=1)
        detour = 0.5 * (way + np.linalg.norm(hits - eye, axis=1) - ranges[point])
        light = np.bincount(point, minlength=len(points)) * self.noise.multipath_fraction
        longer = np.bincount(point, detour, len(points)) * self.noise.multipath_fraction
        error = np.zeros(shown.shape)
        error[shown] = longer / (_BOUNCES + light)
        return error


def flat_faces(mesh: trimesh.Trimesh) -> IntArray:
    """(n_faces,) number of the flat face that each triangle belongs to."""
    face = np.arange(len(mesh.faces)) + len(mesh.facets)
    for number, triangles in enumerate(mesh.facets):
        face[triangles] = number
    return np.unique(face, return_inverse=True)[1].astype(np.intp)


def incidence_cosine(view: SceneView) -> FloatArray:
    """(height, width) cosine between ray and surface normal; 1 where nothing is seen."""
    seen = view.seen
    cosine = np.ones(seen.depth_m.shape)
    hit = seen.triangle >= 0
    planes = seen.inverse_depth_planes[seen.triangle[hit]]
    # The normal of a plane 1 / z = m . ray is m; the ray times the plane is 1 / z.
    ratio = seen.range_per_depth[hit]
    inverse_depth = np.sum(planes * seen.rays[hit], axis=1)
    cosine[hit] = np.abs(inverse_depth) / (np.linalg.norm(planes, axis=1) * ratio)
    return cosine


def _cosine_directions() -> FloatArray:
    """(_BOUNCES, 3) unit vectors about +z whose density grows with the cosine (Lambert)."""
    index = np.arange(_BOUNCES)
    radius = np.sqrt((index + 0.5) / _BOUNCES)
    azimuth = np.pi * (3.0 - np.sqrt(5.0)) * index
    flat = radius[:, None] * np.stack([np.cos(azimuth), np.sin(azimuth)], axis=1)
    return np.column_stack([flat, np.sqrt(1.0 - radius**2)])
