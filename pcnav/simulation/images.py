"""Shaded images of a satellite and monocular tracks of its points, with the truth behind them."""

import csv
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import trimesh
from PIL import Image
from scipy.ndimage import map_coordinates

from pcnav.config.sensors import ImageCameraTable, ShadingTable
from pcnav.core.arrays import BoolArray, FloatArray, IntArray
from pcnav.core.camera import PinholeCamera, pixel_rays
from pcnav.core.spatial import invert_transform, transform_points
from pcnav.dynamics.state import NavigationState
from pcnav.files.new_folder import new_folder
from pcnav.recordings.images import IMAGE_FOLDER, TIMES_FILE, GreyImage
from pcnav.recordings.monocular import (
    CAMERA_FILE,
    CameraFacts,
    MonocularFrame,
    MonocularTracks,
    write_camera_attitudes,
    write_camera_file,
)
from pcnav.recordings.state_table import STATE_COLUMNS, state_row
from pcnav.recordings.writer import TRUTH_FILE
from pcnav.simulation.scenario import TrueMotion
from pcnav.target.rendering import DepthRenderer

_LATTICE = 32
"""Nodes per axis of the random lattice of the texture, which repeats."""
_OCTAVES = ((1.0, 0.5), (0.5, 0.5))
"""Size of the blobs over the cell, and weight."""
_BRIGHTEST = 235.0
"""Grey level of a white surface that faces the sun."""


def image_camera(table: ImageCameraTable) -> PinholeCamera:
    """The camera of an [image_camera] table."""
    middle = (0.5 * (table.width_px - 1), 0.5 * (table.height_px - 1))
    cx, cy = table.centre_px or middle
    return PinholeCamera(table.width_px, table.height_px, table.focal_px, table.focal_px, cx, cy)


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
        self._shading, self._camera = shading, camera
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
        grey = np.zeros((self._camera.height, self._camera.width))
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


@dataclass(frozen=True)
class ImageMotion:
    """How camera and target move."""

    times_s: FloatArray
    """(n,)"""
    T_cam_model: FloatArray
    """(n, 4, 4), m."""
    R_cam_world: FloatArray
    """(n, 3, 3)"""
    sun_world: FloatArray
    """(3,) direction to the sun."""


def render_images(
    renderer: ImageRenderer, motion: ImageMotion, seed: int
) -> Iterator[tuple[float, FloatArray, GreyImage]]:
    """Time (s), R_cam_world (3, 3) and image of every frame; each is the same drawn alone."""
    for k, time_s in enumerate(motion.times_s.tolist()):
        rng = np.random.default_rng([seed, k])
        sun_cam = motion.R_cam_world[k] @ motion.sun_world
        yield time_s, motion.R_cam_world[k], renderer.render(motion.T_cam_model[k], sun_cam, rng)


def motion_of(truth: TrueMotion, shading: ShadingTable) -> ImageMotion:
    """The motion of a simulated scenario."""
    T_cam_model = np.stack([truth.T_cam_model(k) for k in range(len(truth.times_s))])
    # World equals Hill at time 0.
    sun_world = truth.R_hill_world[0].T @ np.array(shading.sun_hill)
    return ImageMotion(truth.times_s, T_cam_model, truth.T_cam_world[:, :3, :3], sun_world)


