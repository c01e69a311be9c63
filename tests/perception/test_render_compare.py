"""Frames compared with rendered views: against planes in closed form, and errors that are known."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pytest
import trimesh
from scipy.stats import chi2

from pcnav.config.depth import MODALITIES_BY_DEFAULT
from pcnav.config.sensors import NoiseTable
from pcnav.core.arrays import DepthImage, FloatArray
from pcnav.core.camera import PinholeCamera, pixel_rays, range_per_depth
from pcnav.core.spatial import exp_rotation, make_transform
from pcnav.perception.render_compare import Comparison, RenderComparer
from pcnav.perception.unseen import Unseen
from pcnav.simulation.noise import add_sensor_faults
from pcnav.target.rendering import DepthRenderer
from pcnav.target.satellite import Target
from tests.target.catalogued import find_rectangles

DrawPose = Callable[..., FloatArray]
Change = Callable[[DepthImage, np.random.Generator], DepthImage]
SIGMA = 0.02
PRIOR_SD = np.repeat([0.005, 0.001], 3)
"""Of a filter that tracks: 5 mm, 0.06 degrees."""
PRIOR = np.diag(PRIOR_SD**2)
NONE_LIKELY = 5e-4
"""Each tail of the 99.9 % bounds."""


def moved(T: FloatArray, error: FloatArray) -> FloatArray:
    """A pose moved by a shift in camera axes and a turn in model axes."""
    return make_transform(T[:3, :3] @ exp_rotation(error[3:]), T[:3, 3] + error[:3])


def total(comparison: Comparison) -> tuple[FloatArray, FloatArray]:
    """Information (6, 6) and information times error (6,) of all faces."""
    faces = comparison.faces
    return np.asarray(sum(f.information for f in faces)), np.asarray(sum(f.vector for f in faces))


def target_of(mesh: trimesh.Trimesh, boxsat: Target) -> Target:
    return replace(boxsat, mesh=mesh, rectangles=find_rectangles(mesh))


def grid(height: Callable[[FloatArray, FloatArray], FloatArray], n: int = 41) -> trimesh.Trimesh:
    """A sheet of 30 x 30 m over x and y, facing -z: it fills the image from 20 m."""
    x, y = (part.ravel() for part in np.meshgrid(*[np.linspace(-15.0, 15.0, n)] * 2))
    corner = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)).ravel()
    a, b, c, d = corner, corner + 1, corner + n + 1, corner + n
    faces = np.vstack([np.column_stack([a, c, b]), np.column_stack([a, d, c])])
    return trimesh.Trimesh(np.column_stack([x, y, height(x, y)]), faces, process=False)


@pytest.fixture(scope="module")
def wall(boxsat: Target) -> Target:
    return target_of(grid(lambda x, y: np.zeros_like(x), 2), boxsat)


@pytest.fixture(scope="module")
def comparer(boxsat: Target, camera: PinholeCamera) -> RenderComparer:
    return RenderComparer(boxsat, camera, SIGMA)


# Ranges.


def plane_ranges(camera: PinholeCamera, T: FloatArray) -> FloatArray:
    """(height, width) of the model's plane z = 0."""
    rays = pixel_rays(camera)
    depth = (T[:3, 2] @ T[:3, 3]) / (rays @ T[:3, 2])
    return np.asarray(depth * np.linalg.norm(rays, axis=-1))


@pytest.mark.parametrize("tilt", [0.0, 0.5, 1.0])
def test_evidence_of_ranges_is_that_of_their_derivatives(
    wall: Target, camera: PinholeCamera, tilt: float
) -> None:
    # The wall fills the image: there is no outline in it.
    T = make_transform(exp_rotation(np.array([0.3 * tilt, tilt, 0.4])), np.array([0.1, 0.2, 6.0]))
    inner = (slice(1, -1), slice(1, -1))
    columns = [
        (plane_ranges(camera, moved(T, d)) - plane_ranges(camera, moved(T, -d)))[inner].ravel()
        for d in 1e-5 * np.eye(6)
    ]
    J = np.column_stack(columns) / 2e-5
    error = np.array([2e-3, -3e-3, 1e-3, 2e-4, -1e-4, 3e-4])
    seen = plane_ranges(camera, moved(T, error))
    residual = (seen - plane_ranges(camera, T))[inner].ravel()

    frame: DepthImage = (seen / range_per_depth(camera)).astype(np.float32)
    (face,) = RenderComparer(wall, camera, SIGMA).compare(frame, T, PRIOR).faces
    assert face.rectangle is wall.rectangles[0]
    assert face.n_pixels == 254 * 254
    information = J.T @ J / SIGMA**2
    np.testing.assert_allclose(face.information, information, atol=1e-7 * information.max())
    expected = J.T @ residual / SIGMA**2
    # The frame is in float32: each return is to a micrometre of its millimetres.
    np.testing.assert_allclose(face.vector, expected, atol=1e-4 * np.abs(expected).max())
    # A plane knows of no shift within itself, nor of a turn about its normal.
    assert np.linalg.matrix_rank(face.information, hermitian=True) == 3


