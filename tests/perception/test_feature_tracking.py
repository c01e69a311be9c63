"""Corners followed through images: a known shift, a turning target, what is let go."""

from pathlib import Path

import numpy as np
import pytest
import trimesh
from scipy.ndimage import gaussian_filter, shift

from pcnav.config.image_motion import FeatureTrackerTable, ImageMotionTable
from pcnav.config.sensors import ShadingTable
from pcnav.core.arrays import FloatArray
from pcnav.core.camera import PinholeCamera
from pcnav.core.errors import InputError
from pcnav.core.spatial import exp_rotation, log_rotation, make_transform
from pcnav.dynamics.blocks import POSE_LAYOUT
from pcnav.dynamics.trajectory import Trajectory
from pcnav.estimators.image_motion.chain import chain_frames
from pcnav.perception import feature_tracking
from pcnav.perception.feature_tracking import FeatureTracker, track_features
from pcnav.recordings.images import GreyImage, open_images, write_images
from pcnav.recordings.monocular_tracks import CameraFacts
from pcnav.simulation.images import ImageMotion, RenderedImages
from pcnav.simulation.shading import ImageRenderer
from pcnav.target.rendering import DepthRenderer

pytest.importorskip("cv2", reason="the extra `images` is not installed")

CAMERA = PinholeCamera(256, 256, 500.0, 500.0, 127.5, 127.5)
TABLE = FeatureTrackerTable(max_features=60)


def scenery(seed: int = 0) -> FloatArray:
    """(300, 300) smooth random brightness."""
    noise = np.random.default_rng(seed).standard_normal((300, 300))
    smooth = gaussian_filter(noise, 2.0)
    return np.asarray(130.0 + 40.0 * smooth / smooth.std())


def shifted(scene: FloatArray, du: float, dv: float) -> GreyImage:
    moved = shift(scene, (dv, du), order=3, mode="reflect")[22:278, 22:278]
    return np.clip(np.rint(moved), 0, 255).astype(np.uint8)


def test_a_known_shift_is_followed_to_a_tenth_of_a_pixel() -> None:
    scene, tracker = scenery(), FeatureTracker(CAMERA, TABLE)
    first, at_first = tracker.step(shifted(scene, 0.0, 0.0))
    for k in range(1, 5):
        features, pixels = tracker.step(shifted(scene, 1.3 * k, -0.7 * k))
        common, i, j = np.intersect1d(first, features, return_indices=True)
        moved = pixels[j] - at_first[i]
        assert len(common) > 30
        assert np.median(np.abs(moved - [1.3 * k, -0.7 * k])) < 0.05
    assert len(np.unique(features)) == len(features) <= TABLE.max_features


def test_what_does_not_come_back_is_dropped_and_never_gets_its_number_again() -> None:
    tracker = FeatureTracker(CAMERA, TABLE)
    first, _ = tracker.step(shifted(scenery(0), 0.0, 0.0))
    other, _ = tracker.step(shifted(scenery(1), 0.0, 0.0))
    assert len(np.intersect1d(first, other)) < 0.2 * len(first)
    again, _ = tracker.step(shifted(scenery(0), 0.0, 0.0))
    assert len(np.intersect1d(first, again)) <= len(np.intersect1d(first, other))


def test_an_empty_image_has_no_features_and_no_fault() -> None:
    tracker = FeatureTracker(CAMERA, TABLE)
    dark = np.zeros((256, 256), dtype=np.uint8)
    assert len(tracker.step(dark)[0]) == 0
    assert len(tracker.step(shifted(scenery(), 0.0, 0.0))[0]) > 30
    assert len(tracker.step(dark)[0]) == 0


def test_corners_keep_away_from_the_outline() -> None:
    image = np.zeros((256, 256), dtype=np.uint8)
    image[80:180, 60:200] = shifted(scenery(), 0.0, 0.0)[80:180, 60:200]
    _, pixels = FeatureTracker(CAMERA, TABLE).step(image)
    # Refinement to a fraction of a pixel may move a corner by its window, 5 px.
    assert len(pixels) > 10
    assert pixels.min(axis=0) == pytest.approx([66.0, 86.0], abs=20.0)
    assert np.all(pixels >= [63.0, 83.0]) and np.all(pixels <= [196.0, 176.0])