def surface_points(
    mesh: trimesh.Trimesh, count: int, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    """Places and normals (count, 3) of points drawn evenly over a mesh, for `monocular_tracks`."""
    area = np.asarray(mesh.area_faces)
    faces = rng.choice(len(area), count, p=area / area.sum())
    # Two uniform numbers folded into the triangle.
    u, v = rng.uniform(size=(2, count, 1))
    over = u + v > 1.0
    u, v = np.where(over, 1.0 - u, u), np.where(over, 1.0 - v, v)
    a, b, c = np.moveaxis(np.asarray(mesh.triangles, dtype=np.float64)[faces], 1, 0)
    return a + u * (b - a) + v * (c - a), np.asarray(mesh.face_normals, dtype=np.float64)[faces]


def write_images(
    out: Path,
    camera: PinholeCamera,
    pixel_sigma_px: float,
    images: Iterator[tuple[float, FloatArray, GreyImage]],
    overwrite: bool = False,
    states: Sequence[NavigationState] | None = None,
) -> int:
    """Write a folder that `pcnav.recordings.images` reads; how many images it holds.

    ``states`` is the truth at every image, where known. The folder appears, whole, at the end.
    Raises `InputError` for one that must not be replaced.
    """
    with new_folder(out, overwrite, CAMERA_FILE) as folder:
        (folder / IMAGE_FOLDER).mkdir()
        times_s, attitudes = [], []
        for k, (time_s, R_cam_world, image) in enumerate(images):
            Image.fromarray(image).save(folder / IMAGE_FOLDER / f"{k:06d}.png", compress_level=1)
            times_s.append(time_s)
            attitudes.append(R_cam_world)
        write_camera_file(folder / CAMERA_FILE, CameraFacts(camera, pixel_sigma_px, None, None))
        lines = "\n".join(["time_s", *(repr(time_s) for time_s in times_s)])
        (folder / TIMES_FILE).write_text(f"{lines}\n", encoding="utf-8")
        write_camera_attitudes(folder, np.array(times_s), np.array(attitudes).reshape(-1, 3, 3))
        if states is not None:
            write_true_states(folder, np.array(times_s), states)
    return len(times_s)


def write_true_states(folder: Path, times_s: FloatArray, states: Sequence[NavigationState]) -> None:
    """Write truth.csv into a folder of images or of monocular tracks."""
    with (folder / TRUTH_FILE).open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(STATE_COLUMNS)
        for time_s, state in zip(times_s.tolist(), states, strict=True):
            writer.writerow(state_row(time_s, state).tolist())


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
    points: tuple[FloatArray, FloatArray],
    faults: TrackFaults,
    rng: np.random.Generator,
    name: str = "simulated",
) -> MonocularTracks:
    """Tracks of points on the target's hull: places and outward normals, both (N, 3), model axes.

    A point is hidden by its own face alone. One that comes back into view has a new number.
    """
    noise, matching, lives = rng.spawn(3)
    p_cam = transform_points(motion.T_cam_model, points[0])
    normals = points[1] @ np.swapaxes(motion.T_cam_model[:, :3, :3], 1, 2)
    facing = -np.sum(normals * p_cam, axis=-1) / np.linalg.norm(p_cam, axis=-1)
    seen = (facing > np.cos(np.deg2rad(faults.max_view_angle_deg))) & (p_cam[..., 2] > 0.0)
    depth = np.where(seen, p_cam[..., 2], 1.0)
    pixels = p_cam[..., :2] / depth[..., None] * [camera.fx, camera.fy] + [camera.cx, camera.cy]
    pixels += faults.pixel_sigma_px * noise.standard_normal(pixels.shape)
    seen &= np.all((pixels >= 0.0) & (pixels <= [camera.width - 1, camera.height - 1]), axis=-1)
    numbers = _numbers(seen, motion.times_s, faults.mean_tracked_s, lives)
    frames = []
    for k, time_s in enumerate(motion.times_s.tolist()):
        at = np.flatnonzero(seen[k])
        found = pixels[k, at]
        wrong = matching.uniform(size=len(at)) < faults.wrong_match_fraction
        if len(at) and k:
            spread = found.std(axis=0)
            elsewhere = found[matching.integers(len(at), size=len(at))]
            elsewhere = elsewhere + 0.3 * spread * matching.standard_normal(found.shape)
            found = np.where(wrong[:, None], elsewhere, found)
        frames.append(MonocularFrame(time_s, motion.R_cam_world[k], numbers[k, at], found))
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