def test_surfaces_seen_flatter_than_84_degrees_are_not_used(
    wall: Target, camera: PinholeCamera
) -> None:
    comparer = RenderComparer(wall, camera, SIGMA)
    used = []
    for degrees in (82.0, 88.0):
        turn = exp_rotation(np.array([0.0, np.radians(degrees), 0.0]))
        T = make_transform(turn, np.array([0.0, 0.0, 40.0]))
        frame = DepthRenderer(wall.mesh, camera).render(T).depth_m
        cosine = -(pixel_rays(camera) @ T[:3, 2]) / range_per_depth(camera)
        flat = (np.abs(cosine) < 0.1) & (frame > 0.0)
        comparison = comparer.compare(frame, T, PRIOR)
        used.append(np.count_nonzero(comparison.labels >= 0))
        assert flat.any()
        assert not (flat & (comparison.labels >= 0)).any()
    assert used[0] > 1000
    assert used[1] == 0


def test_a_bent_face_counts_for_less(wall: Target, camera: PinholeCamera) -> None:
    T = make_transform(exp_rotation(np.array([0.0, 0.3, 0.0])), np.array([0.0, 0.0, 20.0]))
    comparer, rng = RenderComparer(wall, camera, SIGMA), np.random.default_rng(0)
    noise = rng.normal(0.0, SIGMA, (256, 256)) / range_per_depth(camera)
    bent = grid(lambda x, y: 0.03 * np.cos(x) * np.cos(1.3 * y), 161)
    faces = []
    for mesh in (wall.mesh, bent):
        frame = (DepthRenderer(mesh, camera).render(T).depth_m + noise).astype(np.float32)
        (face,) = comparer.compare(frame, T, PRIOR).faces
        # What is left of the residuals after their own best fit by the motion of a plane.
        residual = (frame * range_per_depth(camera) - plane_ranges(camera, T))[1:-1, 1:-1].ravel()
        rays = (pixel_rays(camera) / range_per_depth(camera)[..., None])[1:-1, 1:-1].reshape(-1, 3)
        per_normal = np.abs(residual) < 4.0 * SIGMA
        # A plane that moves changes 1 / range linearly in the ray.
        motion = rays * (plane_ranges(camera, T)[1:-1, 1:-1].ravel() ** 2)[:, None]
        left = np.linalg.lstsq(motion[per_normal], residual[per_normal], rcond=None)[1]
        n = np.count_nonzero(per_normal)
        assert face.chi_square_per_dof == pytest.approx(left[0] / SIGMA**2 / (n - 3), rel=0.02)
        faces.append(face)
    flat, other = faces
    assert flat.chi_square_per_dof == pytest.approx(1.0, abs=4.0 * np.sqrt(2.0 / flat.n_pixels))
    assert 1.4 < other.chi_square_per_dof < 1.8
    expected = other.n_pixels / flat.n_pixels / other.chi_square_per_dof
    assert np.trace(other.information) / np.trace(flat.information) == pytest.approx(
        expected, rel=0.02
    )


# Whole views.


@dataclass(frozen=True)
class Updates:
    """Poses from a known prior, updated by one comparison each."""

    nees: FloatArray
    nis: FloatArray
    z: FloatArray
    """(n, 6) errors over their stated standard deviations."""


