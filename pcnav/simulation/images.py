"""What one camera sees of a scenario: shaded images of a mesh, or tracks of points on its hull."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar

import numpy as np
import trimesh

from pcnav.config.pipeline_file import Pipeline
from pcnav.config.sensors import ShadingTable
from pcnav.core.arrays import BoolArray, FloatArray, IntArray
from pcnav.core.camera import PinholeCamera
from pcnav.core.errors import InputError
from pcnav.core.spatial import transform_points
from pcnav.dynamics.rigid_body import inertia_from_ratios
from pcnav.dynamics.trajectory import Trajectory
from pcnav.recordings.images import ImageFrame, write_images
from pcnav.recordings.monocular_tracks import CameraFacts, write_monocular_tracks
from pcnav.recordings.recording import RecordingKind
from pcnav.recordings.tracks import MonocularTracks, TrackFrame
from pcnav.simulation.motion import TrueMotion, true_motion
from pcnav.simulation.shading import ImageRenderer
from pcnav.simulation.simulation import OnFrame, Simulation, counted, features_seen
from pcnav.target.satellite import target_mesh_of

Hull = tuple[FloatArray, FloatArray]
"""Places and outward normals (N, 3) of points, model axes, m."""


@dataclass(frozen=True)
class ImageMotion:
    """How the target moves before the camera, and where the light comes from."""

    truth: Trajectory
    """With the poses of the target in the camera."""
    R_cam_world: FloatArray
    """(n, 3, 3)"""
    sun_world: FloatArray
    """(3,) direction to the sun."""

    @staticmethod
    def of(motion: TrueMotion, shading: ShadingTable) -> "ImageMotion":
        """Of a scenario."""
        # World equals Hill at time 0.
        sun_world = motion.R_hill_world[0].T @ np.array(shading.sun_hill)
        return ImageMotion(motion.truth, motion.T_cam_world[:, :3, :3], sun_world)


@dataclass(frozen=True)
class RenderedImages:
    """Images in memory, rendered when they are asked for; each is the same drawn alone."""

    kind: ClassVar[RecordingKind] = RecordingKind.IMAGES
    path: ClassVar[None] = None

    name: str
    renderer: ImageRenderer
    motion: ImageMotion
    seed: int

    @property
    def camera(self) -> PinholeCamera:
        """Intrinsics."""
        return self.renderer.camera

    def __len__(self) -> int:
        return len(self.motion.truth)

    def __iter__(self) -> Iterator[ImageFrame]:
        motion, poses = self.motion, self.motion.truth.poses
        for k, time_s in enumerate(motion.truth.time_s.tolist()):
            rng = np.random.default_rng([self.seed, k])
            sun_cam = motion.R_cam_world[k] @ motion.sun_world
            grey = self.renderer.render(poses[k], sun_cam, rng)
            yield ImageFrame(time_s, motion.R_cam_world[k], grey)


def simulate_images(
    pipeline: Pipeline, source: Path | str = "pipeline", target_mesh: Path | None = None
) -> Simulation[RenderedImages] | Simulation[MonocularTracks]:
    """What the camera of [image_camera] sees.

    ``images`` of that table chooses between shaded images of the mesh and tracks of points: those
    of [features], else points drawn over the mesh, without one over a box of the body's inertia.
    ``source`` is the pipeline's file, which an `InputError` names.
    """
    motion, name = true_motion(pipeline, source), Path(source).stem
    mesh = None if target_mesh is None else target_mesh_of(target_mesh, pipeline.mesh_unit)
    if not pipeline.image_camera.images:
        return _tracks_with_truth(simulated_tracks(pipeline, motion, mesh, name), motion.truth)
    if mesh is None:
        expected = "expected the mesh of the satellite that the images show"
        raise InputError(source, "target_mesh", expected)
    camera = pipeline.image_camera.pinhole
    renderer = ImageRenderer(mesh, camera, pipeline.shading, pipeline.seed)
    seen = ImageMotion.of(motion, pipeline.shading)
    images = RenderedImages(name, renderer, seen, pipeline.seed)
    facts = CameraFacts.of(camera, pipeline.feature_tracker.pixel_sigma_px)

    def store(out: Path, overwrite: bool, on_frame: OnFrame | None) -> str:
        frames = counted(images, len(images), on_frame)
        count = write_images(out, facts, frames, motion.truth, overwrite)
        return f"images: {out} ({count} frames)"

    return Simulation(images, motion.truth, store)


def _tracks_with_truth(tracks: MonocularTracks, truth: Trajectory) -> Simulation[MonocularTracks]:
    def store(out: Path, overwrite: bool, on_frame: OnFrame | None) -> str:
        write_monocular_tracks(out, tracks, truth, overwrite)
        seen = features_seen(out, tracks)
        median = float(np.median(seen))
        return f"tracks: {out} ({len(seen)} frames, median of {median:g} features each)"

    return Simulation(tracks, truth, store)


def simulated_tracks(
    pipeline: Pipeline, motion: TrueMotion, mesh: trimesh.Trimesh | None, name: str
) -> MonocularTracks:
    """Tracks of points of the target; points and tracking draw from streams of their own."""
    drawing, observing = np.random.default_rng(pipeline.seed).spawn(2)
    table, camera = pipeline.features, pipeline.image_camera.pinhole
    faults = TrackFaults(
        pixel_sigma_px=pipeline.image_camera.pixel_sigma_px,
        wrong_match_fraction=table.wrong_match_fraction,
        mean_tracked_s=table.mean_tracked_s,
        max_view_angle_deg=table.max_view_angle_deg,
    )
    hull, seen = _hull(pipeline, mesh, drawing), ImageMotion.of(motion, pipeline.shading)
    tracks = monocular_tracks(camera, seen, hull, faults, observing, name)
    frames = tuple(
        frame if lit else replace(frame, features=frame.features[:0], pixels=frame.pixels[:0])
        for frame, lit in zip(tracks.frames, table.is_lit(motion.truth.time_s), strict=True)
    )
    return replace(tracks, frames=frames)


def surface_points(mesh: trimesh.Trimesh, count: int, rng: np.random.Generator) -> Hull:
    """Points drawn evenly over a mesh."""
    area = np.asarray(mesh.area_faces)
    faces = rng.choice(len(area), count, p=area / area.sum())
    # Two uniform numbers folded into the triangle.
    u, v = rng.uniform(size=(2, count, 1))
    over = u + v > 1.0
    u, v = np.where(over, 1.0 - u, u), np.where(over, 1.0 - v, v)
    a, b, c = np.moveaxis(np.asarray(mesh.triangles, dtype=np.float64)[faces], 1, 0)
    return a + u * (b - a) + v * (c - a), np.asarray(mesh.face_normals, dtype=np.float64)[faces]


@dataclass(frozen=True)
class TrackFaults:
    """How simulated tracks fall short of perfect ones."""

    pixel_sigma_px: float = 0.0
    wrong_match_fraction: float = 0.0
    """Share of observations that are those of another place on the target."""
    mean_tracked_s: float | None = None
    """Mean life of a track; its point is found again at once, under a new number."""
    max_view_angle_deg: float = 84.0
    """Between a point's normal and the direction to the camera, beyond which it is hidden."""


