"""Shaded images and simulated monocular tracks."""

from pathlib import Path

import numpy as np
import pytest
import trimesh

from pcnav.config.pipeline_file import read_pipeline
from pcnav.config.sensors import ImageCameraTable, ShadingTable
from pcnav.config.shipped import shipped_mesh, shipped_pipeline
from pcnav.core.camera import PinholeCamera, project
from pcnav.core.spatial import exp_rotation, make_transform, transform_points
from pcnav.dynamics.blocks import POSE_LAYOUT
from pcnav.dynamics.rigid_body import inertia_from_ratios
from pcnav.dynamics.trajectory import Trajectory
from pcnav.recordings.images import open_images, write_images
from pcnav.recordings.monocular_tracks import CameraFacts
from pcnav.simulation.images import (
    ImageMotion,
    RenderedImages,
    TrackFaults,
    box_of_inertia,
    monocular_tracks,
    surface_points,
)
from pcnav.simulation.motion import true_motion
from pcnav.simulation.shading import ImageRenderer, Texture
from pcnav.target.mesh_files.reading import read_mesh

CAMERA = PinholeCamera(80, 60, 100.0, 100.0, 39.5, 29.5)
PLAIN = ShadingTable(texture_contrast=0.0, noise_levels=0.0, ambient=0.0)
AHEAD = make_transform(np.eye(3), np.array([0.0, 0.0, 5.0]))


def test_lambert_on_a_plate() -> None:
    plate = trimesh.creation.box((2.0, 1.6, 0.2))
    rng = np.random.default_rng(0)
    for angle in (0.0, 0.5, 1.2):
        sun = np.array([np.sin(angle), 0.0, -np.cos(angle)])
        image = ImageRenderer(plate, CAMERA, PLAIN).render(AHEAD, sun, rng)
        assert int(image[30, 40]) == pytest.approx(235.0 * np.cos(angle), abs=1.0)
        assert image[2, 2] == 0


def test_the_outline_lies_where_the_projection_says() -> None:
    """Mean columns and rows of the light are those of the plate's projection."""
    plate = trimesh.creation.box((1.0, 0.8, 1e-6))
    shading = PLAIN.model_copy(update={"supersampling": 3})
    for place in ([0.313, -0.127, 5.0], [-0.2, 0.31, 5.0]):
        T = make_transform(np.eye(3), np.array(place))
        sun = np.array([0.0, 0.0, -1.0])
        image = ImageRenderer(plate, CAMERA, shading).render(T, sun, np.random.default_rng(0))
        light = image.astype(float) / image.sum()
        middle = [light.sum(axis=0) @ np.arange(80), light.sum(axis=1) @ np.arange(60)]
        assert middle == pytest.approx(project(CAMERA, np.array(place)), abs=0.5 / 3 + 0.01)


def test_the_texture_is_fixed_to_the_target() -> None:
    plate = trimesh.creation.box((1.6, 1.2, 0.1))
    shading = ShadingTable(noise_levels=0.0, ambient=1.0, texture_cell_m=0.3, supersampling=1)
    renderer = ImageRenderer(plate, CAMERA, shading, seed=2)
    rng, sun = np.random.default_rng(0), np.array([0.0, 0.0, -1.0])
    first = renderer.render(AHEAD, sun, rng).astype(float)
    # Two pixels to the right at 4.95 m, where the front of the plate is.
    moved = make_transform(np.eye(3), np.array([2.0 * 4.95 / 100.0, 0.0, 5.0]))
    second = renderer.render(moved, sun, rng).astype(float)
    inside = (slice(22, 38), slice(30, 50))
    shifted = second[22:38, 32:52]
    assert np.abs(shifted - first[inside]).max() < 3.0
    assert first[inside].std() > 5.0


def test_texture_is_smooth_and_repeats_its_seed() -> None:
    texture = Texture.random(0.1, 5)
    points = np.random.default_rng(1).uniform(-3.0, 3.0, (1000, 3))
    here = texture.at(points)
    assert 0.0 <= here.min() < 0.3 and 0.7 < here.max() <= 1.0
    assert np.abs(texture.at(points + 1e-4) - here).max() < 0.02
    assert np.array_equal(Texture.random(0.1, 5).at(points), here)


def test_a_scenario_is_written_and_read_back(tmp_path: Path) -> None:
    """A shipped scenario as images: its poses, the chaser's attitude and the truth."""
    path = shipped_pipeline("demo")
    assert path is not None
    pipeline = read_pipeline(path)
    scenario = pipeline.scenario.model_copy(update={"frames": 2})
    truth = true_motion(pipeline.model_copy(update={"scenario": scenario}))
    shading = ShadingTable(supersampling=1)
    moves = ImageMotion.of(truth, shading)
    mesh_path = shipped_mesh("boxsat")
    assert mesh_path is not None
    camera = PinholeCamera(200, 200, 600.0, 600.0, 99.5, 99.5)
    renderer = ImageRenderer(read_mesh(mesh_path), camera, shading)
    out = tmp_path / "images"
    rendered = RenderedImages("demo", renderer, moves, 0)
    count = write_images(out, CameraFacts.of(camera, 0.3), rendered, truth.truth)
    assert count == 2 and (out / "truth.csv").read_text().count("\n") == 3
    images = open_images(out)
    assert images.R_cam_world == pytest.approx(moves.R_cam_world, abs=1e-12)
    # The same picture comes back, and it shows the target.
    shown = [image for _, _, image in images]
    again = [image for _, _, image in rendered]
    assert all(np.array_equal(a, b) for a, b in zip(shown, again, strict=True))
    assert (shown[0] > 40).sum() > 500