def updates(
    target: Target,
    camera: PinholeCamera,
    draw: Callable[[np.random.Generator], FloatArray],
    n: int,
    noise: NoiseTable,
    change: Change = lambda depth, _: depth,
) -> Updates:
    comparer, renderer = RenderComparer(target, camera, SIGMA), DepthRenderer(target.mesh, camera)
    rng = np.random.default_rng(0)
    nees, nis, z = [], [], []
    for k in range(n):
        T = draw(rng)
        error = PRIOR_SD * rng.normal(size=6)
        frame = add_sensor_faults(renderer.render(moved(T, error)), noise, 0, k)
        information, vector = total(comparer.compare(change(frame, rng), T, PRIOR))
        measured = np.linalg.solve(information, vector)
        nis.append(measured @ np.linalg.solve(PRIOR + np.linalg.inv(information), measured))
        posterior = information + np.linalg.inv(PRIOR)
        left = np.linalg.solve(posterior, vector) - error
        nees.append(left @ posterior @ left)
        z.append(left / np.sqrt(np.diag(np.linalg.inv(posterior))))
    return Updates(np.array(nees), np.array(nis), np.array(z))


def assert_calibrated(found: Updates) -> None:
    """NEES and NIS within 99.9 % bounds, no component biased."""
    dof = 6 * len(found.nees)
    low, high = chi2.ppf(NONE_LIKELY, dof), chi2.isf(NONE_LIKELY, dof)
    assert low < found.nees.sum() < high, found.nees.sum() / dof
    assert low < found.nis.sum() < high, found.nis.sum() / dof
    assert np.all(np.abs(found.z.mean(axis=0)) < 4.0 / np.sqrt(len(found.z)))


def test_a_clean_frame_recovers_the_displacement(
    boxsat: Target, camera: PinholeCamera, comparer: RenderComparer, random_pose: DrawPose
) -> None:
    renderer, rng = DepthRenderer(boxsat.mesh, camera), np.random.default_rng(7)
    for _ in range(8):
        T = random_pose(rng)
        error = PRIOR_SD * rng.normal(size=6)
        comparison = comparer.compare(renderer.render(moved(T, error)).depth_m, T, PRIOR)
        assert len(comparison.faces) >= 3
        information, vector = total(comparison)
        left = np.linalg.solve(information, vector) - error
        # The pixel grid alone errs, the noise that is counted on does not.
        assert left @ information @ left < chi2.ppf(0.99, 6)
        # So does each face, in what it knows.
        for face in comparison.faces:
            innovation = face.vector - face.information @ error
            pseudo = np.linalg.pinv(face.information, rcond=1e-12, hermitian=True)
            assert innovation @ pseudo @ innovation < chi2.ppf(0.9999, 6), face.name


def test_modalities_add_up(
    boxsat: Target, camera: PinholeCamera, comparer: RenderComparer, random_pose: DrawPose
) -> None:
    T = random_pose(np.random.default_rng(5))
    frame = DepthRenderer(boxsat.mesh, camera).render(moved(T, PRIOR_SD)).depth_m
    alone = [
        total(RenderComparer(boxsat, camera, SIGMA, modalities=(name,)).compare(frame, T, PRIOR))
        for name in MODALITIES_BY_DEFAULT
    ]
    for both, *parts in zip(total(comparer.compare(frame, T, PRIOR)), *alone, strict=True):
        assert all(np.any(part != 0.0) for part in parts)
        np.testing.assert_allclose(sum(parts), both, rtol=1e-9, atol=1e-9 * np.abs(both).max())


def test_errors_are_as_large_as_stated(
    boxsat: Target, camera: PinholeCamera, random_pose: DrawPose
) -> None:
    noise = NoiseTable(range_sigma_m=SIGMA)
    assert_calibrated(updates(boxsat, camera, random_pose, 200, noise))


def test_what_the_image_cuts_off_biases_nothing(
    boxsat: Target, camera: PinholeCamera, random_pose: DrawPose
) -> None:
    def draw(rng: np.random.Generator) -> FloatArray:
        T = random_pose(rng)
        T[:2, 3] += rng.choice([-4.5, 4.5], 2)
        return T

    noise = NoiseTable(range_sigma_m=SIGMA)
    assert_calibrated(updates(boxsat, camera, draw, 80, noise))