def monocular_tracks(
    camera: PinholeCamera,
    motion: ImageMotion,
    points: Hull,
    faults: TrackFaults,
    rng: np.random.Generator,
    name: str = "simulated",
) -> MonocularTracks:
    """Tracks of points on the target's hull.

    A point is hidden by its own face alone. One that comes back into view has a new number.
    """
    noise, matching, lives = rng.spawn(3)
    T_cam_model, times_s = motion.truth.poses, motion.truth.time_s
    p_cam = transform_points(T_cam_model, points[0])
    normals = points[1] @ np.swapaxes(T_cam_model[:, :3, :3], 1, 2)
    facing = -np.sum(normals * p_cam, axis=-1) / np.linalg.norm(p_cam, axis=-1)
    seen = (facing > np.cos(np.deg2rad(faults.max_view_angle_deg))) & (p_cam[..., 2] > 0.0)
    depth = np.where(seen, p_cam[..., 2], 1.0)
    pixels = p_cam[..., :2] / depth[..., None] * [camera.fx, camera.fy] + [camera.cx, camera.cy]
    pixels += faults.pixel_sigma_px * noise.standard_normal(pixels.shape)
    seen &= np.all((pixels >= 0.0) & (pixels <= [camera.width - 1, camera.height - 1]), axis=-1)
    numbers = _numbers(seen, times_s, faults.mean_tracked_s, lives)
    frames = []
    for k, time_s in enumerate(times_s.tolist()):
        at = np.flatnonzero(seen[k])
        found = pixels[k, at]
        wrong = matching.uniform(size=len(at)) < faults.wrong_match_fraction
        if len(at) and k:
            spread = found.std(axis=0)
            elsewhere = found[matching.integers(len(at), size=len(at))]
            elsewhere = elsewhere + 0.3 * spread * matching.standard_normal(found.shape)
            found = np.where(wrong[:, None], elsewhere, found)
        frames.append(TrackFrame(time_s, motion.R_cam_world[k], numbers[k, at], found))
    return MonocularTracks(name, camera, faults.pixel_sigma_px or 1e-3, tuple(frames))


