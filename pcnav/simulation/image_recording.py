"""Simulating what one camera sees of a whole pipeline file: tracks, or shaded images, and truth."""

import logging
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import trimesh

from pcnav.config.pipeline_file import Pipeline
from pcnav.core.arrays import FloatArray, IntArray
from pcnav.core.errors import InputError
from pcnav.dynamics.rigid_body import inertia_from_ratios
from pcnav.files.new_folder import new_folder
from pcnav.recordings.images import GreyImage
from pcnav.recordings.monocular import (
    MONOCULAR_TRACKS_FILE,
    MonocularFrame,
    MonocularTracks,
    write_monocular_files,
)
from pcnav.simulation.images import (
    ImageRenderer,
    TrackFaults,
    image_camera,
    monocular_tracks,
    motion_of,
    render_images,
    surface_points,
    write_images,
    write_true_states,
)
from pcnav.simulation.scenario import TrueMotion, true_motion
from pcnav.target.mesh import read_mesh

OnProgress = Callable[[int, int], None]
"""Told how many frames are done, and of how many."""

Hull = tuple[FloatArray, FloatArray]
"""Places and outward normals (N, 3) of points, model axes, m."""

_LOG = logging.getLogger("pcnav")


@dataclass(frozen=True)
class ImagesSummary:
    """What `simulate_images` wrote."""

    path: Path
    frames: int
    median_seen: float | None
    """Median number of features seen in a frame; None for images."""

    @property
    def text(self) -> str:
        """In a line."""
        if self.median_seen is None:
            return f"images: {self.path} ({self.frames} frames)"
        seen = f"median of {self.median_seen:g} features each"
        return f"tracks: {self.path} ({self.frames} frames, {seen})"


def simulate_images(
    pipeline: Pipeline,
    out: Path,
    overwrite: bool = False,
    source: Path | str = "pipeline",
    target_mesh: Path | None = None,
    on_progress: OnProgress | None = None,
) -> ImagesSummary:
    """Write what the camera of [image_camera] sees, and the truth; the same pipeline, the same.

    ``images`` of that table chooses between shaded images of the mesh and tracks of points: those
    of [features], else points drawn over the mesh, without one over a box of the body's inertia.
    ``source`` is the pipeline's file, which an `InputError` names: for a scenario that cannot be
    simulated, and for a folder that must not be replaced. Nothing is then left behind.
    """
    truth = true_motion(pipeline, source)
    mesh = None if target_mesh is None else read_mesh(target_mesh)
    if pipeline.image_camera.images:
        if mesh is None:
            expected = "expected the mesh of the satellite that the images show"
            raise InputError(source, "target_mesh", expected)
        return _write_images(pipeline, truth, mesh, out, overwrite, on_progress)
    tracks = simulated_tracks(pipeline, truth, mesh, Path(source).stem)
    with new_folder(out, overwrite, MONOCULAR_TRACKS_FILE) as folder:
        write_monocular_files(folder, tracks)
        write_true_states(folder, truth.times_s, truth.states)
    seen = np.array([len(frame.features) for frame in tracks.frames])
    if not seen.any():
        _LOG.warning("%s: no feature is seen in any of the %d frames", out, len(seen))
    return ImagesSummary(out, len(seen), float(np.median(seen)))


def simulated_tracks(
    pipeline: Pipeline, truth: TrueMotion, mesh: trimesh.Trimesh | None, name: str
) -> MonocularTracks:
    """Tracks of points of the target; points and tracking draw from streams of their own."""
    drawing, observing = np.random.default_rng(pipeline.seed).spawn(2)
    table, camera = pipeline.features, image_camera(pipeline.image_camera)
    faults = TrackFaults(
        pixel_sigma_px=pipeline.image_camera.pixel_sigma_px,
        wrong_match_fraction=table.wrong_match_fraction,
        mean_tracked_s=table.mean_tracked_s,
        max_view_angle_deg=table.max_view_angle_deg,
    )
    hull = _hull(pipeline, mesh, drawing)
    motion = motion_of(truth, pipeline.shading)
    tracks = monocular_tracks(camera, motion, hull, faults, observing, name)
    frames = tuple(
        _blind(frame) if _within(table.blackouts_s, frame.time_s) else frame
        for frame in tracks.frames
    )
    return replace(tracks, frames=frames)


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
    table, com_model = pipeline.features, np.array(pipeline.body.com_model_m)
    if table.points_m:
        points = np.array(table.points_m)
        normals = np.array(table.normals_body) if table.normals_body else points
        # A point at the mass centre has no direction of its own, and is never seen.
        length = np.linalg.norm(normals, axis=1, keepdims=True)
        return points + com_model, normals / np.where(length > 0.0, length, 1.0)
    if mesh is not None:
        return surface_points(mesh, table.count, rng)
    inertia = inertia_from_ratios(np.array(pipeline.body.inertia_ratios))
    half, R_body_box = box_of_inertia(inertia, table.half_extent_m)
    box = trimesh.creation.box(2.0 * half)
    places, normals = surface_points(box, table.count, rng)
    return places @ R_body_box.T + com_model, normals @ R_body_box.T


def _write_images(
    pipeline: Pipeline,
    truth: TrueMotion,
    mesh: trimesh.Trimesh,
    out: Path,
    overwrite: bool,
    on_progress: OnProgress | None,
) -> ImagesSummary:
    camera, frames = image_camera(pipeline.image_camera), len(truth.times_s)
    renderer = ImageRenderer(mesh, camera, pipeline.shading, pipeline.seed)
    images = render_images(renderer, motion_of(truth, pipeline.shading), pipeline.seed)
    sigma_px = pipeline.feature_tracker.pixel_sigma_px
    counted = _counted(images, frames, on_progress)
    count = write_images(out, camera, sigma_px, counted, overwrite, truth.states)
    return ImagesSummary(out, count, None)


def _counted(
    images: Iterator[tuple[float, FloatArray, GreyImage]],
    frames: int,
    on_progress: OnProgress | None,
) -> Iterator[tuple[float, FloatArray, GreyImage]]:
    for k, image in enumerate(images, start=1):
        yield image
        if on_progress is not None:
            on_progress(k, frames)


def _within(spans_s: tuple[tuple[float, float], ...], time_s: float) -> bool:
    return any(start <= time_s < end for start, end in spans_s)


def _blind(frame: MonocularFrame) -> MonocularFrame:
    nothing: IntArray = np.zeros(0, dtype=np.intp)
    return replace(frame, features=nothing, pixels=np.zeros((0, 2)))