def hide(frame: DepthImage, rng: np.random.Generator) -> DepthImage:
    """A box of 40 x 50 pixels in front of the target's middle."""
    u, v = rng.integers(80, 140, 2)
    hidden = frame.copy()
    hidden[v : v + 50, u : u + 40] = 12.0
    return hidden


def test_what_something_else_hides_biases_nothing(
    boxsat: Target, camera: PinholeCamera, random_pose: DrawPose
) -> None:
    noise = NoiseTable(range_sigma_m=SIGMA)
    assert_calibrated(updates(boxsat, camera, random_pose, 80, noise, hide))


@pytest.mark.parametrize(
    "faults",
    [
        {"outlier_fraction": 0.05},
        {"dropout_fraction": 0.3},
        {"mixed_pixel_fraction": 0.5},
        {"outlier_fraction": 0.05, "dropout_fraction": 0.3, "mixed_pixel_fraction": 0.5},
    ],
    ids=["outliers", "dropouts", "mixed pixels", "all and hidden"],
)
def test_sensor_faults_leave_the_pose_right(
    boxsat: Target, camera: PinholeCamera, random_pose: DrawPose, faults: dict[str, float]
) -> None:
    noise = NoiseTable.model_validate({"range_sigma_m": SIGMA, **faults})
    change: Change = hide if len(faults) > 1 else lambda depth, _: depth
    found = updates(boxsat, camera, random_pose, 30, noise, change)
    assert np.abs(found.z).max() < 5.0
    assert found.nees.mean() < 6.0 * 1.5


# What a comparison tells besides.


def test_labels_show_the_pixels_of_each_face(
    boxsat: Target, camera: PinholeCamera, comparer: RenderComparer, random_pose: DrawPose
) -> None:
    T = random_pose(np.random.default_rng(1))
    clean = DepthRenderer(boxsat.mesh, camera).render(T)
    frame = add_sensor_faults(clean, NoiseTable(range_sigma_m=SIGMA), 0, 0)
    comparison = comparer.compare(frame, T, PRIOR)
    counts = [np.count_nonzero(comparison.labels == k) for k in range(len(comparison.faces))]
    assert counts == [face.n_pixels for face in comparison.faces]
    assert comparison.labels.min() == -1
    assert comparison.labels.max() == len(comparison.faces) - 1
    assert not (comparison.labels[frame == 0.0] >= 0).any()
    points = pixel_rays(camera) * frame[..., None]
    for k, face in enumerate(comparison.faces):
        if face.rectangle is None:
            assert face.name == "other surfaces"
            continue
        assert face.name == face.rectangle.name
        pose = T @ face.rectangle.T_model_rect
        local = (points[comparison.labels == k] - pose[:3, 3]) @ pose[:3, :3]
        half = 0.5 * np.array([face.rectangle.width_m, face.rectangle.length_m])
        assert np.all(np.abs(local[:, :2]) < half + 0.15)
        assert np.all(np.abs(local[:, 2]) < 5.0 * SIGMA)
    assert comparison.agreement.inlier_ratio > 0.98
    np.testing.assert_array_equal(comparison.rendered.depth_m, clean.depth_m)


def test_frames_that_show_nothing_of_the_view_say_nothing(
    boxsat: Target, camera: PinholeCamera, comparer: RenderComparer, random_pose: DrawPose
) -> None:
    T = random_pose(np.random.default_rng(2))
    frame = DepthRenderer(boxsat.mesh, camera).render(T).depth_m
    away = T.copy()
    away[0, 3] += 80.0
    for depth_m, pose in ((np.zeros_like(frame), T), (frame, away), (frame + 50.0, T)):
        comparison = comparer.compare(depth_m, pose, PRIOR)
        assert comparison.faces == ()
        assert (comparison.labels == -1).all()