def test_points_lie_on_the_surface_as_densely_everywhere() -> None:
    box = trimesh.creation.box((2.0, 1.0, 0.5))
    places, normals = surface_points(box, 2000, np.random.default_rng(6))
    assert np.abs(places / [1.0, 0.5, 0.25]).max(axis=1) == pytest.approx(np.ones(2000))
    on_top = normals[:, 2] > 0.5
    assert places[on_top, 2] == pytest.approx(np.full(on_top.sum(), 0.25))
    assert on_top.mean() == pytest.approx(2.0 / 7.0, abs=0.03)
    assert places[on_top, :2].mean(axis=0) == pytest.approx([0.0, 0.0], abs=0.1)


def motion(frames: int = 20) -> ImageMotion:
    times_s = np.arange(float(frames))
    R = exp_rotation(times_s[:, None] * [0.0, 0.1, 0.0])
    T = make_transform(R, np.broadcast_to([0.0, 0.0, 20.0], (frames, 3)))
    at_rest = np.broadcast_to(np.eye(3), (frames, 3, 3))
    truth = Trajectory(times_s, POSE_LAYOUT, T_cam_target=T)
    return ImageMotion(truth, at_rest, np.array([0.0, 0.0, -1.0]))


def sphere(count: int = 50) -> tuple[np.ndarray, np.ndarray]:
    normals = np.random.default_rng(3).standard_normal((count, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return 1.5 * normals, normals


def test_tracks_are_projections_of_the_points_that_face_the_camera() -> None:
    camera = ImageCameraTable().pinhole
    assert (camera.fx, camera.width) == (2909.0, 2048)
    points, normals = sphere()
    moves = motion()
    rng = np.random.default_rng(4)
    tracks = monocular_tracks(camera, moves, (points, normals), TrackFaults(), rng)
    for frame, T in zip(tracks.frames, moves.truth.poses, strict=True):
        p = transform_points(T, points)[frame.features % 50]
        assert frame.pixels == pytest.approx(project(camera, p))
        assert np.all(np.sum(normals[frame.features % 50] @ T[:3, :3].T * p, axis=1) < 0.0)
        assert 10 < len(frame.features) < 35
    # What comes back into view comes under a new number.
    seen = [set(frame.features.tolist()) for frame in motion_frames(camera)]
    for number in set.union(*seen):
        at = [k for k, each in enumerate(seen) if number in each]
        assert at == list(range(at[0], at[-1] + 1))


def motion_frames(camera: PinholeCamera) -> tuple:
    rng = np.random.default_rng(4)
    return monocular_tracks(camera, motion(80), sphere(), TrackFaults(), rng).frames


def test_noise_ends_and_wrong_matches_are_as_asked_for() -> None:
    camera = ImageCameraTable().pinhole
    clean = monocular_tracks(camera, motion(), sphere(400), TrackFaults(), np.random.default_rng(5))
    noisy = TrackFaults(0.4)
    rng = np.random.default_rng(5)
    found = monocular_tracks(camera, motion(), sphere(400), noisy, rng)
    off = np.concatenate(
        [a.pixels - b.pixels for a, b in zip(found.frames, clean.frames, strict=True)]
    )
    assert off.std() == pytest.approx(0.4, rel=0.05)
    rng = np.random.default_rng(5)
    wrong = TrackFaults(wrong_match_fraction=0.2)
    found = monocular_tracks(camera, motion(), sphere(400), wrong, rng)
    changed = [
        np.any(a.pixels != b.pixels, axis=1)
        for a, b in zip(found.frames[1:], clean.frames[1:], strict=True)
    ]
    assert np.mean(np.concatenate(changed)) == pytest.approx(0.2, abs=0.02)
    rng = np.random.default_rng(5)
    short = TrackFaults(mean_tracked_s=5.0)
    found = monocular_tracks(camera, motion(), sphere(400), short, rng)
    kept = [
        len(np.intersect1d(a.features, b.features)) / len(b.features)
        for a, b in zip(found.frames[1:], found.frames[:-1], strict=True)
    ]
    # A twentieth more leaves the view in a step.
    assert np.mean(kept) == pytest.approx(np.exp(-0.2) * 0.96, abs=0.04)


def test_box_of_an_inertia() -> None:
    inertia = inertia_from_ratios(np.array([0.7, 0.6, 0.05, -0.02, 0.03]))
    half, R = box_of_inertia(inertia, 1.5)
    assert half.max() == pytest.approx(1.5)
    # By integration: second moments of points spread evenly over the box.
    grid = np.linspace(-1.0, 1.0, 81)
    points = np.stack(np.meshgrid(grid, grid, grid), axis=-1).reshape(-1, 3) * half @ R.T
    second = points.T @ points
    found = np.trace(second) * np.eye(3) - second
    np.testing.assert_allclose(found / found[0, 0], inertia / inertia[0, 0], atol=1e-9)
