"""Poses fitted to single frames of the shipped satellite, against the pose they show."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import chi2

from pcnav.config.sensors import NoiseTable
from pcnav.core.arrays import DepthImage, FloatArray
from pcnav.core.camera import PinholeCamera
from pcnav.core.spatial import exp_rotation, make_transform
from pcnav.estimators.depth.pose_fit import SingleFramePose, agreeing, fit_pose, step_doubt
from pcnav.estimators.depth.pose_measurement import moved_pose, pose_error
from pcnav.perception.agreement import Agreement
from pcnav.perception.face_evidence import FaceEvidence
from pcnav.perception.render_compare import RenderComparer
from pcnav.simulation.noise import add_sensor_faults
from pcnav.target.rendering import DepthRenderer
from pcnav.target.satellite import Target, load_target

SIGMA_M = 0.02
CAMERA = PinholeCamera.from_field_of_view(256, 256, np.deg2rad(25.0))
GUESS_SD = np.repeat([0.1, np.deg2rad(1.0)], 3)
WIDE = np.diag(GUESS_SD**2)
LEVER_M = 5.0


@pytest.fixture(scope="module")
def target(repository: Path) -> Target:
    return load_target(repository / "meshes" / "boxsat.obj")


@pytest.fixture(scope="module")
def comparer(target: Target) -> RenderComparer:
    return RenderComparer(target, CAMERA, SIGMA_M)


def random_pose(rng: np.random.Generator) -> FloatArray:
    turn = rng.normal(size=3)
    turn *= rng.uniform(0.0, np.pi) / np.linalg.norm(turn)
    position = np.array([*rng.uniform(-0.5, 0.5, 2), rng.uniform(20.0, 25.0)])
    return make_transform(exp_rotation(turn), position)


def frame_at(target: Target, T: FloatArray, k: int = 0) -> DepthImage:
    clean = DepthRenderer(target.mesh, CAMERA).render(T)
    return add_sensor_faults(clean, NoiseTable(range_sigma_m=SIGMA_M), 3, k)


def squared(fit: SingleFramePose, truth: FloatArray) -> float:
    """Error over its stated covariance, chi-square with six degrees of freedom."""
    error = pose_error(fit.T_cam_model, truth)
    return float(error @ np.linalg.solve(fit.covariance, error))


def test_converges_from_a_decimetre_and_a_degree(target: Target, comparer: RenderComparer) -> None:
    rng = np.random.default_rng(0)
    errors, converged = [], 0
    for k in range(12):
        truth = random_pose(rng)
        # In any direction, all of it.
        shift, turn = rng.normal(size=(2, 3))
        off = np.concatenate([0.1 * shift / np.linalg.norm(shift), turn / np.linalg.norm(turn)])
        off[3:] *= np.deg2rad(1.0)
        fit = fit_pose(frame_at(target, truth, k), moved_pose(truth, off), WIDE, comparer)
        assert fit is not None and fit.comparison is not None
        converged += fit.converged
        assert squared(fit, truth) < chi2.isf(1e-4, 6)
        assert len(fit.used) >= 2
        error = pose_error(fit.T_cam_model, truth)
        errors.append([np.linalg.norm(error[:3]), np.linalg.norm(error[3:])])
        if fit.converged:  # what it was compared with last is the pose itself, nearly
            last = pose_error(fit.comparison.T_cam_model, fit.T_cam_model)
            assert last @ np.linalg.solve(fit.covariance, last) < 0.25 * 6
    # A fit may go on between two poses that the pixel grid makes equally good.
    assert converged >= 10
    shifts, turns = np.median(errors, axis=0)
    assert shifts < 0.003
    assert turns < np.deg2rad(0.03)


def test_a_displaced_part_is_left_out(target: Target, comparer: RenderComparer) -> None:
    # The long panel has been bent out by 0.15 m, which the catalogue does not know.
    (panel,) = [r for r in target.rectangles if r.name == "panel_long_front"]
    normal, origin = panel.T_model_rect[:3, 2], panel.T_model_rect[:3, 3]
    local = (np.array(target.mesh.vertices) - origin) @ panel.T_model_rect[:3, :3]
    half = 0.5 * np.array([panel.width_m, panel.length_m]) + 1e-3
    of_panel = (np.abs(local[:, :2]) < half).all(axis=1) & (np.abs(local[:, 2]) < 0.1)
    assert of_panel.sum() >= 8
    bent = target.mesh.copy()
    bent.vertices = np.array(bent.vertices) + 0.15 * of_panel[:, None] * normal
    turned = exp_rotation(np.array([0.5, 0.4, 0.2])) @ np.diag([1.0, -1.0, -1.0])
    truth = make_transform(turned @ panel.T_model_rect[:3, :3].T, np.array([0.0, 0.0, 22.0]))
    frame = frame_at(replace(target, mesh=bent), truth)

    faces = comparer.compare(frame, truth, WIDE).faces
    assert panel.name in [face.name for face in faces]
    kept = [face.name for face in agreeing(faces, WIDE, comparer.lever_m)]
    assert panel.name not in kept
    assert len(kept) >= 2
    rng = np.random.default_rng(1)
    fit = fit_pose(frame, moved_pose(truth, 0.3 * GUESS_SD * rng.normal(size=6)), WIDE, comparer)
    assert fit is not None
    assert panel.name not in fit.used
    assert squared(fit, truth) < chi2.isf(1e-4, 6)


def test_nothing_seen_gives_no_pose(target: Target, comparer: RenderComparer) -> None:
    truth = random_pose(np.random.default_rng(2))
    empty = np.zeros((256, 256), dtype=np.float32)
    assert fit_pose(empty, truth, WIDE, comparer) is None
    away = truth.copy()
    away[0, 3] += 100.0
    assert fit_pose(frame_at(target, truth), away, WIDE, comparer) is None


def test_a_beaten_pose_is_given_up_after_a_pass_and_says_what_it_explains(
    target: Target, comparer: RenderComparer
) -> None:
    truth = random_pose(np.random.default_rng(5))
    frame = frame_at(target, truth)
    off = moved_pose(truth, np.array([0.1, -0.1, 0.1, 0.02, -0.02, 0.02]))
    asked: list[Agreement] = []

    def is_beaten(agreement: Agreement) -> bool:
        asked.append(agreement)
        return True

    fit = fit_pose(frame, off, WIDE, comparer, is_beaten=is_beaten)
    assert fit is not None
    first = fit_pose(frame, off, WIDE, comparer, goes_on=lambda _: False)
    assert first is not None
    np.testing.assert_array_equal(fit.T_cam_model, first.T_cam_model)
    gained = fit.agreement.support - first.agreement.support
    assert gained > 0
    # As if the next pass gained as much.
    assert asked == [replace(fit.agreement, agree=fit.agreement.agree + gained)]


def test_a_pose_that_still_gains_is_not_given_up(target: Target, comparer: RenderComparer) -> None:
    truth = random_pose(np.random.default_rng(5))
    frame = frame_at(target, truth)
    off = moved_pose(truth, np.array([0.1, -0.1, 0.1, 0.02, -0.02, 0.02]))
    alone = fit_pose(frame, off, WIDE, comparer)
    assert alone is not None
    # Every pass but the last is behind a pose that explains as much as the right one will.
    best = alone.agreement.support
    passes: list[int] = []

    def is_beaten(agreement: Agreement) -> bool:
        passes.append(agreement.support)
        return agreement.support < best

    fit = fit_pose(frame, off, WIDE, comparer, is_beaten=is_beaten)
    assert fit is not None
    np.testing.assert_array_equal(fit.T_cam_model, alone.T_cam_model)
    assert fit.converged and passes


def test_the_guess_is_a_prior(target: Target, comparer: RenderComparer) -> None:
    truth = random_pose(np.random.default_rng(3))
    frame = frame_at(target, truth)
    guess = moved_pose(truth, np.array([0.01, 0.0, 0.0, 0.0, 0.0, 0.0]))
    sharp, spread = 1e-10 * np.eye(6), 0.02**2 * np.eye(6)
    fit = fit_pose(frame, guess, sharp, comparer, spread=spread)
    assert fit is not None
    assert np.linalg.norm(pose_error(guess, fit.T_cam_model)) < 1e-4
    wide = fit_pose(frame, guess, 1e6 * np.eye(6), comparer, spread=spread)
    narrow = fit_pose(frame, guess, WIDE, comparer, spread=spread)
    assert wide is not None
    assert narrow is not None
    # Neither decides anything where the frame knows all.
    difference = pose_error(wide.T_cam_model, narrow.T_cam_model)
    assert difference @ np.linalg.solve(wide.covariance, difference) < 1.0


def test_a_guess_as_good_as_the_frame_is_met_half_way(
    target: Target, comparer: RenderComparer
) -> None:
    truth = random_pose(np.random.default_rng(5))
    frame, spread = frame_at(target, truth), 0.01**2 * np.eye(6)
    alone = fit_pose(frame, truth, 1e6 * np.eye(6), comparer, spread=spread)
    assert alone is not None
    # Six standard deviations off in a direction that is known well, in several passes.
    strength, axes = np.linalg.eigh(alone.covariance)
    off = 6.0 * np.sqrt(strength[2]) * axes[:, 2]
    guess = moved_pose(alone.T_cam_model, off)
    both = fit_pose(frame, guess, alone.covariance, comparer, spread=spread)
    assert both is not None
    np.testing.assert_allclose(both.covariance, 0.5 * alone.covariance, atol=0.1 * strength[-1])
    left = pose_error(alone.T_cam_model, both.T_cam_model) - 0.5 * off
    assert left @ np.linalg.solve(alone.covariance, left) < 1.5


# Which faces agree.


def evidence(
    rng: np.random.Generator,
    target: Target,
    name: str,
    error: FloatArray,
    unweighed_sd: float = 0.0,
) -> FaceEvidence:
    """Of a plane: a shift along its normal and two turns, to 2 mm and 0.5 mrad; the plane itself
    may be off by so many times as much."""
    rectangle = next(r for r in target.rectangles if r.name == name)
    axes = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    rows = np.zeros((3, 6))
    rows[0, :3] = axes[0] / 0.002
    rows[1:, 3:] = axes[1:] / 5e-4
    value = rows @ error + rng.normal(size=3)
    by_unweighed = None
    if unweighed_sd > 0.0:
        value = value + unweighed_sd * rng.normal(size=3)
        by_unweighed = unweighed_sd * rows
    vector = rows.T @ value
    return FaceEvidence(rectangle, rows.T @ rows, vector, 100, 1.0, by_unweighed=by_unweighed)


NAMES = ("bus_x_plus", "bus_y_minus", "bus_z_minus", "panel_long_front", "panel_short_front")


@pytest.mark.parametrize("wrong", range(5))
def test_the_face_that_contradicts_the_others_is_left_out(target: Target, wrong: int) -> None:
    rng = np.random.default_rng(wrong)
    error = GUESS_SD * rng.normal(size=6)
    off = error + np.array([0.2, -0.2, 0.2, 0.02, -0.02, 0.02])
    faces = tuple(
        evidence(rng, target, name, off if k == wrong else error) for k, name in enumerate(NAMES)
    )
    kept = agreeing(faces, WIDE, LEVER_M)
    assert [face.name for face in kept] == [n for k, n in enumerate(NAMES) if k != wrong]


def test_faces_that_agree_are_all_kept(target: Target) -> None:
    rng = np.random.default_rng(0)
    for _ in range(100):
        error = GUESS_SD * rng.normal(size=6)
        faces = [evidence(rng, target, name, error) for name in NAMES]
        # Five gates of 99.99 % each.
        assert agreeing(faces, WIDE, LEVER_M) == faces


def test_what_faces_may_err_by_beside_their_weights_is_no_contradiction(target: Target) -> None:
    """Gated by the noise of their pixels alone, of faces that lie off their mesh few are left."""
    rng = np.random.default_rng(0)
    left_out = 0
    for _ in range(100):
        error = GUESS_SD * rng.normal(size=6)
        faces = [evidence(rng, target, name, error, unweighed_sd=8.0) for name in NAMES]
        assert agreeing(faces, WIDE, LEVER_M) == faces
        white = [replace(face, by_unweighed=None) for face in faces]
        left_out += len(faces) - len(agreeing(white, WIDE, LEVER_M))
    assert left_out > 100


def test_of_two_that_disagree_none_can_be_called_wrong(target: Target) -> None:
    rng = np.random.default_rng(0)
    faces = [
        evidence(rng, target, name, error)
        for name, error in zip(NAMES[:2], (np.zeros(6), np.full(6, 0.3)), strict=True)
    ]
    assert agreeing(faces, WIDE, LEVER_M) == faces
    assert agreeing(faces[:1], WIDE, LEVER_M) == faces[:1]
    assert agreeing([], WIDE, LEVER_M) == []


def test_doubt_after_a_step_is_a_tenth_of_it() -> None:
    doubt = step_doubt(np.array([0.03, 0.0, -0.04, 0.0, 0.01, 0.0]))
    np.testing.assert_allclose(doubt, np.diag([0.005**2] * 3 + [0.001**2] * 3))