def test_a_stride_takes_every_so_many_pixels(
    boxsat: Target, camera: PinholeCamera, comparer: RenderComparer, random_pose: DrawPose
) -> None:
    rng = np.random.default_rng(4)
    coarse = RenderComparer(boxsat, camera, SIGMA, 4)
    T = random_pose(rng, 15.0, 16.0)
    fine = comparer.compare(DepthRenderer(boxsat.mesh, camera).render(T).depth_m, T, PRIOR)
    every = coarse.compare(fine.rendered.depth_m, T, PRIOR)
    np.testing.assert_allclose(every.rendered.depth_m, fine.rendered.depth_m[::4, ::4], rtol=1e-6)
    # A sixteenth of the pixels and a quarter as many crossings: less is known, and as truly.
    error = np.array([0.02, -0.03, 0.03, 4e-3, -3e-3, 4e-3])
    frame = DepthRenderer(boxsat.mesh, camera).render(moved(T, error)).depth_m
    spread = np.diag(np.repeat([0.03, 4e-3], 3) ** 2)
    information, vector = total(coarse.compare(frame, T, spread))
    left = np.linalg.solve(information, vector) - error
    assert left @ information @ left < chi2.ppf(0.999, 6)
    assert np.linalg.norm(left[:3]) < 0.3 * np.linalg.norm(error[:3])


def test_doubt_in_pixels_is_that_of_a_point_at_the_rim(
    boxsat: Target, camera: PinholeCamera, comparer: RenderComparer
) -> None:
    T = make_transform(np.eye(3), np.array([0.0, 0.0, 25.0]))
    shift = comparer.doubt_px(T, np.diag([0.01**2] * 3 + [0.0] * 3))
    assert shift == pytest.approx(0.01 * camera.fx / 25.0)
    turn = comparer.doubt_px(T, np.diag([0.0] * 3 + [1e-6] * 3))
    assert turn == pytest.approx(1e-3 * 0.5 * boxsat.diameter_m * camera.fx / 25.0)
    assert comparer.lever_m == 0.5 * boxsat.diameter_m
    coarse = RenderComparer(boxsat, camera, SIGMA, 4).doubt_px(T, PRIOR)
    assert coarse == pytest.approx(0.25 * comparer.doubt_px(T, PRIOR))


def test_a_score_counts_returns_that_are_explained(
    boxsat: Target, camera: PinholeCamera, comparer: RenderComparer, random_pose: DrawPose
) -> None:
    T = random_pose(np.random.default_rng(6))
    frame = DepthRenderer(boxsat.mesh, camera).render(T).depth_m
    right = comparer.score(frame, T, 0.01)
    assert right.agree == np.count_nonzero(frame)
    assert right.conflict == 0
    turned = T.copy()
    turned[:3, :3] = T[:3, :3] @ exp_rotation(np.array([0.0, 0.8, 0.0]))
    assert comparer.score(frame, turned, 0.01).inlier_ratio < 0.2


def test_what_is_unseen_speaks_neither_for_nor_against_a_pose(
    boxsat: Target, camera: PinholeCamera, random_pose: DrawPose
) -> None:
    """The left half of the target lies outside a region of interest that cuts it."""
    comparer = RenderComparer(boxsat, camera, SIGMA)
    rng = np.random.default_rng(4)
    z, ratios = [], []
    for _ in range(12):
        T = random_pose(rng)
        error = rng.normal(size=6) * np.repeat([0.003, 4e-4], 3)
        clean = DepthRenderer(boxsat.mesh, camera).render(moved(T, error))
        frame = add_sensor_faults(clean, NoiseTable(range_sigma_m=SIGMA), 0, 0)
        columns = np.flatnonzero((clean.triangle >= 0).any(axis=0))
        unseen = np.zeros(frame.shape, dtype=np.bool_)
        unseen[:, : int(columns.mean())] = True
        comparer.unseen = None
        whole = comparer.compare(frame, T, PRIOR).agreement.inlier_ratio
        frame[unseen] = 0.0
        cut = comparer.compare(frame, T, PRIOR).agreement.inlier_ratio
        comparer.unseen = Unseen(unseen, None)
        comparison = comparer.compare(frame, T, PRIOR)
        ratios.append((whole, cut, comparison.agreement.inlier_ratio))
        information, vector = total(comparison)
        found = np.linalg.solve(information + np.linalg.inv(PRIOR), vector)
        wrong = found - error
        z.append(wrong @ (information + np.linalg.inv(PRIOR)) @ wrong / 6.0)
    whole, cut, seen = np.mean(ratios, axis=0)
    assert cut < 0.7
    assert seen == pytest.approx(whole, abs=0.03)
    # The border of the region is no outline: taken for one, it would pull by pixels.
    assert np.mean(z) < 2.0