def _numbers(
    seen: BoolArray,
    times_s: FloatArray,
    mean_tracked_s: float | None,
    rng: np.random.Generator,
) -> IntArray:
    """(n, N) number of every point's track at every frame."""
    steps = np.diff(times_s, prepend=times_s[0])
    lost = np.zeros(len(steps)) if mean_tracked_s is None else -np.expm1(-steps / mean_tracked_s)
    again = rng.uniform(size=seen.shape) < lost[:, None]
    again[1:] |= seen[1:] & ~seen[:-1]
    again[0] = False
    life = np.cumsum(again, axis=0)
    return np.asarray(np.arange(seen.shape[1]) + life * seen.shape[1], dtype=np.intp)


def box_of_inertia(inertia: FloatArray, half_side_m: float) -> tuple[FloatArray, FloatArray]:
    """Half sides (3,), the largest as given, and R_body_box (3, 3) of a uniform box.

    It has the principal axes and the ratios of the moments of an inertia (3, 3) of any scale.
    """
    moments, axes = np.linalg.eigh(inertia)
    # I_x = m (b^2 + c^2) / 3 of half sides b, c, hence a^2 from the three.
    squared = np.maximum(moments.sum() - 2.0 * moments, 0.0)
    half = half_side_m * np.sqrt(squared / squared.max())
    return half, axes * np.sign(np.linalg.det(axes))


def _hull(pipeline: Pipeline, mesh: trimesh.Trimesh | None, rng: np.random.Generator) -> Hull:
    table, com_model = pipeline.features, pipeline.body.com_model
    if table.points_m:
        points = np.array(table.points_m)
        normals = np.array(table.normals_body) if table.normals_body else points
        # A point at the mass centre has no direction of its own, and is never seen.
        length = np.linalg.norm(normals, axis=1, keepdims=True)
        return points + com_model, normals / np.where(length > 0.0, length, 1.0)
    if mesh is not None:
        return surface_points(mesh, table.count, rng)
    inertia = inertia_from_ratios(pipeline.body.ratios)
    half, R_body_box = box_of_inertia(inertia, table.half_extent_m)
    box = trimesh.creation.box(2.0 * half)
    places, normals = surface_points(box, table.count, rng)
    return places @ R_body_box.T + com_model, normals @ R_body_box.T