@pytest.fixture(scope="module")
def turning(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, ImageMotion, trimesh.Trimesh]:
    """A folder of images of a turning box with a tower, its motion and its mesh."""
    box = trimesh.creation.box((2.0, 1.6, 1.4))
    tower = trimesh.creation.box((0.7, 0.7, 1.0))
    tower.apply_translation((0.3, -0.2, 1.2))
    mesh = trimesh.util.concatenate([box, tower])
    assert isinstance(mesh, trimesh.Trimesh)
    times_s = np.arange(8.0)
    start = exp_rotation(np.array([2.4, 0.5, 0.2]))
    R = exp_rotation(np.deg2rad(times_s[:, None] * [0.9, 1.2, 0.5])) @ start
    place = np.broadcast_to([0.0, 0.0, 8.0], (8, 3))
    at_rest = np.broadcast_to(np.eye(3), (8, 3, 3))
    truth = Trajectory(times_s, POSE_LAYOUT, T_cam_target=make_transform(R, place))
    motion = ImageMotion(truth, at_rest, np.array([0.3, -0.4, -1.0]))
    camera = PinholeCamera(480, 480, 1100.0, 1100.0, 239.5, 239.5)
    renderer = ImageRenderer(mesh, camera, ShadingTable(texture_cell_m=0.1, ambient=0.4), seed=3)
    out = tmp_path_factory.mktemp("images") / "box"
    write_images(out, CameraFacts.of(camera, 0.3), RenderedImages("box", renderer, motion, 0))
    return out, motion, mesh


def test_tracks_of_rendered_images_stay_on_the_target(
    turning: tuple[Path, ImageMotion, trimesh.Trimesh],
) -> None:
    folder, motion, mesh = turning
    images = open_images(folder)
    camera = images.camera
    start, *later = track_features(images, camera, FeatureTrackerTable(spacing_px=6.0))
    first = DepthRenderer(mesh, camera).render(motion.truth.poses[0])
    for frame, T in zip(later, motion.truth.poses[1:], strict=True):
        common, i, j = np.intersect1d(start.features, frame.features, return_indices=True)
        assert len(common) >= 20
        rays = (start.pixels[i] - [camera.cx, camera.cy]) / [camera.fx, camera.fy]
        rays = np.column_stack([rays, np.ones(len(rays))])
        u, v = np.rint(start.pixels[i]).astype(int).T
        planes = first.inverse_depth_planes[first.triangle[v, u]]
        p_first = rays / np.sum(planes * rays, axis=1)[:, None]
        move = T @ np.linalg.inv(motion.truth.poses[0])
        p = p_first @ move[:3, :3].T + move[:3, 3]
        expected = p[:, :2] / p[:, 2:] * [camera.fx, camera.fy] + [camera.cx, camera.cy]
        off = np.linalg.norm(expected - frame.pixels[j], axis=1)
        # Nine in ten: the others sit where two surfaces meet in a patch.
        assert np.median(off) < 0.1
        assert np.percentile(off, 90) < 0.5


def test_attitude_from_rendered_images(
    turning: tuple[Path, ImageMotion, trimesh.Trimesh],
) -> None:
    pytest.importorskip("poselib", reason="the extra `images` is not installed")
    folder, motion, _ = turning
    images, table = open_images(folder), FeatureTrackerTable(spacing_px=6.0)
    frames = track_features(images, images.camera, table)
    last = chain_frames(images.camera, table.pixel_sigma_px, frames, ImageMotionTable())[-1]
    assert last.R_world_body is not None and last.covariance is not None
    R = motion.truth.poses[:, :3, :3]
    off = log_rotation(last.R_world_body.T @ (R[-1] @ R[0].T))
    # Eleven degrees turned.
    assert np.rad2deg(np.linalg.norm(off)) < 0.3
    assert off @ np.linalg.solve(last.covariance, off) < 25.0


def test_without_opencv_one_line_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(needed_for: str) -> None:
        raise InputError("cv2", "module", f"expected the extra `images`, for {needed_for}")

    monkeypatch.setattr(feature_tracking, "opencv", missing)
    with pytest.raises(InputError, match="images"):
        FeatureTracker(CAMERA, TABLE).step(shifted(scenery(), 0.0, 0.0))


def test_a_corner_that_noise_places_badly_is_let_go() -> None:
    """Grain of 12 grey levels on faint structure: no patch is as good as the stated 0.1 px."""
    rng, scene = np.random.default_rng(2), scenery()
    faint = 100.0 + 0.1 * (scene - scene.mean())
    tracker = FeatureTracker(CAMERA, TABLE)
    seen = []
    for k in range(3):
        grainy = shifted(faint, 0.4 * k, 0.0) + 12.0 * rng.standard_normal((256, 256))
        seen.append(tracker.step(np.clip(np.rint(grainy), 0, 255).astype(np.uint8))[0])
    assert len(seen[0]) > 10
    assert len(np.intersect1d(seen[0], seen[2])) == 0
